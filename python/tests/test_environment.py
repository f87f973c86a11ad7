"""Environments of one's own: programs that answer jitai, whose side these tests take."""

from __future__ import annotations

import array
import base64
import json
import re
import subprocess
import sys
from typing import ClassVar

import gymnasium
import jitai
import numpy as np
import pytest
from conftest import ROOT, run

SHIPPED = ROOT / "experiments" / "external"


class Conversation:
    """A started program."""

    started: ClassVar[list[subprocess.Popen]] = []

    def __init__(self, *words: str, parameters: dict | None = None) -> None:
        pipe = subprocess.PIPE
        self.program = subprocess.Popen(words, stdin=pipe, stdout=pipe, stderr=pipe, text=True)
        Conversation.started.append(self.program)
        self.describe = {"protocol": 1, "jitai": "0", "version": "1", "parameters": parameters or {}}
        self.description = self.ask("describe", **self.describe)

    def say(self, kind: str, **fields) -> None:
        self.program.stdin.write(json.dumps({"type": kind, **fields}) + "\n")
        self.program.stdin.flush()

    def ask(self, kind: str, **fields) -> dict:
        self.say(kind, **fields)
        line = self.program.stdout.readline()
        assert line, self.program.stderr.read()
        return {name: numbers(value) if name != "type" else value for name, value in json.loads(line).items()}

    def begin(self, instance: int, lanes: int, state: bool = False) -> None:
        self.say("begin", instance=instance, lanes=lanes, phase="check", state=state)

    def reset(self, instance: int, lanes: list[int], seeds: list[int]) -> dict:
        return self.ask("reset", instance=instance, lanes=lanes, seeds=seeds)

    def step(self, instance: int, lanes: list[int], actions: list[int]) -> dict:
        return self.ask("step", instance=instance, lanes=lanes, actions=actions)

    def end(self) -> str:
        """Ends the program; returns what it wrote to standard error."""
        self.say("end")
        said = self.program.communicate(timeout=60)[1]
        assert self.program.returncode == 0, said
        return said


@pytest.fixture(autouse=True)
def _ends_programs():
    yield
    while Conversation.started:
        program = Conversation.started.pop()
        program.kill()
        # Also of a test that failed before it read everything.
        for pipe in (program.stdin, program.stdout, program.stderr):
            pipe.close()
        program.wait()


def numbers(value):
    """The numbers of a text in base64; anything else as it is."""
    if not isinstance(value, str):
        return value
    try:
        return np.frombuffer(base64.b64decode(value, validate=True), "<f8").tolist()
    except ValueError:
        return value


def program(tmp_path, text: str, parameters: dict | None = None) -> Conversation:
    (tmp_path / "program.py").write_text(text)
    return Conversation(sys.executable, str(tmp_path / "program.py"), parameters=parameters)


