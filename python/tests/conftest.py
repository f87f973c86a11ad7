"""Fixtures of all tests: the program of the wheel, and stores that the program has filled."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).resolve().parent.parent.parent
#: The models of Oralytics, with invented people.
PEOPLE = ROOT / "experiments" / "oralytics"
PROGRAM = Path(sys.executable).parent / "jitai"

settings.register_profile(
    "tests",
    deadline=None,
    derandomize=True,
    max_examples=int(os.environ.get("JITAI_EXAMPLES", "100")),
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("tests")


def run(*arguments: str, **keywords) -> subprocess.CompletedProcess[str]:
    """Runs the program of the wheel."""
    return subprocess.run(
        [str(PROGRAM), *arguments], capture_output=True, text=True, check=False, **keywords
    )


MANIFEST = """\
format = 1
name = "small"
scenarios = ["P-H-D", "L-T"]
seeds = 2

[environment]
sigma = 0.6
horizon = 10

[population]
epsilon_d = { uniform = [0.2, 0.6] }

[[agent]]
name = "dqn"
algorithm = "dueling_dqn"
episodes = 30
layers = [16, 8]
batch = 16
trunk = ["shared", "separate"]

[[agent]]
name = "reinforce"
algorithm = "reinforce"
episodes = 40
layers = [16]

[[agent]]
name = "tailored"
algorithm = "rule"
rule = "tailored"

[evaluation]
test_episodes = 20
record_decisions = "test"
"""


# An experiment without learning curves, decisions, participants and failures.
PLAIN = """\
format = 1
name = "plain"
scenarios = ["P-H-D"]
seeds = 1
environment.sigma = 0.6
evaluation.test_episodes = 5
[[agent]]
name = "tailored"
algorithm = "rule"
rule = "tailored"
"""


@pytest.fixture(scope="session")
def plain(tmp_path_factory) -> Path:
    """A store with one completed job of a rule."""
    folder = tmp_path_factory.mktemp("plain")
    (folder / "plain.toml").write_text(PLAIN)
    ran = run("run", "plain.toml", "--quiet", cwd=folder)
    assert ran.returncode == 0, ran.stderr
    return folder / "jitai.sqlite"


@pytest.fixture(scope="session")
def store(tmp_path_factory) -> Path:
    """A store with 16 completed jobs of three kinds of agents."""
    folder = tmp_path_factory.mktemp("store")
    manifest = folder / "small.toml"
    manifest.write_text(MANIFEST)
    path = folder / "small.sqlite"
    ran = run("run", str(manifest), "--store", str(path), "--quiet")
    assert ran.returncode == 0, ran.stderr
    return path
