# SPDX-License-Identifier: Apache-2.0
"""The sections of a report: paragraphs, tables and figures, before they become a page."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from html import unescape
from typing import TYPE_CHECKING, Any

from abrace.report.table import Table
from abrace_core.figures.saving import CHART

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

CAPTION = re.compile(r"<dc:description>(.*?)</dc:description>", re.DOTALL)
"""The caption of a figure, in its SVG file."""


@dataclass(frozen=True)
class Picture:
    """A figure in an SVG file, its caption, and of a chart its data and layout."""

    path: Path
    caption: str
    plotly: dict[str, Any] | None = None

    @staticmethod
    def of(path: Path) -> Picture:
        """The figure in a file, with its caption and chart."""
        chart = path.with_suffix(CHART)
        if chart.exists():
            return Picture(path, **json.loads(chart.read_text(encoding="utf-8")))
        found = CAPTION.search(path.read_text(encoding="utf-8"))
        return Picture(path, unescape(found[1]) if found else "")

    @property
    def title(self) -> str:
        """The file's name in words."""
        return self.path.stem.replace("_", " ")


@dataclass(frozen=True)
class Listing:
    """Text that is shown unchanged: a file, commands."""

    text: str


Part = str | Table | Picture | Listing


@dataclass(frozen=True)
class Section:
    """A heading and its content."""

    title: str
    parts: tuple[Part, ...]


def pictures(folder: Path, names: Sequence[str] = ("*",)) -> list[Picture]:
    """Figures in a `folder` and below, those whose name fits an earlier pattern of `names` first."""
    paths = [path for pattern in names for path in sorted(folder.rglob(f"{pattern}.svg"))]
    return [Picture.of(path) for path in dict.fromkeys(paths)]
