"""Fits: the people of a model, from the decisions of a pilot."""

from __future__ import annotations

import csv
import html
import io
import json
import os
import sys
import time
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

from jitai import _jitai
from jitai._figures import Figure, Figures
from jitai._store import library, of_rows

#: Seconds before the first line of progress, and between two of them.
BETWEEN_LINES = 10.0


class Fit:
    """The people of a model, with what the data do not say of them. The frames are pandas or polars, as the data were."""

    def __init__(self, fitted: _jitai.FittedPilot, model: str, frames: str | None) -> None:
        self._fitted = fitted
        self._frames = frames
        #: The path of the model.
        self.model = model
        #: What was read, and what the data do not say.
        self.notes: list[str] = fitted.notes
        #: Why the model may not be called fitted: effects without identification, or a simulation that fails or explodes.
        self.why_not: list[str] = fitted.why_not
        #: The parameters of the model that are estimated.
        self.parameters: dict[str, float] = dict(fitted.parameters)

    @property
    def is_fitted(self) -> bool:
        """Whether every effect is identified or imputed, and a long simulation is stable."""
        return not self.why_not

    @cached_property
    def _files(self) -> dict[str, bytes]:
        return dict(self._fitted.files(self._fitted.environment("")))

    @cached_property
    def people(self) -> Any:
        """A frame with a row for each person, and every coefficient."""
        return self._frame("people.csv")

    @cached_property
    def residuals(self) -> Any:
        """A frame with the replayed contexts and the residuals of each draw, a row for each decision."""
        return self._frame("residuals.csv")

    @cached_property
    def draws(self) -> list[Any]:
        """Frames of people that are as uncertain as their estimates, if the fit was asked for them."""
        names = (f"draw-{number}.csv" for number in range(1, len(self._files) + 1))
        return [self._frame(name) for name in names if name in self._files]

    @cached_property
    def checks(self) -> Any:
        """A frame with numbers of the pilot beside those of simulated pilots, and how many errors they are away."""
        return self._frame("tables/against.csv")

    @cached_property
    def tables(self) -> dict[str, Any]:
        """All tables of the page as frames, by the names of their files, such as ``effect`` and ``held_out``."""
        paths = {Path(name).stem: name for name in self._files if name.startswith("tables/")}
        return {stem: self._frame(f"tables/{stem}.csv") for stem in paths}

    @cached_property
    def prior(self) -> dict[str, Any]:
        """Keys of an agent ``linear_thompson``: its prior from the pilot."""
        lines = self._files["prior.toml"].decode().splitlines()
        pairs = (line.split(" = ", 1) for line in lines if " = " in line and not line.startswith("#"))
        # Numbers, lists of numbers and words in quotes are the same in TOML and JSON.
        return {key: json.loads(value) for key, value in pairs}

    @cached_property
    def estimates(self) -> dict[str, Any]:
        """Everything of ``fit.json``: estimates with standard errors, objectives, gradients and notes."""
        found: dict[str, Any] = json.loads(self._files["fit.json"])
        return found

    @cached_property
    def figures(self) -> Figures:
        """The figures of the page, which notebooks show."""
        return Figures(Figure(*one) for one in self._fitted.figures())

    def save(self, folder: str | os.PathLike[str]) -> dict[str, Any]:
        """Writes all files and the page, as ``jitai fit`` does, into a folder.

        Returns the table ``environment`` of a manifest that simulates these people.
        """
        folder = Path(folder)
        section = self._fitted.environment(f"{folder}{os.sep}")
        for name, content in self._fitted.files(section):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)
        environment: dict[str, Any] = {"family": "declared", "model": self.model}
        for key, name in (("people", "people.csv"), ("replay", "residuals.csv")):
            if f"\n{key} = " in section:
                environment[key] = str(folder / name)
        if self.parameters:
            environment["parameters"] = self.parameters
        return environment

    def __repr__(self) -> str:
        people = sum(1 for _ in csv.reader(io.StringIO(self._files["people.csv"].decode()))) - 1
        word = "fitted" if self.is_fitted else f"not fitted: {'; '.join(self.why_not)}"
        return f"<jitai.Fit of {self.model!r}: {people} people, {word}>"

    def _repr_html_(self) -> str:
        notes = "".join(f"<li>{html.escape(note)}</li>" for note in (*self.why_not, *self.notes))
        return f"<p>{html.escape(repr(self))}</p><ul>{notes}</ul>{self.figures._repr_html_()}"

    def _frame(self, name: str) -> Any:
        rows = csv.DictReader(io.StringIO(self._files[name].decode()))
        typed = [{key: _value(key, text) for key, text in row.items()} for row in rows]
        return of_rows(typed, library(self._frames))


def _value(key: str, text: str) -> Any:
    """A field of a CSV file: a number, a text, or ``None`` for an empty one."""
    if text == "":
        return None
    if key in ("person", "number", "mark"):
        return text
    try:
        return float(text)
    except ValueError:
        return text


def fit(
    model: str | os.PathLike[str],
    data: Any,
    *,
    simulations: int = 200,
    draws: int = 0,
    bootstrap: bool = False,
    seed: int = 1,
    progress: bool | Callable[[str, int, int], object] = True,
) -> Fit:
    """Estimates the people of a model from the decisions of a pilot, as ``jitai fit`` does.

    ``model`` is the path of a model with a section ``[fit]``. ``data`` is a frame of pandas or polars, or the path of a CSV
    file, with a row for each decision of a person. ``draws`` is the number of files of people as uncertain as their
    estimates, and ``bootstrap`` draws whole people instead. ``progress`` may be a function of what is done, how many, and of
    how many.

    Raises :class:`ManifestError` for faults of the model and :class:`ValueError` for faults of the data; the message has all
    of them with their lines. Line 1 is the header, and line 2 the first row of a frame.
    """
    for name, value, least in (("simulations", simulations, 20), ("draws", draws, 0), ("seed", seed, 0)):
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise ValueError(f"{name}: expected a whole number of at least {least}, found {value!r}")
    path = os.fspath(model)
    text = Path(path).read_text(encoding="utf-8")
    told = progress if callable(progress) else _said() if progress else None
    name, content, frames = _csv(data)
    fitted = _jitai.fit((path, text), (name, content), (simulations, draws, bool(bootstrap), seed), told)
    return Fit(fitted, path, frames)


def _csv(data: Any) -> tuple[str, bytes, str | None]:
    """The name of the data, their CSV text, and the library of their frame."""
    if isinstance(data, (str, os.PathLike)):
        return os.fspath(data), Path(data).read_bytes(), None
    if hasattr(data, "write_csv"):
        return "the frame", data.write_csv().encode(), "polars"
    if hasattr(data, "to_csv"):
        return "the frame", data.to_csv(index=False).encode(), "pandas"
    found = type(data).__name__
    raise TypeError(f"data: expected a frame of pandas or polars, or the path of a CSV file, found {found}")


def _said() -> Callable[[str, int, int], object]:
    """Says progress on standard error, a line every ten seconds."""
    last = time.monotonic()

    def say(what: str, done: int, of: int) -> None:
        nonlocal last
        if time.monotonic() - last >= BETWEEN_LINES:
            last = time.monotonic()
            print(f"{done} of {of} {what}", file=sys.stderr)

    return say
