"""Outside agents in Python: run by the program of the wheel, beside our own."""

from __future__ import annotations

import os
import re
import shutil
import sqlite3
import sys

import jitai
import pytest
from conftest import PEOPLE, ROOT, run

SHIPPED = ROOT / "experiments" / "external"

MANIFEST = """\
format = 1
name = "small"
scenarios = ["P-H-D"]
seeds = 2
environment.sigma = 0.4
evaluation.test_episodes = 50
evaluation.curve_stride = 8
[[agent]]
name = "outside"
algorithm = "external"
command = ["{python}", "program.py"]
version = "1"
parameters = {{ epsilon = 0.2 }}
episodes = 40
[[agent]]
name = "rule"
algorithm = "rule"
rule = "untailored"
"""


def manual() -> str:
    text = (ROOT / "docs" / "python.md").read_text()
    [block] = [one for one in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if "connect" in one]
    return block


def with_program(folder, program: str, manifest: str = MANIFEST, agents: str = "outside|rule"):
    (folder / "small.toml").write_text(manifest.format(python=sys.executable))
    (folder / "program.py").write_text(program)
    return run("run", "small.toml", "--filter", f"agent={agents}", cwd=folder)


def rows(folder, sql: str):
    return sqlite3.connect(folder / "jitai.sqlite").execute(sql).fetchall()


def failure(folder) -> str:
    sql = "SELECT failure_message FROM run_summary WHERE failure_kind = 'external' LIMIT 1"
    [[message]] = rows(folder, sql)
    return message


def test_the_program_of_the_manual_is_an_agent_of_twenty_lines(tmp_path):
    assert len([line for line in manual().splitlines() if line.strip()]) <= 20
    ran = with_program(tmp_path, manual())
    assert ran.returncode == 0, ran.stderr
    assert "4 jobs run, 4 completed in all" in ran.stderr
    curve = "SELECT max(episode), count(*) FROM learning_curve WHERE metric = 'mean_return'"
    assert rows(tmp_path, curve) == [(40, 10)]
    first = rows(tmp_path, "SELECT job_key, mean_return FROM run_summary ORDER BY job_key")
    (tmp_path / "jitai.sqlite").unlink()
    assert with_program(tmp_path, manual()).returncode == 0
    again = rows(tmp_path, "SELECT job_key, mean_return FROM run_summary ORDER BY job_key")
    assert again == first


def test_the_test_of_a_constant_action_is_that_of_the_rule(tmp_path):
    program = """
import numpy as np
from jitai import external
job = external.connect()
assert job.names == ["P", "H", "D"] and job.episodes == job.left == 40
assert job.parameters == {"epsilon": 0.2} and job.seed in (1, 2) and job.lanes == 1
print("this goes to standard error")
begun = []
job.test(lambda seen: np.eye(4)[[1] * len(seen)], begin=begun.append)
assert begun == [50]
"""
    ran = with_program(tmp_path, program)
    assert ran.returncode == 0, ran.stderr
    of_agent = (
        "SELECT seed, episode, total_reward FROM evaluation_episode AS e JOIN run_summary AS s"
        " ON s.job_key = e.job_key WHERE agent = '{}' ORDER BY seed, episode"
    )
    outside, rule = (rows(tmp_path, of_agent.format(name)) for name in ("outside", "rule"))
    assert outside == rule and len(rule) == 100


