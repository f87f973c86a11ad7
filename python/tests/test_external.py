"""Outside agents in Python: run by the program of the wheel, beside our own."""

from __future__ import annotations

import re
import shutil
import sqlite3
import sys

import jitai
import pytest
from conftest import ROOT, run

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


def with_program(folder, program: str, manifest: str = MANIFEST, **options: str):
    (folder / "small.toml").write_text(manifest.format(python=sys.executable, **options))
    (folder / "program.py").write_text(program)
    return run("run", "small.toml", cwd=folder)


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
    env.reset(seed=job.seed if not returns else None)
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


def test_the_ppo_of_stable_baselines_beats_tailored_messages(tmp_path):
    pytest.importorskip("torch")
    pytest.importorskip("stable_baselines3")
    pytest.importorskip("pandas")
    means = shipped(tmp_path, "sb3_ppo|tailored")
    assert means["sb3_ppo"] > 2 * means["tailored"]
    curve = "SELECT max(episode) FROM learning_curve WHERE metric = 'mean_return'"
    assert rows(tmp_path, curve) == [(1000,)]
