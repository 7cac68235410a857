# SPDX-License-Identifier: Apache-2.0
"""The sections of a report: paragraphs, tables and figures, before they become Markdown or a page."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from abrace.report.table import Table
from abrace_core.drawing import ZOOMABLE

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

SHOWN = (".png", ".svg")
"""Suffixes of files that are figures, the first that there is of a name is linked."""


@dataclass(frozen=True)
class Picture:
    """A figure in a file below the directory of the results.

    Parameters
    ----------
    path
        Of the PNG or SVG file.
    """

    path: Path

    @property
    def title(self) -> str:
        """The file's name in words."""
        return self.path.stem.replace("_", " ")

    @property
    def content(self) -> dict[str, Any]:
        """Caption and Plotly figure, where it was saved with them."""
        path = self.path.with_suffix(ZOOMABLE)
        return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


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
    found: dict[Path, Picture] = {}
    for pattern in names:
        for suffix in SHOWN:
            for path in sorted(folder.rglob(f"{pattern}{suffix}")):
                found.setdefault(path.with_suffix(""), Picture(path))
    return list(found.values())


def markdown(title: str, sections: Sequence[Section], directory: Path) -> str:
    """The `sections` below a `title` as Markdown; figures are linked from the `directory` of the results."""

    def text(part: Part) -> str:
        if isinstance(part, Table):
            return part.markdown().replace("## ", "### ", 1)
        if isinstance(part, Listing):
            return "\n".join(f"    {line}".rstrip() for line in part.text.splitlines())
        if isinstance(part, Picture):
            link = part.path.relative_to(directory).as_posix().replace(" ", "%20")
            caption = part.content.get("caption", "")
            return f"![{part.title}]({link})" + (f"\n\n*{caption}*" if caption else "")
        return part

    blocks = [f"# {title}"]
    for section in sections:
        blocks += [f"## {section.title}", *map(text, section.parts)]
    return "\n\n".join(blocks) + "\n"
