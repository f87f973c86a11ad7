"""Results as data frames."""

from __future__ import annotations

import importlib.util
import os
from types import TracebackType
from typing import Any

import numpy as np

from jitai._jitai import StoreReader

#: Columns with instants, which the store holds as text in UTC.
_INSTANTS = ("started_at", "ended_at", "used_from", "used_until")

#: Views that name the experiment; the others name the job.
_WITH_EXPERIMENT = ("run_summary", "arm_summary", "manifest")


def open(  # noqa: A001
    path: str | os.PathLike[str] = "jitai.sqlite", *, frames: str | None = None
) -> Store:
    """Opens a store for reading, also while jobs run.

    ``frames`` is ``"pandas"`` or ``"polars"``; by default pandas if it is installed, else polars.
    """
    return Store(path, frames=frames)


class Store:
    """A store that is open for reading. Every call reads the last committed state.

    The frames have the columns of the views in ``docs/store.md``, in their order: text, 64-bit integers
    and reals, with NaN for NULL among numbers. The columns ``started_at``, ``ended_at``, ``used_from`` and
    ``used_until`` are instants in UTC.
    """

    def __init__(self, path: str | os.PathLike[str], *, frames: str | None = None) -> None:
        self._frames = _library(frames)
        self.path = os.fspath(path)
        self._reader = StoreReader(self.path)

    def runs(self, experiment: str | None = None) -> Any:
        """One row for each run with any status: the view ``run_summary``."""
        return self._view("run_summary", "experiment, job_key, agent, attempt", experiment)

    def arms(self, experiment: str | None = None) -> Any:
        """One row for each arm and seed: the view ``arm_summary``."""
        return self._view("arm_summary", "experiment, job_key, agent", experiment)

    def metrics(self, experiment: str | None = None) -> Any:
        """Numbers about the test of each completed run: the view ``metric``."""
        return self._view("metric", "job_key, name", experiment)

    def curves(self, experiment: str | None = None) -> Any:
        """Learning curves: the view ``learning_curve``."""
        return self._view("learning_curve", "job_key, metric, episode", experiment)

    def episodes(self, experiment: str | None = None) -> Any:
        """Test episodes: the view ``evaluation_episode``."""
        return self._view("evaluation_episode", "job_key, episode", experiment)

    def action_choices(self, experiment: str | None = None) -> Any:
        """How often each action was chosen: the view ``action_choice``."""
        return self._view("action_choice", "job_key, p_low, context, action", experiment)

    def decisions(self, experiment: str | None = None) -> Any:
        """Recorded decisions, one row for each step: the view ``decision``."""
        return self._view("decision", "job_key, phase, episode, step", experiment)

    def participants(self, experiment: str | None = None) -> Any:
        """Parameters of participants who differ, one row for each parameter: the view ``participant``."""
        return self._view("participant", "job_key, phase, episode, name", experiment)

    def manifests(self, experiment: str | None = None) -> Any:
        """Every text that the manifest of an experiment had: the view ``manifest``."""
        return self._view("manifest", "experiment, used_from", experiment)

    def parameters(self, experiment: str | None = None, *, wide: bool = False) -> Any:
        """Parameters of jobs: the view ``parameter``, or one row for each job if ``wide``.

        Wide frames have a column for each parameter, under its dotted name. A missing parameter of a
        job is NaN in numeric columns, and None in others.
        """
        if not wide:
            return self._view("parameter", "job_key, name", experiment)
        rows = dict(self._columns("parameter", "job_key, name", experiment))
        jobs: dict[str, dict[str, Any]] = {}
        values = rows["value"]
        values = values.tolist() if isinstance(values, np.ndarray) else values
        names: list[str] = []
        for key, name, value in zip(rows["job_key"], rows["name"], values, strict=True):
            jobs.setdefault(key, {})[name] = value
        names = sorted({name for job in jobs.values() for name in job})
        columns: dict[str, Any] = {"job_key": list(jobs)}
        for name in names:
            columns[name] = _column([job.get(name) for job in jobs.values()])
        return self._frame(columns)

    def query(self, sql: str) -> Any:
        """The result of a read-only query; ``docs/store.md`` describes the views."""
        return self._frame(dict(self._reader.columns(sql)))

    def close(self) -> None:
        """Closes the file."""
        self._reader.close()

    def __enter__(self) -> Store:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        closed = ", closed" if self._reader.is_closed else ""
        return f"jitai.open({self.path!r}{closed})"

    def _columns(self, view: str, order: str, experiment: str | None) -> list[tuple[str, Any]]:
        if not self._reader.has_view(view):
            raise ValueError(f"{self.path} is of an earlier version; `jitai run` adds {view}")
        condition = ""
        if experiment is not None:
            name = experiment.replace("'", "''")
            condition = f"WHERE experiment = '{name}'"
            if view not in _WITH_EXPERIMENT:
                jobs = f"SELECT job_key FROM run_summary {condition}"
                condition = f"WHERE job_key IN ({jobs})"
        return self._reader.columns(f"SELECT * FROM {view} {condition} ORDER BY {order}")

    def _view(self, view: str, order: str, experiment: str | None) -> Any:
        return self._frame(dict(self._columns(view, order, experiment)))

    def _frame(self, columns: dict[str, Any]) -> Any:
        if self._frames == "pandas":
            import pandas

            frame = pandas.DataFrame(columns)
            for name in frame.columns.intersection(list(_INSTANTS)):
                frame[name] = pandas.to_datetime(frame[name], utc=True)
            return frame
        import polars

        frame = polars.DataFrame(columns, strict=False)
        texts = [name for name in _INSTANTS if name in columns]
        instants = [
            polars.col(name).cast(polars.String).str.to_datetime(time_zone="UTC") for name in texts
        ]
        return frame.with_columns(instants)


def _library(frames: str | None) -> str:
    """The name of the data-frame library."""
    if frames not in (None, "pandas", "polars"):
        raise ValueError(f"frames: expected pandas or polars, found {frames!r}")
    for name in (frames,) if frames else ("pandas", "polars"):
        if importlib.util.find_spec(name) is not None:
            return name
    wanted = frames or "pandas (or polars)"
    raise ImportError(f"data frames need {wanted}: pip install {wanted.split()[0]}")


def _column(values: list[Any]) -> Any:
    """Values of a column, as an array if all are numbers or NULL."""
    kinds = {type(value) for value in values}
    if kinds == {int}:
        return np.array(values, np.int64)
    if kinds <= {int, float, type(None)} and kinds != {type(None)}:
        return np.array([np.nan if value is None else value for value in values], np.float64)
    return values