@pytest.mark.parametrize(
    ("program", "expected"),
    [
        ("print('Hello')", "found the line `Hello`"),
        ("raise ValueError('no data')", "ValueError: no data"),
        ("import no_such_module", "No module named 'no_such_module'"),
        (
            "from jitai import external\njob = external.connect(lanes=64)\njob.reset()",
            "expected at most 40 episodes of training, the job's budget; found 64 more after 0",
        ),
        (
            "from jitai import external\njob = external.connect()\njob.reset()\njob.step([7])",
            "expected an action from 0 to 3 for lane 0, found 7",
        ),
        (
            "from jitai import external\njob = external.connect()\n"
            "job.report([1.0] * 41, [50] * 41, [False] * 41)\njob.reset()",
            "the job's budget; found 41 more after 0",
        ),
        (
            "from jitai import external\njob = external.connect()\njob.update(loss=float('nan'))",
            "Out of range float values are not JSON compliant",
        ),
    ],
)
def test_faults_are_failures_with_their_reasons(tmp_path, program, expected):
    ran = with_program(tmp_path, program)
    assert ran.returncode == 1, ran.stderr
    assert expected in failure(tmp_path)


def test_episodes_of_the_environments_are_reported(tmp_path):
    program = """
import jitai
from jitai import external
job = external.connect()
env = jitai.make(**job.environment())
returns, lengths, ends = [], [], []
for _ in range(job.left):
    env.reset(seed=job.seed + 2**32 if not returns else None)
    total, length, done = 0.0, 0, False
    while not done:
        _, reward, terminated, truncated, info = env.step(1)
        total, length, done = total + info["steps_walked"], length + 1, terminated or truncated
    returns.append(total), lengths.append(length), ends.append(terminated)
job.report(returns, lengths, ends)
assert job.left == 0
job.test(lambda seen: [1] * len(seen))
"""
    people = 'environment.message_cost = 2.0\npopulation.epsilon_d = {{ uniform = [0.2, 0.6] }}\n[['
    ran = with_program(tmp_path, program, MANIFEST.replace("[[", people, 1))
    assert ran.returncode == 0, ran.stderr
    means = rows(tmp_path, "SELECT avg(value) FROM learning_curve WHERE metric = 'mean_return'")
    tested = rows(tmp_path, "SELECT avg(mean_return) FROM run_summary WHERE agent = 'outside'")
    assert means[0][0] == pytest.approx(tested[0][0], rel=0.2)


UNPAID = MANIFEST.replace(
    "environment.sigma = 0.4",
    "environment.sigma = 0.4\nenvironment.horizon = 7\nenvironment.unpaid_last_step = true",
)


def test_episodes_with_an_unpaid_last_step_are_reported(tmp_path):
    program = """
import jitai
from jitai import external
job = external.connect()
assert (job.horizon, job.longest_episode) == (7, 8)
env = jitai.make(**job.environment())
assert env.spec.max_episode_steps == job.longest_episode
env.reset(seed=5)
total, length, done = 0.0, 0, False
while not done:
    _, _, terminated, truncated, info = env.step(0)
    total, length, done = total + info["steps_walked"], length + 1, terminated or truncated
assert length == 8
job.report([total], [length], [terminated])
job.test(lambda seen: [0] * len(seen))
"""
    ran = with_program(tmp_path, program, UNPAID)
    assert ran.returncode == 0, ran.stderr + str(rows(tmp_path, "SELECT failure_message FROM run_summary"))
    lengths = "SELECT DISTINCT value FROM learning_curve WHERE metric = 'mean_length'"
    assert rows(tmp_path, lengths) == [(8.0,)]
    too_long = program.replace("[length], [terminated]", "[length + 1], [terminated]")
    (tmp_path / "jitai.sqlite").unlink()
    assert with_program(tmp_path, too_long, UNPAID).returncode == 1
    assert "`lengths`: expected 1 to 8 steps, found 9" in failure(tmp_path)


