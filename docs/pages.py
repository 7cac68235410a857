# SPDX-License-Identifier: Apache-2.0
"""What the programs that write pages (write_*.py) share: tables, paragraphs, and writing the page."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

from abrace_core.files.writing import write_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

DOCS = Path(__file__).parent
ROOT = DOCS.parent


def table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def paragraph(text: str) -> str:
    """A text in lines of the pages' width."""
    return "\n".join(textwrap.wrap(" ".join(text.split()), 120, break_long_words=False, break_on_hyphens=False)) + "\n"


def write(program: str, page: Callable[[], str]) -> None:
    """Write the page of a `program`, write_NAME.py: NAME.md."""
    write_text(DOCS / f"{Path(program).stem.removeprefix('write_')}.md", page())
