"""Results as data frames."""

from __future__ import annotations

import difflib
import importlib.util
import os
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from jitai._jitai import StoreReader

if TYPE_CHECKING:
    from jitai._figures import Figures
    from jitai._policy import Policy

#: Columns with instants, which the store holds as text in UTC.
_INSTANTS = ("started_at", "ended_at", "used_from", "used_until", "found_at")
#: Largest integer up to which all integers are exact as reals.
_LARGEST_EXACT = 2**53


class Column(NamedTuple):
    """A column, as :class:`StoreReader` gives it."""

    name: str
    #: ``integer`` and ``real`` have arrays; ``text``, ``bytes``, ``mixed`` and ``null`` have lists.
    kind: str
    values: Any
    #: Which values are NULL; ``None`` if none is.
    nulls: npt.NDArray[np.bool_] | None


def open(  # noqa: A001
    path: str | os.PathLike[str] = "jitai.sqlite", *, frames: str | None = None
) -> Store:
    """Opens a store for reading, also while jobs run.

    ``frames`` is ``"pandas"`` or ``"polars"``; by default pandas if it is installed, else polars.
    """
    return Store(path, frames=frames)


class Store:
    """A store that is open for reading. Every call reads the last committed state.

    The frames have the columns of the views in ``docs/store.md``, in their order and with their types, even
    without rows: text, 64-bit integers and reals. NULL is null in polars; in pandas it is NaN among
    numbers, and integers beside it are reals. The columns ``started_at``, ``ended_at``, ``used_from``,
    ``used_until`` and ``found_at`` are instants in UTC.
    """

    def __init__(self, path: str | os.PathLike[str], *, frames: str | None = None) -> None:
        self._frames = library(frames)
        self.path = os.fspath(path)
        self._reader = StoreReader(self.path)

    def runs(self, experiment: str | None = None) -> Any:
        """One row for each run with any status: the view ``run_summary``."""
        return self._view("run_summary", experiment)

    def arms(self, experiment: str | None = None) -> Any:
        """One row for each arm and seed: the view ``arm_summary``."""
        return self._view("arm_summary", experiment)

    def metrics(self, experiment: str | None = None) -> Any:
        """Numbers about the test of each completed run: the view ``metric``."""
        return self._view("metric", experiment)

    def curves(self, experiment: str | None = None) -> Any:
        """Learning curves: the view ``learning_curve``."""
        return self._view("learning_curve", experiment)

    def episodes(self, experiment: str | None = None) -> Any:
        """Test episodes: the view ``evaluation_episode``."""
        return self._view("evaluation_episode", experiment)

    def action_choices(self, experiment: str | None = None) -> Any:
        """How often each action was chosen: the view ``action_choice``."""
        return self._view("action_choice", experiment)

    def decisions(self, experiment: str | None = None) -> Any:
        """Recorded decisions, one row for each step: the view ``decision``."""
        return self._view("decision", experiment)

    def participants(self, experiment: str | None = None) -> Any:
        """Parameters of participants who differ, one row for each parameter: the view ``participant``."""
        return self._view("participant", experiment)

    def manifests(self, experiment: str | None = None) -> Any:
        """Every text that the manifest of an experiment had: the view ``manifest``."""
        return self._view("manifest", experiment)

    def conflicts(self, experiment: str | None = None) -> Any:
        """Results that merges found of jobs with other results: the view ``conflict``."""
        return self._view("conflict", experiment)

    def estimates(self, experiment: str | None = None, *, earlier: bool = False) -> Any:
        """Estimates of causal effects, one row for each term: the view ``estimate``.

        These are the estimates that the manifests declare as they were last run. With ``earlier``, also the
        rows of earlier declarations and of other manifests: the view ``every_estimate``.
        """
        return self._view("every_estimate" if earlier else "estimate", experiment)

    def parameters(self, experiment: str | None = None, *, wide: bool = False) -> Any:
        """Parameters of jobs: the view ``parameter``, or one row for each job if ``wide``.

        Wide frames have a column for each parameter, under its dotted name. A parameter that a job lacks is
        NULL.
        """
        if not wide:
            return self._view("parameter", experiment)
        rows = {column.name: column.values for column in self._columns("parameter", experiment)}
        jobs: dict[str, dict[str, Any]] = {}
        values = rows["value"]
        values = values.tolist() if isinstance(values, np.ndarray) else values
        for key, name, value in zip(rows["job_key"], rows["name"], values, strict=True):
            jobs.setdefault(key, {})[name] = value
        columns = [Column("job_key", "text", list(jobs), None)]
        for name in sorted({name for job in jobs.values() for name in job}):
            columns.append(_of_values(name, [job.get(name) for job in jobs.values()]))
        return self._frame(columns)

    def query(
        self, sql: str, parameters: Sequence[Any] | Mapping[str, Any] = ()
    ) -> Any:
        """The result of a read-only query; ``docs/store.md`` describes the views.

        ``parameters`` are the values of ``?`` in order, or of ``:name`` by name. The columns need
        different names.
        """
        if isinstance(parameters, Mapping):
            values: list[tuple[str | None, Any]] = list(parameters.items())
        elif isinstance(parameters, (str, bytes)) or not isinstance(parameters, Sequence):
            raise TypeError(f"parameters: expected a list or a dict, found {parameters!r}")
        else:
            values = [(None, value) for value in parameters]
        return self._frame([Column(*column) for column in self._reader.columns(sql, values)])

    def dataset(
        self, key: str, *, phase: str = "test", observations: Sequence[str] | None = None
    ) -> dict[str, npt.NDArray[Any]]:
        """The recorded decisions of a job for offline reinforcement learning.

        ``key`` is the beginning of the key of a completed job, and ``phase`` is ``"test"`` or ``"train"``. The arrays have
        a row for each step, by episode: ``observations``, ``actions``, ``rewards``, ``terminals`` and ``timeouts``, so
        that ``d3rlpy.dataset.MDPDataset(**dataset)`` takes them. An observation is the recorded state before the
        step, or the entries of it that ``observations`` names. An episode that was running when the training ended
        has a timeout in its last step.
        """
        from jitai._dataset import of_decisions

        return of_decisions(self._reader, key, phase, observations)

    def policy(self, key: str) -> Policy:
        """The policy of the only completed job whose key begins with ``key``."""
        from jitai._policy import Policy

        return Policy.from_store(self.path, key)

    def plot(
        self,
        experiment: str | None = None,
        analysis: str | None = None,
        *,
        manifest: str | os.PathLike[str] | Mapping[str, Any] | None = None,
    ) -> Figures:
        """The figures of an experiment's report, or of one analysis, which notebooks show.

        The analyses are those of the manifest that the store has; ``manifest`` has others.
        """
        from jitai._figures import figures

        if manifest is None:
            if experiment is None:
                known = self._reader.experiments()
                if len(known) != 1:
                    raise ValueError(f"experiment: choose one of {', '.join(known) or 'none'}")
                [experiment] = known
            self._require(experiment)
            text = self._reader.manifest(experiment) or ""
            return figures(self.path, text.encode(), analysis)
        return figures(self.path, manifest, analysis)

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
        if self._reader.is_closed:
            return f"<jitai.Store {self.path!r}, closed>"
        names = self._reader.experiments()
        return f"<jitai.Store {self.path!r}: experiments {', '.join(names) or 'none'}>"

    def _columns(self, view: str, experiment: str | None) -> list[Column]:
        if not self._reader.has_view(view):
            raise ValueError(f"{self.path} is of an earlier version; `jitai run` adds {view}")
        if experiment is not None:
            self._require(experiment)
        return [Column(*column) for column in self._reader.view(view, experiment)]

    def _require(self, experiment: str) -> None:
        """Checks that the store has the experiment."""
        if not isinstance(experiment, str):
            raise TypeError(f"experiment: expected the name of an experiment, found {experiment!r}")
        known = self._reader.experiments()
        if experiment in known:
            return
        close = difflib.get_close_matches(experiment, known, n=1)
        hint = f" (did you mean `{close[0]}`?)" if close else ""
        listed = ", ".join(known) or "none"
        raise ValueError(f"{self.path} has no experiment `{experiment}`{hint}; it has {listed}")

    def _view(self, view: str, experiment: str | None) -> Any:
        return self._frame(self._columns(view, experiment))

    def _frame(self, columns: list[Column]) -> Any:
        return _frame(columns, self._frames)