@pytest.mark.parametrize("seed", [0, 1])
def test_the_vector_environment_of_a_job_reports_the_longest_episodes(tmp_path, seed):
    pytest.importorskip("stable_baselines3")
    program = """
import numpy as np
from jitai import external
from jitai.sb3 import JobVecEnv
job = external.connect()
lanes = JobVecEnv(job, 4)
assert job.seed not in lanes.seed()
lanes.reset()
while job.left:
    _, _, done, infos = lanes.step(np.zeros(4, int))
    assert not infos[0] or done[0]
job.test(lambda seen: [0] * len(seen))
"""
    ran = with_program(tmp_path, program, UNPAID.replace("seeds = 2", f"seeds = [{seed}]"))
    assert ran.returncode == 0, ran.stderr
    lengths = "SELECT DISTINCT value FROM learning_curve WHERE metric = 'mean_length'"
    assert rows(tmp_path, lengths) == [(8.0,)]


def test_texts_are_utf_8_whatever_the_locale(tmp_path):
    program = """
import sys
from jitai import external
job = external.connect()
word = job.parameters["word"]
print(word)
print(word, file=sys.stderr)
assert [ord(letter) for letter in word] == [0xE9, 0x4F60, 0x1F600], ascii(word)
job.test(lambda seen: [0] * len(seen))
raise SystemExit(word)
"""
    word = "\u00e9\u4f60\U0001f600"
    text = MANIFEST.replace("epsilon = 0.2", f'word = "{word}"')
    (tmp_path / "small.toml").write_text(text.format(python=sys.executable), encoding="utf-8")
    (tmp_path / "program.py").write_text(program)
    locale = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "PYTHONIOENCODING": "ascii"}
    ran = run("run", "small.toml", cwd=tmp_path, env={**os.environ, **locale})
    assert ran.returncode == 0, ran.stderr + str(rows(tmp_path, "SELECT failure_message FROM run_summary"))
    # A failure shows the program's standard error.
    (tmp_path / "program.py").write_text(program.replace("job.test", "raise ValueError(word)#"))
    (tmp_path / "jitai.sqlite").unlink()
    ran = run("run", "small.toml", cwd=tmp_path, env={**os.environ, **locale})
    assert ran.returncode == 1 and f"ValueError: {word}" in failure(tmp_path)


def test_children_of_a_program_read_an_empty_standard_input(tmp_path):
    program = """
import os, subprocess, sys
from jitai import external
job = external.connect()
assert subprocess.run(["cat"], stdout=subprocess.PIPE).stdout == b""
assert os.system("cat") == 0
assert sys.stdin.read() == ""
try:
    external.connect()
except external.ProtocolError as error:
    assert "called before" in str(error)
else:
    raise AssertionError
job.test(lambda seen: [0] * len(seen))
"""
    # Without the limit, a child that waits for input would wait forever.
    text = MANIFEST.replace("seeds = 2", "seeds = 2\ntime_limit_seconds = 20")
    ran = with_program(tmp_path, program, text)
    assert ran.returncode == 0, ran.stderr + str(rows(tmp_path, "SELECT failure_message FROM run_summary"))


def test_a_long_report_is_several_messages(tmp_path):
    program = """
from jitai import external
job = external.connect()
count = 100_000
try:
    job.report([1.0] * 3, [1, 2], [False] * 3)
except ValueError as error:
    assert "one entry per episode" in str(error)
else:
    raise AssertionError
job.report([1 / 3 + i for i in range(count)], [50] * count, [False] * count)
job.report(2.0, 7, True)
job.report([], [], [])
assert job.left == 0 and job.begun == count + 1
job.test(lambda seen: [0] * len(seen))
"""
    text = MANIFEST.replace("episodes = 40", "episodes = 100001").replace(
        "curve_stride = 8", "curve_stride = 1000"
    )
    ran = with_program(tmp_path, program, text)
    assert ran.returncode == 0, ran.stderr + str(rows(tmp_path, "SELECT failure_message FROM run_summary"))
    curve = "SELECT max(episode) FROM learning_curve WHERE metric = 'mean_return'"
    assert rows(tmp_path, curve) == [(100001,)]


