"""The notebook of the documentation runs, cell by cell."""

from __future__ import annotations

import ast
import json

import pytest
from conftest import ROOT

TOUR = ROOT / "docs" / "tour.ipynb"


def test_the_tour_runs(tmp_path, monkeypatch):
    pytest.importorskip("pandas")
    monkeypatch.chdir(tmp_path)
    notebook = json.loads(TOUR.read_text(encoding="utf-8"))
    names: dict = {}
    shown = []
    for cell in notebook["cells"]:
        if cell["cell_type"] != "code":
            continue
        assert cell["outputs"] == [] and cell["execution_count"] is None, "outputs are not kept"
        # Like a notebook: the value of a last expression is shown.
        parsed = ast.parse("".join(cell["source"]), str(TOUR))
        last = parsed.body.pop() if isinstance(parsed.body[-1], ast.Expr) else None
        exec(compile(parsed, str(TOUR), "exec"), names)
        if last is not None:
            shown.append(eval(compile(ast.Expression(last.value), str(TOUR), "eval"), names))
    texts = [repr(value) for value in shown]
    assert texts[0].startswith("tour: ok, 2 agents × 2 scenarios × 5 seeds = 20 jobs")
    assert any("20 jobs run, 20 completed in all, 0 failed" in text for text in texts)
    figures = [value for value in shown if hasattr(value, "_repr_html_") and hasattr(value, "_repr_svg_")]
    assert len(figures) == 2 and all("<svg" in one._repr_html_() for one in figures)
    assert set(names["store"].runs("tour").agent) == {"reinforce", "tailored", "bandit"}
    assert len(names["store"].runs("walks")) == 6
    assert names["total"] > 0 and (tmp_path / "tour" / "index.html").is_file()
