"""Experiments: manifests that are checked, planned, run and reported in this process."""

from __future__ import annotations

import html
import os
import re
import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jitai import _jitai
from jitai._jitai import ManifestError
from jitai._store import Store, library, of_rows

__all__ = ["Checked", "ManifestError", "Plan", "Report", "Run", "check", "plan", "report", "run"]

#: A manifest: the path of a TOML file, or a dict of its keys.
Manifest = str | os.PathLike[str] | Mapping[str, Any]
#: The store of a call that names none.
STORE = "jitai.sqlite"
#: Seconds between two lines of progress without a bar.
BETWEEN_LINES = 5.0


def _arguments(manifest: Manifest | Sequence[Manifest], **others: Any) -> dict[str, Any]:
    """The arguments of a call of the native module."""
    manifests: list[Any] = [manifest]
    if isinstance(manifest, Sequence) and not isinstance(manifest, (str, bytes)):
        manifests = list(manifest)
    if not manifests:
        raise ValueError("manifest: expected at least one manifest, found none")
    manifests = [dict(one) if isinstance(one, Mapping) else one for one in manifests]
    return {"manifests": manifests, **others}


@dataclass(frozen=True)
class Checked:
    """The result of :func:`check`."""

    #: Number of jobs.
    jobs: int
    #: The jobs of each manifest as a product of factors.
    lines: list[str] = field(repr=False)
    #: What is valid, but perhaps not meant.
    hints: list[str] = field(repr=False)

    def __repr__(self) -> str:
        return "\n".join([*self.lines, *(f"hint: {hint}" for hint in self.hints)])


def check(
    manifest: Manifest | Sequence[Manifest],
    *,
    set: Mapping[str, Any] | None = None,  # noqa: A002
    store: str | os.PathLike[str] = STORE,
) -> Checked:
    """Checks manifests, as ``jitai check`` does.

    Raises :class:`ManifestError` with all faults. ``set`` replaces keys, such as ``{"agent.gamma": 0.9}``.
    """
    checked = _jitai.check(_arguments(manifest, set=set and dict(set), store=store))
    lines, hints = [], []
    for name, _, (first, *rest), of_manifest in checked:
        lines += [f"{name}: ok, {first}", *(f"  {line}" for line in rest)]
        hints += of_manifest
    return Checked(sum(jobs for _, jobs, _, _ in checked), lines, hints)


@dataclass(frozen=True)
class Plan:
    """The result of :func:`plan`."""

    #: One dict for each experiment: its name, its jobs by state, and the estimated seconds left.
    experiments: list[dict[str, Any]] = field(repr=False)
    #: Number of jobs that :func:`run` would run.
    to_run: int
    #: The estimated time of these jobs.
    seconds_left: float | None
    #: What ``jitai plan`` says about the jobs.
    notes: list[str] = field(repr=False)
    _arguments: dict[str, Any] = field(repr=False)

    def jobs(self, *, frames: str | None = None) -> Any:
        """A data frame of the jobs: a row each, with its state and a column for every key that is swept."""
        rows = []
        for job in _jitai.plan(self._arguments, True):
            named = ("experiment", "job_key", "agent", "scenario", "sigma", "seed", "state", "reason")
            swept = {name: value for name, value in job["swept"].items() if name not in named}
            rows.append({**{name: job[name] for name in named}, **swept})
        return of_rows(rows, library(frames))

    def __repr__(self) -> str:
        states = ("completed", "running", "failed", "interrupted", "pending")
        lines = []
        for one in self.experiments:
            counts = ", ".join(f"{one[state]} {state}" for state in states if one[state])
            lines.append(f"{one['experiment']}: {one['jobs']} jobs, {counts}")
        return "\n".join([*lines, *self.notes])


def plan(
    manifest: Manifest | Sequence[Manifest],
    *,
    store: str | os.PathLike[str] = STORE,
    workers: int | None = None,
    set: Mapping[str, Any] | None = None,  # noqa: A002
    filter: str | None = None,  # noqa: A002
    shard: str | None = None,
) -> Plan:
    """Shows which jobs :func:`run` would run, why, and how long they would take, as ``jitai plan`` does."""
    arguments = _arguments(
        manifest, store=store, workers=workers, set=set and dict(set), filter=filter, shard=shard
    )
    planned = _jitai.plan(arguments, False)
    return Plan(**planned, _arguments=arguments)


@dataclass(frozen=True)
class Run:
    """The result of :func:`run`."""

    #: The absolute path of the store.
    store: str
    #: Number of jobs that ran to their end.
    ran: int
    #: Number of completed jobs, including those of earlier runs.
    completed: int
    #: Number of failed jobs, including those of earlier runs.
    failed: int
    #: Number of jobs that have not ended.
    left: int
    #: The end in words.
    line: str = field(repr=False)

    def open(self, *, frames: str | None = None) -> Store:
        """Opens the store."""
        return Store(self.store, frames=frames)

    def __repr__(self) -> str:
        return f"<jitai.Run in {self.store!r}: {self.line}>"


