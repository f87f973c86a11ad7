"""Manifests that are checked, planned, run and reported in this process."""

from __future__ import annotations

import json
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from types import MappingProxyType

import jitai
import pytest
from conftest import MANIFEST, ROOT, run

SMALL = {
    "format": 1,
    "name": "dict",
    "scenarios": ["P-H-D"],
    "seeds": 2,
    "environment": {"sigma": [0.4, 0.6], "horizon": 10},
    "agent": [
        {"name": "tailored", "algorithm": "rule", "rule": "tailored"},
        {"name": "dqn", "algorithm": "dueling_dqn", "episodes": 20, "layers": [8], "batch": 8},
    ],
    "evaluation": {"test_episodes": 5},
    "analysis": [
        {
            "kind": "contrast",
            "name": "gap",
            "metric": "mean_return",
            "by": "agent",
            "between": ["dqn", "tailored"],
        }
    ],
}


def rows(path, sql="SELECT * FROM evaluation_episode ORDER BY job_key, episode"):
    with sqlite3.connect(f"file:{path}?mode=ro", uri=True) as connection:
        return connection.execute(sql).fetchall()


def test_a_run_stores_what_the_program_stores(store, tmp_path):
    manifest, path = tmp_path / "small.toml", tmp_path / "own.sqlite"
    manifest.write_text(MANIFEST)
    events = []
    ended = jitai.run(manifest, store=path, progress=events.append)
    assert (ended.ran, ended.completed, ended.failed, ended.left) == (16, 16, 0, 0)
    assert rows(path) == rows(store)
    columns = "SELECT job_key, metric, episode, value FROM learning_curve ORDER BY 1, 2, 3"
    assert rows(path, columns) == rows(store, columns)
    assert rows(path, "SELECT command FROM recorded_command") == [(f"jitai.run('{manifest}')",)]
    assert events[0] == {"event": "queued", "jobs": 16, "completed": 0, "failed": 0}
    assert sum(event["event"] == "completed" for event in events) == 16
    # The events are the program's.
    shutil.copy(manifest, tmp_path / "again.toml")
    ran = run("run", "again.toml", "--store", "again.sqlite", "--format", "json", cwd=tmp_path)
    assert ran.returncode == 0, ran.stderr
    lines = [json.loads(line) for line in ran.stdout.splitlines()]
    by_kind = {event["event"]: event for event in events}
    assert by_kind["completed"].keys() == next(e for e in lines if e["event"] == "completed").keys()
    again = jitai.run(manifest, store=path, progress=False)
    assert (again.ran, again.completed) == (0, 16)
    assert repr(again) == f"<jitai.Run in '{path}': nothing to run: all 16 jobs are completed>"
    with again.open() as results:
        assert len(results.runs()) == 16


def test_a_dict_is_a_manifest(tmp_path):
    path = tmp_path / "dict.sqlite"
    checked = jitai.check(SMALL)
    assert checked.jobs == 8
    assert repr(checked).startswith("dict: ok, 2 agents × 1 scenario × 2 sigma × 2 seeds = 8 jobs")
    planned = jitai.plan(SMALL, store=path, workers=3)
    assert planned.to_run == 8 and planned.experiments[0]["pending"] == 8
    assert "dict: 8 jobs, 8 pending" in repr(planned) and "with 3 workers" in repr(planned)
    assert not path.exists()
    for frames in ("pandas", "polars"):
        jobs = planned.jobs(frames=frames)
        assert len(jobs) == 8 and set(jobs["sigma"]) == {0.4, 0.6}
        assert list(jobs.columns)[:3] == ["experiment", "job_key", "agent"]
    swept = {**SMALL, "environment": {"sigma": 0.6, "delta_d": [0.1, 0.2]}}
    assert sorted(set(jitai.plan(swept, store=path).jobs()["environment.delta_d"])) == [0.1, 0.2]
    ended = jitai.run(SMALL, store=path, filter="agent=tailored", progress=False)
    assert (ended.ran, ended.completed) == (4, 4)
    jobs = jitai.plan([SMALL], store=path).jobs()
    assert dict(jobs.state.value_counts()) == {"completed": 4, "pending": 4}
    with pytest.warns(UserWarning, match="dict no longer has 4 jobs"):
        more = jitai.run(
            SMALL, store=path, set={"environment.sigma": 0.6, "seeds": 3}, progress=False
        )
    assert more.completed == 6
    with jitai.open(path) as results:
        assert set(results.runs("dict").sigma) == {0.6}
    files = tmp_path / "report"
    report = jitai.report(SMALL, store=path, out=files)
    assert report.index.read_text().startswith("<!DOCTYPE html>")
    # Seed 3 of sigma 0.6 is another manifest's, and so are two of the jobs of the DQN.
    assert report.notes == ["2 of 8 jobs of dict have no completed run"]
    assert str(report.index) in report._repr_html_()
    written = tmp_path / "dict.toml"
    written.write_bytes(rows(path, "SELECT manifest FROM manifest ORDER BY number DESC")[0][0].encode())
    with pytest.raises(ValueError, match="the same name"):
        jitai.run([SMALL, written], store=path, progress=False)