def test_lines_of_jitai_are_as_long_as_their_observations(tmp_path):
    program = """
from jitai import external
job = external.connect(lanes=2000)
assert job.reset().shape == (2000, 303)
sizes = []
job.test(lambda seen: sizes.append(seen.shape) or [0] * len(seen))
assert sizes[0] == (1000, 303), sizes[0]
"""
    text = MANIFEST.replace("environment.sigma = 0.4", "environment.sigma = 0.4\nenvironment.horizon = 300\n"
                            "environment.time_one_hot = true").replace("episodes = 40", "episodes = 2000")
    ran = with_program(tmp_path, program, text.replace("test_episodes = 50", "test_episodes = 1000"))
    assert ran.returncode == 0, ran.stderr + str(rows(tmp_path, "SELECT failure_message FROM run_summary"))


def test_a_seed_of_a_job_meets_the_people_of_its_test(tmp_path):
    """As docs/external.md warns."""
    people = "population.epsilon_d = {{ uniform = [0.2, 0.6] }}\n[["
    program = """
import jitai
from jitai import external
job = external.connect()
env = jitai.make(**job.environment())
met = [env.reset(seed=job.seed if i == 0 else None)[1]["participant"]["epsilon_d"] for i in range(5)]
open(f"met{job.seed}", "w").write(repr(met))
job.test(lambda seen: [0] * len(seen))
"""
    text = MANIFEST.replace("[[", people, 1)
    ran = with_program(tmp_path, program, text)
    assert ran.returncode == 0, ran.stderr
    for seed in (1, 2):
        sql = (
            "SELECT value FROM participant JOIN run_summary USING (job_key)"
            f" WHERE agent = 'rule' AND seed = {seed} AND phase = 'test' ORDER BY episode LIMIT 5"
        )
        assert [row[0] for row in rows(tmp_path, sql)] == eval((tmp_path / f"met{seed}").read_text())


OF_PEOPLE = f"""\
[environment]
family = "declared"
model = "oralytics_v2"
people = '{PEOPLE}/synthetic_v2.csv'
days = 20
parameters.habituation_factor = 0.5
[evaluation]
test_episodes"""
BRUSHING = (
    MANIFEST.replace('"P-H-D"', '["brushing", "time_of_day"]')
    .replace("environment.sigma = 0.4\nevaluation.test_episodes", OF_PEOPLE)
    .replace("evaluation.curve", "curve")
    .replace('"untailored"', '"random"')
)
WALKING = MANIFEST.replace("[[", "population.epsilon_d = {{ uniform = [0.2, 0.6] }}\n[[", 1)


@pytest.mark.parametrize("manifest", [BRUSHING, WALKING], ids=["oralytics", "step_count"])
def test_the_environment_of_a_job_is_the_test_of_the_job(tmp_path, manifest):
    program = """
import jitai
import numpy as np
from jitai import external
job = external.connect()
env = jitai.make(**job.environment())
assert env.unwrapped.declaration.family == job.message["family"]
assert env.spec.max_episode_steps == job.longest_episode
chance = np.random.default_rng(job.seed)
observation, done = env.reset(seed=job.seed)[0], False
def act(seen):
    global observation, done
    assert not done and seen.tobytes() == observation.tobytes()
    action = int(chance.integers(job.actions))
    observation, _, terminated, truncated, _ = env.step(action)
    done = terminated or truncated
    return [action]
job.test(act)
assert done
"""
    ran = with_program(tmp_path, program, manifest.replace("test_episodes = 50", "test_episodes = 1"), "outside")
    assert ran.returncode == 0, ran.stderr + str(rows(tmp_path, "SELECT failure_message FROM run_summary"))