def failure(tmp_path, text: str, parameters: dict | None = None) -> str:
    """The standard error of a program that cannot describe its environment."""
    (tmp_path / "program.py").write_text(text)
    describe = {"type": "describe", "protocol": 1, "parameters": parameters or {}}
    ran = subprocess.run(
        [sys.executable, str(tmp_path / "program.py")],
        input=json.dumps(describe) + "\n",
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 1 and ran.stdout == ""
    return ran.stderr


def test_the_shipped_cartpole_is_gymnasiums():
    assert len((SHIPPED / "cartpole.py").read_text().splitlines()) <= 10
    served = Conversation(sys.executable, str(SHIPPED / "cartpole.py"))
    names = [feature["name"] for feature in served.description["features"]]
    assert names == ["position", "velocity", "angle", "angular_velocity"]
    assert served.description["features"][0]["high"] == pytest.approx(4.8)
    assert served.description["features"][1]["high"] is None
    assert (served.description["actions"], served.description["horizon"]) == (["left", "right"], 500)
    env = gymnasium.make("CartPole-v1")
    expected = env.reset(seed=2**52 + 3)[0].tolist()
    served.begin(1, 3)
    served.begin(2, 1)
    assert served.reset(1, [0, 2], [5, 2**52 + 3])["observations"][4:] == expected
    assert served.reset(2, [0], [2**52 + 3])["observations"] == expected
    for step in range(30):
        observation, reward, terminated, _, _ = env.step(step % 2)
        answers = [served.step(1, [2], [step % 2]), served.step(2, [0], [step % 2])]
        for answer in answers:
            assert answer["type"] == "stepped" and answer["rewards"] == [reward]
            assert answer["observations"] == observation.tolist()
            assert answer.get("terminated", [0.0]) == [float(terminated)]
        if terminated:
            break
    served.say("close", instance=2)
    served.end()


SPACES = """
import gymnasium, numpy as np
from gymnasium import spaces
from jitai import environment

class Study(gymnasium.Env):
    def __init__(self, places=3, dose=1.0):
        mood = spaces.Box(0, 1, (1,))
        self.observation_space = spaces.Dict(place=spaces.Discrete(places), mood=mood)
        self.action_space = spaces.Discrete(3, start=1)
        self.dose = dose

    def seen(self):
        return {"place": 1, "mood": np.array([0.5], np.float32)}

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self.count = 0
        print("reset", seed)
        return self.seen(), {"burden": 0.25, "available": True}

    def step(self, action):
        self.count += 1
        infos = {"burden": self.count / 10, "available": self.count % 2 == 0}
        return self.seen(), self.dose * int(action), False, False, infos
"""


def test_spaces_are_flattened_and_infos_become_the_state(tmp_path):
    serve = 'environment.serve(Study, horizon=3, state=["burden"], nothing="a0", availability=True)'
    served = program(tmp_path, SPACES + serve, {"places": 2, "dose": 0.5})
    features = served.description["features"]
    assert [feature["name"] for feature in features] == ["place_0", "place_1", "mood"]
    assert [(feature["low"], feature["high"]) for feature in features] == [(0.0, 1.0)] * 3
    assert served.description["actions"] == ["a0", "a1", "a2"]
    assert served.description["nothing"] == "a0" and served.description["horizon"] == 3
    served.begin(1, 2, state=True)
    began = served.reset(1, [0, 1], [7, 8])
    assert (began["observations"], began["state"]) == ([0.0, 1.0, 0.5] * 2, [0.25, 0.25])
    answers = [served.step(1, [0, 1], [0, 2]) for _ in range(3)]
    assert [answer["rewards"] for answer in answers] == [[0.5, 1.5]] * 3
    assert [answer["available"] for answer in answers] == [[0.0, 0.0], [1.0, 1.0], [0.0, 0.0]]
    assert [answer["state"][0] for answer in answers] == [0.1, 0.2, 0.3]
    assert ["truncated" in answer for answer in answers] == [False, False, True]
    served.begin(2, 1)
    assert "state" not in served.reset(2, [0], [1])
    assert served.end().splitlines()[:2] == ["reset 7", "reset 8"]


@pytest.mark.parametrize("kind", ["serve", "serve_lanes"])
def test_seeds_are_hashed_to_the_size_that_an_environment_takes(tmp_path, kind):
    single = 'environment.serve(Study, horizon=3, seed_bits=32)'
    lanes = """
class Lanes:
    def __init__(self, lanes):
        pass

    def reset(self, lanes, seeds):
        for seed in seeds:
            print("reset", seed)
        return np.zeros((len(lanes), 1)), {}


environment.serve_lanes(Lanes, features=["x"], actions=["a", "b"], horizon=3, seed_bits=32)
"""
    served = program(tmp_path, SPACES + (single if kind == "serve" else lanes))
    served.begin(1, 4)
    # Seeds that have their last 32 bits in common remain different.
    served.reset(1, [0, 1, 2, 3], [7, 7 + 2**32, 2**53 - 1, 7])
    seeds = [int(line.removeprefix("reset ")) for line in served.end().splitlines()]
    assert len(seeds) == 4 and max(seeds) < 2**32
    assert seeds[0] == seeds[3] and len(set(seeds)) == 3
    # Results of stored jobs depend on these numbers.
    assert seeds[0] == 3231705258


@pytest.mark.parametrize(
    ("serve", "parameters", "expected"),
    [
        ("environment.serve(Study)", {}, "the environment has no max_episode_steps; pass horizon="),
        ("environment.serve(Study, horizon=3)", {"dos": 1}, "unexpected keyword argument 'dos'"),
        ("environment.serve(Study(), horizon=3)", {"dose": 1}, "from the parameters dose"),
        ('environment.serve(Study, horizon=3, features=["x"])', {}, "expected 4 features, place_0, place_1, place_2, mood; found 1"),
        (
            'environment.serve(Study, horizon=3, features=["mood", "a", "b", "c"])',
            {},
            "the entries of observations are, in this order, place_0, place_1, place_2, mood",
        ),
        ('environment.serve(Study, horizon=3, actions=["x"])', {}, "expected 3 names of actions, found 1"),
        ('environment.serve("Pendulum-v1")', {}, "expected a Discrete action space"),
        ('environment.serve("NoSuch-v1")', {}, "NoSuch"),
        ("environment.serve(Study, horizon=3, seed_bits=0)", {}, "expected seed_bits from 1 to 64, found 0"),
    ],
)
def test_what_cannot_be_served_is_named(tmp_path, serve, parameters, expected):
    assert expected in failure(tmp_path, SPACES + serve, parameters)


def test_features_with_the_names_of_entries_are_matched_by_name(tmp_path):
    mood = '{"name": "mood", "unit": "points"}'
    serve = f'environment.serve(Study, horizon=3, features=[{mood}, "place_1", "place_0"])'
    served = program(tmp_path, SPACES + serve, {"places": 2})
    features = served.description["features"]
    assert [feature["name"] for feature in features] == ["place_0", "place_1", "mood"]
    assert features[2]["unit"] == "points"
    served.begin(1, 1)
    assert served.reset(1, [0], [1])["observations"] == [0.0, 1.0, 0.5]
    served.end()


def test_a_missing_state_is_named(tmp_path):
    served = program(tmp_path, SPACES + 'environment.serve(Study, horizon=3, state=["mood"])')
    served.begin(1, 1, state=True)
    served.say("reset", instance=1, lanes=[0], seeds=[1])
    said = served.program.communicate(timeout=60)[1]
    assert "the state has 'mood', but infos have only ['available', 'burden']" in said


def test_a_single_environment_is_copied_for_every_lane(tmp_path):
    served = program(tmp_path, SPACES + "environment.serve(Study(dose=2.0), horizon=5)")
    served.begin(1, 2)
    served.reset(1, [0, 1], [1, 2])
    assert served.step(1, [1], [0])["rewards"] == [2.0]
    assert served.step(1, [0, 1], [0, 1])["rewards"] == [2.0, 4.0]
    served.end()


def test_the_agents_train_on_the_shipped_environments_and_ppo_solves_cartpole(tmp_path):
    for name in ("cartpole", "two_messages"):
        for kind in (".toml", ".py"):
            text = (SHIPPED / f"{name}{kind}").read_text()
            (tmp_path / f"{name}{kind}").write_text(text.replace('"python3"', json.dumps(sys.executable)))
    manifests = ["cartpole.toml", "two_messages.toml"]
    for command in (["run", *manifests, "--quiet"], ["report", *manifests, "--out", "report"]):
        ran = run(*command, cwd=tmp_path)
        assert ran.returncode == 0, ran.stderr
    with jitai.open(tmp_path / "jitai.sqlite") as store:
        runs = store.query("SELECT experiment, agent, mean_return FROM run_summary WHERE status = 'completed'")
    means = {}
    for experiment, agent, value in zip(runs["experiment"], runs["agent"], runs["mean_return"]):
        means.setdefault((experiment, agent), []).append(value)
    assert {agent for _, agent in means} == {"ppo", "dqn", "reinforce", "thompson"}
    # The usual bar, over 100 episodes.
    assert min(means["cartpole", "ppo"]) >= 475, means
    assert np.mean(means["two_messages", "ppo"]) > 400 > np.mean(means["two_messages", "thompson"]), means
    assert (tmp_path / "report" / "figures" / "cartpole-learning-all.svg").is_file()


def manual() -> list[str]:
    text = (ROOT / "docs" / "outside-environments.md").read_text()
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)