def test_reports_are_the_programs(store, tmp_path):
    manifest = tmp_path / "small.toml"
    manifest.write_text(MANIFEST)
    ours = jitai.report(manifest, store=store, out=tmp_path / "ours")
    ran = run("report", str(manifest), "--store", str(store), "--out", str(tmp_path / "theirs"))
    assert ran.returncode == 0, ran.stderr
    assert [f"note: {note}" for note in ours.notes] == ran.stderr.splitlines()
    names = [path.relative_to(tmp_path / "theirs") for path in (tmp_path / "theirs").rglob("*")]
    assert len(names) > 5
    for name in names:
        if (tmp_path / "theirs" / name).is_file():
            assert (tmp_path / "ours" / name).read_bytes() == (tmp_path / "theirs" / name).read_bytes()


def test_errors_have_the_words_of_the_program(tmp_path):
    with pytest.raises(jitai.ManifestError, match="did you mean `seeds`") as caught:
        jitai.check({**SMALL, "sedes": 3})
    [fault] = caught.value.faults
    assert fault["message"] == "unknown key `sedes`" and fault["help"] == "did you mean `seeds`?"
    assert isinstance(caught.value, ValueError)
    faulty = tmp_path / "faulty.toml"
    faulty.write_text(MANIFEST.replace("seeds = 2", "seeds = 0"))
    ran = run("check", str(faulty))
    with pytest.raises(jitai.ManifestError) as caught:
        jitai.run(faulty, store=tmp_path / "none.sqlite")
    assert str(caught.value) == ran.stderr.strip()
    assert not (tmp_path / "none.sqlite").exists()
    for error, message, keywords in [
        (TypeError, "workers: expected a whole number, found 'two'", {"workers": "two"}),
        (ValueError, "workers: expected 1 to 1024, found 0", {"workers": 0}),
        (ValueError, "no job has agent=nobody", {"filter": "agent=nobody"}),
        (ValueError, "shards are counted from 1 to 3", {"shard": "4/3"}),
        (ValueError, "checkpoint_every: expected 0.01", {"checkpoint_every": 0.0}),
        (TypeError, "replace: expected True or False", {"replace": "yes"}),
        (ValueError, "--set gama=1", {"set": {"gama": 1}}),
        (FileNotFoundError, "no folder", {"store": tmp_path / "none" / "a.sqlite"}),
    ]:
        with pytest.raises(error, match=message):
            jitai.run(SMALL, **{"store": tmp_path / "a.sqlite", "progress": False, **keywords})
    for error, message, manifest in [
        (TypeError, "expected a path or a dict, found int", 3),
        (FileNotFoundError, "nowhere.toml: no such file", "nowhere.toml"),
        (ValueError, "at least one manifest", []),
    ]:
        with pytest.raises(error, match=message):
            jitai.check(manifest)
    with pytest.raises(FileNotFoundError):
        jitai.report(SMALL, store=tmp_path / "none.sqlite", out=tmp_path / "out")


def test_most_jobs_of_an_experiment_are_removed_only_on_request(tmp_path):
    path = tmp_path / "a.sqlite"
    jitai.run(SMALL, store=path, filter="agent=tailored", progress=False)
    jitai.run(SMALL, store=path, filter="agent=tailored", progress=False)
    fewer = {**SMALL, "seeds": 1, "agent": SMALL["agent"][:1]}
    del fewer["analysis"]
    with pytest.raises(ValueError, match="this would remove 6 of 8 jobs from dict .*pass replace=True"):
        jitai.run(fewer, store=path, progress=False)
    with pytest.warns(UserWarning, match="dict no longer has 6 jobs"):
        jitai.run(fewer, store=path, progress=False, replace=True)


def test_failures_give_a_warning(tmp_path, capsys):
    failing = {
        **SMALL,
        "agent": [
            {
                "name": "broken",
                "algorithm": "external",
                "command": [sys.executable, "-c", "raise SystemExit(3)"],
                "version": "1",
                "episodes": 5,
            }
        ],
    }
    del failing["analysis"]
    with pytest.warns(RuntimeWarning, match="4 jobs run, 0 completed in all, 4 failed; the columns"):
        ended = jitai.run(failing, store=tmp_path / "a.sqlite")
    assert ended.failed == 4
    assert capsys.readouterr().err.count("failed (external)") == 1
    with pytest.warns(RuntimeWarning, match="halted after the first failure; . jobs? left"):
        halted = jitai.run(
            failing, store=tmp_path / "b.sqlite", fail_fast=True, workers=1, progress=False
        )
    assert halted.failed == 1 and halted.left == 3


LONG = {
    **{key: value for key, value in SMALL.items() if key != "analysis"},
    "name": "long",
    "environment": {"sigma": 0.6},
    "agent": [{"name": "dqn", "algorithm": "dueling_dqn", "episodes": 100_000}],
}


