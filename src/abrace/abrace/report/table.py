# SPDX-License-Identifier: Apache-2.0
"""Tables for people: aligned plain text, and the same as Markdown."""

from __future__ import annotations

from dataclasses import dataclass


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
        """Plain text, columns aligned.

        >>> print(Table("Peaks", ("", "x1 [cm]"), (("measured", "1.10"), ("simulated", "1.3"))).text())
        Peaks
                   x1 [cm]
        ---------  -------
        measured      1.10
        simulated      1.3
        """
        widths = [max(len(row[i]) for row in (self.header, *self.rows)) for i in range(len(self.header))]

        def line(cells: tuple[str, ...]) -> str:
            padded = [
                cells[0].ljust(widths[0]),
                *(cell.rjust(w) for cell, w in zip(cells[1:], widths[1:], strict=True)),
            ]
            return "  ".join(padded).rstrip()

        rule = tuple("-" * width for width in widths)
        return "\n".join([self.title, line(self.header), line(rule), *map(line, self.rows), *self.notes])

    def markdown(self) -> str:
        """A section of Markdown: heading, table, notes."""

        def line(cells: tuple[str, ...]) -> str:
            return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

        rule = "|" + "---|" + "---:|" * (len(self.header) - 1)
        notes = ["", "  \n".join(self.notes)] if self.notes else []
        return "\n".join([f"## {self.title}", "", line(self.header), rule, *map(line, self.rows), *notes])