def run(
    manifest: Manifest | Sequence[Manifest],
    *,
    store: str | os.PathLike[str] = STORE,
    workers: int | None = None,
    progress: bool | Callable[[dict[str, Any]], object] = True,
    set: Mapping[str, Any] | None = None,  # noqa: A002
    filter: str | None = None,  # noqa: A002
    shard: str | None = None,
    retry_failed: bool = False,
    fail_fast: bool = False,
    replace: bool = False,
    checkpoint_every: float = 20.0,
) -> Run:
    """Runs the jobs of manifests that have no completed run, as ``jitai run`` does, in threads of this process.

    Ctrl-C saves every running job, and raises ``KeyboardInterrupt``; the same call resumes. ``progress`` is a bar,
    or a function that is called with a dict for each event. Failed jobs give a ``RuntimeWarning``.
    """
    arguments = _arguments(
        manifest,
        store=store,
        workers=workers,
        set=set and dict(set),
        filter=filter,
        shard=shard,
        retry_failed=retry_failed,
        fail_fast=fail_fast,
        replace=replace,
        checkpoint_every=checkpoint_every,
    )
    arguments["call"] = f"jitai.run({', '.join(map(_named, arguments['manifests']))})"
    if callable(progress):
        ended = _jitai.run(arguments, progress)
    elif progress:
        with _Progress() as shown:
            ended = _jitai.run(arguments, shown)
    else:
        ended = _jitai.run(arguments, None)
    for note in ended.pop("notes"):
        warnings.warn(note, stacklevel=2)
    del ended["event"]
    result = Run(store=os.path.abspath(os.fspath(store)), **ended)
    if result.failed:
        reasons = "the columns failure_kind and failure_message of runs() have the reasons"
        warnings.warn(f"{result.line}; {reasons}", RuntimeWarning, stacklevel=2)
    return result


def _named(manifest: Any) -> str:
    """A manifest in the list of commands that changed a store."""
    if isinstance(manifest, Mapping):
        return f"{{'name': {manifest.get('name')!r}, …}}"
    return repr(os.fspath(manifest))


class _Progress:
    """Shows a run on standard error: a bar if tqdm is installed, else lines."""

    def __init__(self) -> None:
        self._jobs = self._done = self._failed = 0
        self._failures: set[str] = set()
        self._bar: Any = None
        self._written = time.monotonic()

    def __enter__(self) -> _Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.close()

    def __call__(self, event: dict[str, Any]) -> None:
        kind = event["event"]
        if kind == "queued":
            self._begin(event["jobs"])
        elif kind in ("completed", "failed", "skipped"):
            self._done += 1
            self._failed += kind == "failed"
            if kind == "failed":
                self._say_failure(event)
            self._show(self._done)
        elif kind == "progress":
            self._show(event["done"])
        elif kind in ("checkpoint_refused", "checkpoint_not_kept"):
            what = "rejected" if kind == "checkpoint_refused" else "not written"
            self._say(f"{_name(event['job'])}: checkpoint {event['file']} {what}: {event['reason']}")
        elif kind == "fewer_workers":
            self._say(f"only {event['started']} workers started: {event['reason']}")

    def _begin(self, jobs: int) -> None:
        # A race queues the jobs of one stage after the other.
        self._jobs += jobs
        if self._bar is not None:
            self._bar.total = self._jobs
            return
        try:
            from tqdm.auto import tqdm
        except ImportError:
            return
        if jobs:
            shape = "{l_bar}{bar}| {n:.1f}/{total} jobs [{elapsed}<{remaining}{postfix}]"
            self._bar = tqdm(total=jobs, bar_format=shape)

    def _show(self, done: float) -> None:
        if self._bar is not None:
            if self._failed:
                self._bar.set_postfix_str(f"{self._failed} failed", refresh=False)
            # A job that is interrupted or lost counts no more.
            self._bar.n = done
            self._bar.update(0)
        elif time.monotonic() - self._written >= BETWEEN_LINES:
            self._written = time.monotonic()
            self._say(f"{self._done} of {self._jobs} jobs ended, {self._failed} failed")

    def _say_failure(self, event: dict[str, Any]) -> None:
        """Says a failure, unless the same failure of another job was said."""
        failure = f"failed ({event['kind']}): {event['message']}"
        if (plain := re.sub(r"\d+", "#", failure)) not in self._failures:
            self._failures.add(plain)
            self._say(f"{_name(event['job'])}: {failure}")

    def _say(self, line: str) -> None:
        if self._bar is not None:
            self._bar.write(line, file=sys.stderr)
        else:
            print(line, file=sys.stderr)


def _name(job: dict[str, Any]) -> str:
    """The short name of a job."""
    swept = [f"{name}={value}" for name, value in job["swept"].items()]
    words = [job["agent"], job["scenario"], *swept, f"seed={job['seed']}"]
    return f"{' '.join(words)} ({job['job_key'][:8]})"


@dataclass(frozen=True)
class Report:
    """The result of :func:`report`."""

    #: The page of the report.
    index: Path
    #: What is missing.
    notes: list[str]
    #: The winners of searches, as TOML.
    winners: list[str]

    def _repr_html_(self) -> str:
        shown = "".join(f"<br>{html.escape(note)}" for note in self.notes)
        path = html.escape(str(self.index), quote=True)
        return f'<a href="{path}">{path}</a>{shown}'


def report(
    manifest: Manifest | Sequence[Manifest],
    *,
    out: str | os.PathLike[str],
    store: str | os.PathLike[str] = STORE,
    set: Mapping[str, Any] | None = None,  # noqa: A002
    hosts: bool = False,
) -> Report:
    """Writes tables, figures and a page into the folder ``out``, as ``jitai report`` does."""
    arguments = _arguments(manifest, store=store, set=set and dict(set))
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    notes, winners = _jitai.report(arguments, folder, hosts)
    return Report(folder / "index.html", notes, winners)
