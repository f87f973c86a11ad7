"""The notebooks of the documentation run, cell by cell."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import pytest
from conftest import ROOT


def shown(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[dict, list]:
    """Runs a notebook in a folder: its names, and the values that it shows."""
    pytest.importorskip("pandas")
    monkeypatch.chdir(folder)
    path = ROOT / "docs" / name
    notebook = json.loads(path.read_text(encoding="utf-8"))
    names: dict = {}
    values = []
    for cell in notebook["cells"]:
        if cell["cell_type"] != "code":
            continue
        assert cell["outputs"] == [] and cell["execution_count"] is None, "outputs are not kept"
        # Like a notebook: the value of a last expression is shown.
        parsed = ast.parse("".join(cell["source"]), str(path))
        last = parsed.body.pop() if isinstance(parsed.body[-1], ast.Expr) else None
        exec(compile(parsed, str(path), "exec"), names)
        if last is not None:
            values.append(eval(compile(ast.Expression(last.value), str(path), "eval"), names))
    return names, values


def test_the_tour_runs(tmp_path, monkeypatch):
    names, values = shown("tour.ipynb", tmp_path, monkeypatch)
    texts = [repr(value) for value in values]
    assert texts[0].startswith("tour: ok, 2 agents × 2 scenarios × 5 seeds = 20 jobs")
    assert any("20 jobs run, 20 completed in all, 0 failed" in text for text in texts)
    figures = [value for value in values if hasattr(value, "_repr_html_") and hasattr(value, "_repr_svg_")]
    assert len(figures) == 2 and all("<svg" in one._repr_html_() for one in figures)
    assert set(names["store"].runs("tour").agent) == {"reinforce", "tailored", "bandit"}
    assert len(names["store"].runs("walks")) == 6
    assert names["total"] > 0 and (tmp_path / "tour" / "index.html").is_file()


def test_the_road_from_a_pilot_runs(tmp_path, monkeypatch):
    (tmp_path / "experiments").symlink_to(ROOT / "experiments")
    (tmp_path / "docs").mkdir()
    names, values = shown("pilot.ipynb", tmp_path / "docs", monkeypatch)
    assert names["fitted"].is_fitted and len(names["fitted"].people) == 37
    assert any("<svg" in value._repr_html_() for value in values if isinstance(value, type(names["fitted"].figures)))
    # Each file of people has an effect of its own.
    assert len(values[-1]) >= 4 and values[-1]["count"].sum() == 160
