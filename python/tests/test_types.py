"""What type checkers and notebooks know of the package."""

from __future__ import annotations

import inspect
import subprocess
import sys

import jitai
import pytest
from conftest import PEOPLE, ROOT
from jitai._keywords import Keywords, VectorKeywords

#: Keywords that are no keys of a family.
OTHERS = {
    "environment",
    "extends",
    "family",
    "manifest",
    "parameters",
    "population",
    "render_mode",
    "scenario",
    "state_in_info",
}

USE = """
import jitai

env = jitai.make(sigma=0.6, population={"epsilon_d": {"uniform": [0.2, 0.6]}})
actions: int = int(env.action_space.n)
low: float = float(env.observation_space.low[0])
lanes: int = int(jitai.make_vec(4, sigma=0.6, autoreset_mode="SameStep").single_action_space.n)
ended: int = jitai.run({"name": "a"}, progress=print).completed
with jitai.open("a.sqlite") as store:
    frame = store.query("SELECT ?", [1])
    store.plot("a")[0].save("a.svg")
"""


def test_the_keywords_are_the_keys_of_the_families():
    known = set()
    model = ROOT / "experiments" / "models" / "ten_lines.toml"
    for keywords in (
        {"sigma": 0.6},
        {"family": "declared", "model": model},
        {"family": "declared", "model": "oralytics_v2", "people": PEOPLE / "synthetic_v2.csv"},
    ):
        known |= set(jitai.make(**keywords).unwrapped.declaration.keys)
    assert set(Keywords.__annotations__) == known | OTHERS
    assert set(inspect.signature(jitai.make).parameters) == known | OTHERS
    of_lanes = set(inspect.signature(jitai.make_vec).parameters)
    assert of_lanes == set(VectorKeywords.__annotations__) | {"num_envs"}


def test_a_type_checker_accepts_the_use_of_the_package(tmp_path):
    pytest.importorskip("mypy")
    for name, text, errors in [
        ("right.py", USE, ""),
        ("wrong.py", USE.replace("sigma=0.6, pop", "sigmma=0.6, pop"), '"sigmma" for "make"'),
        ("other.py", USE.replace("action_space.n)", "action_space.m)", 1), 'no attribute "m"'),
    ]:
        (tmp_path / name).write_text(text)
        checked = subprocess.run(
            [sys.executable, "-m", "mypy", "--strict", name],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        assert errors in checked.stdout and (checked.returncode == 0) == (not errors), checked.stdout
