# SPDX-License-Identifier: Apache-2.0
"""PEER's AT2: in units of g, as its third line must say.

The fourth line has any of the forms `NPTS =   7500 , DT =   .020 SEC ,`, `NPTS=   5372, DT=   .0100 SEC,` and
`5372  0.0100  NPTS, DT`.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from abrace_plant.records.reading import Reading, checked_reading

if TYPE_CHECKING:
    from abrace_plant.records.reading import RecordText

_AT2_SIZES = (
    re.compile(r"NPTS\s*=\s*(?P<count>\d{1,9})\s*,?\s*DT\s*=\s*(?P<period>[-+.\dEe]+)", re.IGNORECASE),
    re.compile(r"^\s*(?P<count>\d{1,9})\s+(?P<period>[-+.\dEe]+)\s+NPTS\s*,\s*DT", re.IGNORECASE),
)


def is_peer(lines: list[str]) -> bool:
    """Whether the lines of a file begin as PEER's do."""
    marks = (r"PEER .*(DATABASE|RECORD)", "", r"TIME (SERIES|HISTORY) IN UNITS OF", r"NPTS\s*,\s*DT")
    return any(mark and re.search(mark, line, re.IGNORECASE) for mark, line in zip(marks, lines[:4], strict=False))


def read_at2(file: RecordText) -> Reading:
    """Read PEER's format from the lines of a file: four lines of header, then numbers, five to a line."""
    if len(file.lines) < 5:
        raise file.error(f"{len(file.lines)} lines, expected PEER's four lines of header and values")
    stated = file.lines[2].upper()
    if "ACCELERATION" not in stated or not re.search(r"UNITS OF\s+G(?![\w/])", stated):
        raise file.error(
            f"PEER's {file.lines[2].strip()[:60]!r}, expected the file of the acceleration (AT2), in units of G", 3
        )
    sizes = next(filter(None, (form.search(file.lines[3]) for form in _AT2_SIZES)), None)
    if sizes is None:
        raise file.error(f"{file.lines[3].strip()[:60]!r}, expected NPTS= and DT=, or 'count period NPTS, DT'", 4)
    period = file.number(sizes["period"], 4)
    if period <= 0:
        raise file.error(f"DT {period:g} s, expected more than 0", 4)
    words = [(word, line) for line, text in enumerate(file.lines[4:], 5) for word in text.split()]
    values = [file.number(word, line) for word, line in words]
    if len(values) != int(sizes["count"]):
        raise file.error(f"{len(values)} values, expected NPTS = {sizes['count']}")
    return checked_reading(values, file.errors_at([line for _, line in words]), unit="g", sample_period=period)