def test_the_programs_of_the_manual_run(tmp_path):
    single, many = manual()
    assert single in (SHIPPED / "cartpole.py").read_text()
    served = program(tmp_path, many, {"drift": 1.0})
    served.begin(1, 4)
    assert served.reset(1, [0, 1, 3], [9, 4, 9])["observations"] == [0.0] * 3
    for step in range(1, 51):
        answer = served.step(1, [0, 1, 3], [1, 0, 1])
        place = answer["observations"]
        assert place[0] == place[2] != 0.0 and place[1] == 0.0
        assert answer.get("truncated") == ([1.0] * 3 if step == 50 else None)
    served.end()


def test_the_plain_program_needs_no_packages():
    words = [sys.executable, "-I", "-S", str(SHIPPED / "two_messages.py")]
    plain = Conversation(*words, parameters={"dose": 1.0, "fatigue": 0.2})
    assert [feature["name"] for feature in plain.description["features"]] == ["receptivity", "burden", "day"]
    plain.begin(1, 2, state=True)
    first = plain.reset(1, [0, 1], [3, 3])
    assert first["observations"][0] == first["observations"][1]
    sent = plain.step(1, [0, 1], [1, 0])
    assert sent["observations"][0][1] == pytest.approx(0.3)
    assert sent["observations"][1][1] == pytest.approx(0.08)
    assert sent["rewards"][0] > sent["rewards"][1]
    plain.end()


def test_the_module_needs_neither_the_simulation_nor_its_environments():
    check = "import sys, jitai.environment; print([name for name in sys.modules if name.startswith('jitai._')])"
    ran = subprocess.run([sys.executable, "-c", check], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "['jitai._keywords', 'jitai._registration']"


def test_a_program_that_jitai_did_not_start_says_what_to_do():
    text = array.array("d", [0.5]).tobytes()
    assert numbers(base64.b64encode(text).decode()) == [0.5]
    check = "import pty, os, sys; sys.exit(pty.spawn(sys.argv[1:]) and 1)"
    words = [sys.executable, "-c", check, sys.executable, str(SHIPPED / "cartpole.py")]
    ran = subprocess.run(words, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL)
    assert "name it as `command` in a manifest" in ran.stdout + ran.stderr
