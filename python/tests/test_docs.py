"""The manual's examples run, in order, in a folder with results of the quickstart."""

from __future__ import annotations

import importlib.util
import re
import shutil

import pytest
from conftest import PEOPLE, ROOT, run

MANUAL = ROOT / "docs" / "python.md"
NOTEBOOKS = ROOT / "docs" / "notebooks.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the quickstart, and a store with a small experiment of the same name."""
    folder = tmp_path_factory.mktemp("manual")
    (folder / "experiments").mkdir()
    shutil.copy(ROOT / "experiments" / "quickstart.toml", folder / "experiments")
    (folder / "experiments" / "oralytics").mkdir()
    shutil.copy(PEOPLE / "synthetic_v2.csv", folder / "experiments" / "oralytics")
    (folder / "small.toml").write_text(
        'format = 1\nname = "quickstart"\nscenarios = ["P-H-D"]\nseeds = 2\n'
        "environment.sigma = 0.6\nevaluation.test_episodes = 10\n"
        '[[agent]]\nname = "dqn"\nalgorithm = "dueling_dqn"\nepisodes = 10\n'
    )
    ran = run("run", "small.toml", "--quiet", cwd=folder)
    assert ran.returncode == 0, ran.stderr
    return folder


def blocks_of(page):
    return re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)


def examples():
    blocks = blocks_of(MANUAL)
    # An outside agent needs jitai at its other end: test_external.py runs it.
    blocks = [block for block in blocks if "external.connect" not in block]
    assert len(blocks) >= 7
    return blocks


def test_the_examples_run(folder, monkeypatch):
    monkeypatch.chdir(folder)
    names: dict = {}
    for block in examples():
        if "Stable-Baselines3" in block and importlib.util.find_spec("stable_baselines3") is None:
            continue
        exec(compile(block, str(MANUAL), "exec"), names)
    assert names["total"] > 0 and len(names["means"]) == 1
    assert names["policy"].weights["trunk.0.weight"].shape[0] == 3


def test_the_example_for_stable_baselines_runs():
    pytest.importorskip("torch")
    [block] = [block for block in examples() if "# With Stable-Baselines3." in block]
    exec(compile(block, str(MANUAL), "exec"), {})


def test_the_examples_of_experiments_run(tmp_path, monkeypatch):
    pytest.importorskip("pandas")
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for block in blocks_of(NOTEBOOKS):
        exec(compile(block, str(NOTEBOOKS), "exec"), names)
    assert len(names["means"]) == 4 and (tmp_path / "first" / "index.html").is_file()


def test_the_example_of_a_fit_runs(tmp_path, monkeypatch):
    pytest.importorskip("pandas")
    (tmp_path / "experiments").symlink_to(ROOT / "experiments")
    monkeypatch.chdir(tmp_path)
    [block] = blocks_of(ROOT / "docs" / "fit.md")
    names: dict = {}
    exec(compile(block, "docs/fit.md", "exec"), names)
    assert len(names["fitted"].people) == 32 and names["environment"]["people"].startswith("brushing")