def _frame(columns: list[Column], frames: str) -> Any:
    """The columns as a frame of a library."""
    instants = [one.name for one in columns if one.name in _INSTANTS and one.kind in ("text", "null")]
    if frames == "pandas":
        import pandas

        frame = pandas.DataFrame({column.name: _of_pandas(column) for column in columns})
        # The unit of instants depends on the version of pandas, and on the values if there are none.
        unit = pandas.to_datetime(pandas.Series(["2026-01-31T12:00:00.000Z"]), utc=True).dtype
        for name in instants:
            frame[name] = pandas.to_datetime(frame[name], utc=True).astype(unit)
        return frame
    import polars

    frame = polars.DataFrame([_of_polars(column) for column in columns])
    texts = (polars.col(name).cast(polars.String) for name in instants)
    return frame.with_columns(text.str.to_datetime(time_zone="UTC") for text in texts)


def of_rows(rows: list[dict[str, Any]], frames: str) -> Any:
    """Rows as a frame of a library; a column has the type of its values."""
    names = dict.fromkeys(name for row in rows for name in row)
    return _frame([_of_values(name, [row.get(name) for row in rows]) for name in names], frames)


def _of_pandas(column: Column) -> Any:
    """The column for pandas."""
    import pandas

    _, kind, values, nulls = column
    if kind == "integer" and nulls is not None:
        if -_LARGEST_EXACT <= values.min() and values.max() <= _LARGEST_EXACT:
            return np.where(nulls, np.nan, values)
        values = np.where(nulls, None, values.astype(object))
    if kind == "text":
        # The type of text depends on the version of pandas.
        return pandas.Series(values, dtype=pandas.Series([""]).dtype)
    return pandas.Series(values, dtype=None if kind in ("integer", "real") else object)