def test_the_vector_environment_of_a_job_reports_seconds_of_brushing(tmp_path):
    pytest.importorskip("stable_baselines3")
    program = """
import jitai
import numpy as np
from jitai import external
from jitai.sb3 import JobVecEnv
job = external.connect()
lanes = JobVecEnv(job, 2)
env, totals, costs = jitai.make(**job.environment()), [], 0.0
for seed in lanes.seed():
    env.reset(seed=seed)
    total, done = 0.0, False
    while not done:
        _, reward, terminated, truncated, info = env.step(1)
        total, costs = total + info["seconds_of_brushing"], costs + info["seconds_of_brushing"] - reward
        done = terminated or truncated
    totals.append(total)
assert costs > 0
open(f"totals{job.seed}", "w").write(repr(totals))
lanes.reset()
while job.left:
    lanes.step(np.ones(2, int))
job.test(lambda seen: [1] * len(seen))
"""
    text = BRUSHING.replace("episodes = 40", "episodes = 2").replace("stride = 8", "stride = 1")
    ran = with_program(tmp_path, program, text, "outside")
    assert ran.returncode == 0, ran.stderr + str(rows(tmp_path, "SELECT failure_message FROM run_summary"))
    for seed in (1, 2):
        sql = (
            "SELECT value FROM learning_curve JOIN run_summary USING (job_key)"
            f" WHERE metric = 'mean_return' AND seed = {seed} ORDER BY learning_curve.episode"
        )
        assert [row[0] for row in rows(tmp_path, sql)] == eval((tmp_path / f"totals{seed}").read_text())


def test_a_job_in_an_outside_environment_names_what_to_make_instead(tmp_path):
    program = """
import jitai
from jitai import external
job = external.connect()
jitai.make(**job.environment())
"""
    (tmp_path / "walk.py").write_text((SHIPPED / "two_messages.py").read_text())
    environment = (
        'environment = {{ family = "external", command = ["{python}", "walk.py"], version = "1",'
        " parameters = {{ dose = 1.0, fatigue = 0.2 }} }}"
    )
    text = MANIFEST.replace("environment.sigma = 0.4", environment).replace('"P-H-D"', '"all"')
    text = text.replace('"untailored"', '"random"')
    ran = with_program(tmp_path, program, text, "outside")
    assert ran.returncode == 1, ran.stderr
    assert "make the Gymnasium environment that the program serves" in failure(tmp_path)


def shipped(folder, agents: str, *options: str):
    for file in SHIPPED.iterdir():
        if file.suffix in (".py", ".sh", ".awk", ".toml"):
            shutil.copy(file, folder)
    text = (folder / "outside.toml").read_text().replace('"python3"', f'"{sys.executable}"')
    (folder / "outside.toml").write_text(text)
    ran = run("run", "outside.toml", "--filter", f"agent={agents},seed=1", *options, cwd=folder)
    assert ran.returncode == 0, ran.stderr
    store = jitai.open(folder / "jitai.sqlite")
    return dict(store.runs().groupby("agent")["mean_return"].mean())


def test_the_linear_bandit_in_numpy_fares_like_ours(tmp_path):
    pytest.importorskip("pandas")
    means = shipped(tmp_path, "numpy_bandit|awk_bandit|linear_thompson|tailored")
    assert means["numpy_bandit"] == pytest.approx(means["linear_thompson"], rel=0.1)
    assert means["awk_bandit"] == pytest.approx(means["tailored"], rel=0.1)
    report = run("report", "outside.toml", "--out", "report", cwd=tmp_path)
    assert report.returncode == 0, report.stderr
    page = (tmp_path / "report" / "index.html").read_text()
    assert "numpy_bandit" in page and "linear_thompson" in page


def test_the_ppo_of_stable_baselines_trains_on_the_shipped_preset(tmp_path):
    pytest.importorskip("torch")
    pytest.importorskip("stable_baselines3")
    text = MANIFEST.replace('name = "small"', 'name = "small"\nextends = "step_count_jitai"').replace(
        "epsilon = 0.2", "learning_rate = 1e-3"
    )
    # The agents of the preset train for longer.
    ran = with_program(tmp_path, (SHIPPED / "sb3_ppo.py").read_text(), text, "outside")
    assert ran.returncode == 0, ran.stderr + str(rows(tmp_path, "SELECT failure_message FROM run_summary"))