def test_an_exception_of_the_callback_stops_the_run(tmp_path):
    path = tmp_path / "a.sqlite"

    def refuse(event):
        if event["event"] == "progress":
            raise KeyError("mine")

    began = time.monotonic()
    with pytest.raises(KeyError, match="mine"):
        jitai.run(LONG, store=path, progress=refuse)
    assert time.monotonic() - began < 20
    assert rows(path, "SELECT DISTINCT status FROM run") == [("interrupted",)]


INTERRUPTED = """
import sys, jitai
try:
    jitai.run(MANIFEST, store=sys.argv[1], progress=lambda event: print(event["event"], flush=True))
except KeyboardInterrupt:
    print("interrupted")
"""


def test_ctrl_c_saves_the_jobs_within_two_seconds(tmp_path):
    path = tmp_path / "a.sqlite"
    program = INTERRUPTED.replace("MANIFEST", repr(LONG))
    child = subprocess.Popen(
        [sys.executable, "-c", program, str(path)], stdout=subprocess.PIPE, text=True
    )
    for line in child.stdout:
        if line == "progress\n":
            break
    sent = time.monotonic()
    child.send_signal(signal.SIGINT)
    output, _ = child.communicate(timeout=20)
    took = time.monotonic() - sent
    assert output.splitlines()[-1] == "interrupted" and child.returncode == 0
    assert took < 10, took
    assert len(list((tmp_path / "a.sqlite.checkpoints").glob("*.checkpoint"))) == 2
    assert rows(path, "SELECT DISTINCT status FROM run") == [("interrupted",)]
    assert "were interrupted; `jitai.run` continues them" in "".join(jitai.plan(LONG, store=path).notes)


def test_other_python_threads_work_during_a_run(tmp_path):
    counted = 0
    ended = threading.Event()

    def count():
        nonlocal counted
        while not ended.is_set():
            counted += 1
            time.sleep(0.001)

    counter = threading.Thread(target=count)
    counter.start()
    results = []
    manifest = {**SMALL, "seeds": 20}
    worker = threading.Thread(
        target=lambda: results.append(jitai.run(manifest, store=tmp_path / "a.sqlite", progress=False))
    )
    worker.start()
    worker.join()
    ended.set()
    counter.join()
    assert results[0].completed == 80 and counted > 5


def test_the_shipped_manifests_are_valid():
    checked = jitai.check(sorted((ROOT / "experiments").glob("*.toml")))
    assert checked.jobs > 100 and len(checked.lines) >= 5


def test_figures_are_those_of_the_report(tmp_path):
    path = tmp_path / "a.sqlite"
    curve = {"kind": "learning_curve", "name": "learning"}
    manifest = {**SMALL, "analysis": [*SMALL["analysis"], curve]}
    jitai.run(manifest, store=path, progress=False)
    jitai.report(manifest, store=path, out=tmp_path / "report")
    with jitai.open(path) as results:
        figures = results.plot()
        assert {figure.analysis for figure in figures} == {"gap", "learning"}
        for figure in figures:
            written = (tmp_path / "report" / "figures" / f"{figure.name}.svg").read_text()
            assert figure._repr_svg_() == figure.svg == written
        assert all(figure.svg in figures._repr_html_() for figure in figures)
        learning = results.plot("dict", "learning")
        assert {figure.analysis for figure in learning} == {"learning"}
        learning[0].save(tmp_path / "saved.svg")
        assert (tmp_path / "saved.svg").read_text() == learning[0].svg
        with pytest.raises(ValueError, match="a figure is an SVG image, found the ending '.png'"):
            learning[0].save(tmp_path / "saved.png")
        assert not (tmp_path / "saved.png").exists()
        other = results.plot(manifest={**manifest, "analysis": [{**curve, "name": "other"}]})
        assert [figure.caption for figure in other] == [figure.caption for figure in learning]
        for error, message, arguments in [
            (ValueError, "no analysis `lerning` .did you mean `learning`..; the manifest declares gap, learning", ("dict", "lerning")),
            (ValueError, "no experiment `dct`", ("dct",)),
        ]:
            with pytest.raises(error, match=message):
                results.plot(*arguments)
    with pytest.raises(ValueError, match="declares no ..analysis"):
        bare = {key: value for key, value in SMALL.items() if key != "analysis"}
        jitai.open(path).plot(manifest=bare)


def test_sequences_and_mappings_of_all_kinds_are_values(tmp_path, monkeypatch):
    manifest = MappingProxyType({**SMALL, "seeds": range(1, 3)})
    expected = jitai.check({**SMALL, "seeds": [1, 2]})
    assert jitai.check(manifest) == expected
    with pytest.raises(TypeError, match="found bytes"):
        jitai.check({**SMALL, "name": b"dict"})
    with pytest.raises(ValueError, match="seeds`: expected a whole number of 64 bits, found 9223372036854775808"):
        jitai.check({**SMALL, "seeds": 2**63})
    monkeypatch.chdir(tmp_path)
    assert jitai.run(manifest, store="here.sqlite", progress=False).store == str(tmp_path / "here.sqlite")