def _of_polars(column: Column) -> Any:
    """The column for polars."""
    import polars

    name, kind, values, nulls = column
    if kind in ("integer", "real"):
        series = polars.Series(name, values)
        return series if nulls is None else series.scatter(np.flatnonzero(nulls), None)
    if kind == "mixed":
        values = [value if value is None else _written(value) for value in values]
    types = {"text": polars.String, "mixed": polars.String, "bytes": polars.Binary, "null": polars.Null}
    return polars.Series(name, values, dtype=types[kind])


def _written(value: Any) -> str:
    """A value as text; bytes as an SQL literal, as in CSV."""
    return f"x'{value.hex()}'" if isinstance(value, bytes) else str(value)


def library(frames: str | None) -> str:
    """The name of the data-frame library."""
    if frames not in (None, "pandas", "polars"):
        raise ValueError(f"frames: expected pandas or polars, found {frames!r}")
    for name in (frames,) if frames else ("pandas", "polars"):
        if importlib.util.find_spec(name) is not None:
            return name
    wanted = frames or "pandas (or polars)"
    raise ImportError(f"data frames need {wanted}: pip install {wanted.split()[0]}")


def _of_values(name: str, values: list[Any]) -> Column:
    """A column of values, as an array if all are numbers or NULL."""
    nulls = np.array([value is None for value in values], np.bool_)
    kinds = {type(value) for value in values} - {type(None)}
    missing = nulls if nulls.any() else None
    if kinds == {int}:
        return Column(name, "integer", np.array([value or 0 for value in values], np.int64), missing)
    if kinds and kinds <= {int, float}:
        reals = [np.nan if value is None else value for value in values]
        return Column(name, "real", np.array(reals, np.float64), missing)
    kind = "text" if kinds == {str} else "mixed" if kinds else "null"
    return Column(name, kind, values, missing)
