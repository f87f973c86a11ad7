"""Figures of analyses, as notebooks show them."""

from __future__ import annotations

import difflib
import html
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jitai import _jitai


@dataclass(frozen=True)
class Figure:
    """A figure of a report."""

    #: The analysis; ``race`` for the race of a search.
    analysis: str
    #: The name of its file in the report, without extension.
    name: str
    #: The image.
    svg: str = field(repr=False)
    #: What it shows.
    caption: str = field(repr=False)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the image to an SVG file.

        Raises :class:`ValueError` if the name ends like the name of a file of another kind.
        """
        ending = Path(path).suffix
        if ending.lower() not in ("", ".svg"):
            raise ValueError(
                f"a figure is an SVG image, found the ending {ending!r}; jitai.report() writes PNG and PDF files"
            )
        Path(path).write_text(self.svg, encoding="utf-8")

    def _repr_svg_(self) -> str:
        return self.svg


class Figures(tuple[Figure, ...]):
    """The figures of analyses, in the order of the report."""

    def _repr_html_(self) -> str:
        shown = []
        for index, one in enumerate(self):
            is_last = index + 1 == len(self) or self[index + 1].analysis != one.analysis
            caption = f"<figcaption>{html.escape(one.caption)}</figcaption>" if is_last else ""
            shown.append(f"<figure>{one.svg}{caption}</figure>")
        return "\n".join(shown)

    def _repr_svg_(self) -> str | None:
        return self[0].svg if len(self) == 1 else None


def figures(
    store: str, manifest: str | bytes | os.PathLike[str] | Mapping[str, Any], analysis: str | None
) -> Figures:
    """The figures of a manifest's analyses, or of one of them."""
    given = dict(manifest) if isinstance(manifest, Mapping) else manifest
    drawn, analyses = _jitai.figures({"manifests": [given], "store": store})
    if analysis is not None and analysis not in analyses:
        close = difflib.get_close_matches(analysis, analyses, n=1)
        hint = f" (did you mean `{close[0]}`?)" if close else ""
        listed = ", ".join(analyses) or "none"
        raise ValueError(f"no analysis `{analysis}`{hint}; the manifest declares {listed}")
    if not analyses:
        raise ValueError("the manifest declares no [[analysis]]; docs/report.md describes them")
    found = Figures(Figure(*one) for one in drawn if analysis in (None, one[0]))
    if not found:
        raise ValueError(
            f"{analysis or 'the manifest'} has no figure: its jobs have no results, or it has only tables"
        )
    return found