def test_the_ppo_of_stable_baselines_beats_tailored_messages(tmp_path):
    pytest.importorskip("torch")
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("pandas")
    means = shipped(tmp_path, "sb3_ppo|tailored")
    assert means["sb3_ppo"] > 2 * means["tailored"]
    curve = "SELECT max(episode) FROM learning_curve WHERE metric = 'mean_return'"
    assert rows(tmp_path, curve) == [(1000,)]


def in_trial(folder, program: str, agents: str, changes: dict[str, str] | None = None):
    text = (SHIPPED / "trial.toml").read_text().replace('"python3"', f'"{sys.executable}"')
    for old, new in (changes or {}).items():
        assert old in text
        text = text.replace(old, new)
    (folder / "trial.toml").write_text(text)
    (folder / "trial_bandit.py").write_text(program)
    return run("run", "trial.toml", "--filter", f"agent={agents}", cwd=folder)


def test_the_program_of_the_manual_learns_in_the_shipped_trial(tmp_path):
    program = (SHIPPED / "trial_bandit.py").read_text()
    manual = (ROOT / "docs" / "external.md").read_text()
    assert re.findall(r"```python\n(.*?)```", manual, re.DOTALL) == [program]
    ran = in_trial(tmp_path, program, "greedy")
    assert ran.returncode == 0, ran.stderr
    sql = (
        "SELECT DISTINCT round(action_probability, 6) FROM decision"
        " WHERE json_extract(state, '$.calendar_day') {} ORDER BY 1"
    )
    # The data of the first day count on the third.
    assert rows(tmp_path, sql.format("= 0")) == [(0.25,)]
    assert rows(tmp_path, sql.format(">= 2")) == [(0.05,), (0.85,)]


def test_a_trial_asks_for_the_people_in_the_study_and_hides_missing_outcomes(tmp_path):
    program = """
import numpy as np
from jitai import external
job = external.connect(trials=True)
assert job.left == 0 and job.message["trial"]["people"] == 40
class Agent:
    asked, seen, hidden = [], 0, 0
    def act(self, people, observations):
        assert observations.shape == (len(people), 3) and job.decision in (0, 1)
        self.asked.append((job.day, people.max() // 10))
        self.people = people
        return np.ones(len(people), int)
    def observe(self, people, actions, rewards):
        assert (people == self.people).all() and set(actions) == {1}
        self.seen, self.hidden = self.seen + len(people), self.hidden + np.isnan(rewards).sum()
    def update(self, day, people, before, agent):
        assert before == day - 1 and agent is None and len(people) == min((day + 6) // 7, 4) * 10
agent = Agent()
job.trial(agent)
assert {group for day, group in agent.asked if day < 21} == {0, 1, 2}
assert 0.05 < agent.hidden / agent.seen < 0.15
"""
    rule = {'rule = "tailored"': 'rule = "untailored"'}
    ran = in_trial(tmp_path, program, "greedy|tailored", rule)
    assert ran.returncode == 0, ran.stderr
    sql = "SELECT count(DISTINCT mean_return), count(*) FROM run_summary GROUP BY seed"
    assert rows(tmp_path, sql) == [(1, 2)] * 3


def test_a_program_without_trials_is_refused_in_one(tmp_path):
    program = "from jitai import external\njob = external.connect()\njob.test(lambda seen: [0] * len(seen))"
    assert in_trial(tmp_path, program, "greedy").returncode == 1
    assert 'expected `trials` = true in "ready"' in failure(tmp_path)
    (tmp_path / "jitai.sqlite").unlink()
    program = "from jitai import external\njob = external.connect(trials=True)\njob.trial(None)"
    assert with_program(tmp_path, program).returncode == 1
    assert "the job is no trial: train, and call test()" in failure(tmp_path)
