# SPDX-License-Identifier: Apache-2.0
"""Tables for people, as aligned plain text."""

from __future__ import annotations

import math
import textwrap
from dataclasses import dataclass
from itertools import zip_longest
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator


WIDTH = 80
"""Columns of a terminal, and of a page that is printed."""


def _wrapped(text: str, width: int) -> list[str]:
    return textwrap.wrap(text, max(width, 1), break_long_words=False, break_on_hyphens=False) or [""]


def reduction(before: float | None, after: float | None) -> str:
    """By how much a value is less `after` than `before`, in percent, as a cell; a dash where that is not known.

    >>> reduction(4.0, 1.0), reduction(0.0, 1.0), reduction(4.0, None)
    ('75.0', '-', '-')
    """
    return f"{100 * (1 - after / before):.1f}" if before and after is not None else "-"


def number(value: float | None, form: str) -> str:
    """A `value` as a cell, in this `form`; a dash where it is not known or not finite.

    >>> number(0.5, ".2f"), number(None, ".2f"), number(float("inf"), ".2f")
    ('0.50', '-', '-')
    """
    return "-" if value is None or not math.isfinite(value) else format(value, form)


@dataclass(frozen=True)
class Table:
    """A table of texts; the first column is aligned left, the others right.

    Parameters
    ----------
    title
        One line above the table.
    header
        (columns,) titles of the columns.
    rows
        (rows, columns).
    notes
        Lines below the table.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()

    def text(self) -> str:
        """Plain text, columns aligned; cells and notes are wrapped where that brings it within 80 columns.

        >>> print(Table("Peaks", ("", "x1 [cm]"), (("measured", "1.10"), ("simulated", "1.3"))).text())
        Peaks
                   x1 [cm]
        ---------  -------
        measured      1.10
        simulated      1.3
        """
        columns = list(zip(self.header, *self.rows, strict=True))
        widths = [max(map(len, cells)) for cells in columns]
        least = [max((len(word) for cell in cells for word in cell.split()), default=0) for cells in columns]
        while sum(widths) + 2 * len(widths) - 2 > WIDTH and widths != least:
            widest = max(range(len(widths)), key=lambda i: widths[i] - least[i])
            widths[widest] -= 1

        def lines(cells: tuple[str, ...]) -> Iterator[str]:
            wrapped = (_wrapped(cell, width) for cell, width in zip(cells, widths, strict=True))
            for parts in zip_longest(*wrapped, fillvalue=""):
                first, *others = zip(parts, widths, strict=True)
                yield "  ".join([first[0].ljust(first[1]), *(part.rjust(width) for part, width in others)]).rstrip()

        rule = tuple("-" * width for width in widths)
        body = [line for cells in (self.header, rule, *self.rows) for line in lines(cells)]
        return "\n".join([self.title, *body, *(line for note in self.notes for line in _wrapped(note, WIDTH))])
