# SPDX-License-Identifier: Apache-2.0
"""Readers of records in columns of text: PEER AT2, one and two columns, CSV.

- `.at2`: PEER, in units of g, as its third line must say; the fourth line in any of the forms
  `NPTS =   7500 , DT =   .020 SEC ,`, `NPTS=   5372, DT=   .0100 SEC,` and `5372  0.0100  NPTS, DT`.
- `.csv`: a row of names with units, as `time [s],acceleration [m/s^2]` or `time,acc (g)`, then numbers. Time is in
  seconds. Other columns are passed over; where several are accelerations, the channel is the name of one.
- plain text: one column (acceleration) or two (time [s], acceleration).

Text and CSV may hold empty lines and comments that start with #.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from abrace_plant.records.reading import UNITS, Reading, checked_reading, unit_named

if TYPE_CHECKING:
    from abrace_plant.records.reading import RecordText

_AT2_SIZES = (
    re.compile(r"NPTS\s*=\s*(?P<count>\d{1,9})\s*,?\s*DT\s*=\s*(?P<period>[-+.\dEe]+)", re.IGNORECASE),
    re.compile(r"^\s*(?P<count>\d{1,9})\s+(?P<period>[-+.\dEe]+)\s+NPTS\s*,\s*DT", re.IGNORECASE),
)
_COLUMN = re.compile(r"^(?P<name>[^\[(]*?)\s*(?:[\[(]\s*(?P<unit>[^\])]*?)\s*[\])])?$")


def read_at2(file: RecordText) -> Reading:
    """Read PEER's format from the lines of a file: four lines of header, then numbers, five to a line."""
    if len(file.lines) < 5:
        raise file.error(f"{len(file.lines)} lines, expected PEER's four lines of header and values")
    stated = file.lines[2].upper()
    if "ACCELERATION" not in stated or not re.search(r"UNITS OF\s+G(?![\w/])", stated):
        raise file.error(f"{file.lines[2].strip()[:60]!r}, expected an acceleration in units of G", 3)
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


def read_text(file: RecordText) -> Reading:
    """Read the lines of a file in one column (accelerations) or two (times and accelerations)."""
    content = file.content()
    columns = len(content[0][1].split())
    if columns not in (1, 2):
        message = f"{columns} columns, expected one (acceleration) or two (time, acceleration)"
        raise file.error(message, content[0][0])
    rows = []
    for line, text in content:
        words = text.split()
        if len(words) != columns:
            raise file.error(f"{len(words)} columns, expected {columns} as before", line)
        rows.append([file.number(word, line) for word in words])
    times = [row[0] for row in rows] if columns == 2 else None
    error_at = file.errors_at([line for line, _ in content])
    return checked_reading([row[-1] for row in rows], error_at, unit=None, times=times)


def read_csv(file: RecordText, channel: str | None) -> Reading:
    """Read columns under a row of names and units.

    Parameters
    ----------
    file
        Its lines.
    channel
        Name of the acceleration's column; needed where there are several.
    """
    (header_line, header), *content = file.content()
    if ";" in header:
        raise file.error(
            f"{header[:60]!r}: semicolons, expected commas between columns and points in numbers", header_line
        )
    forms = [_COLUMN.match(cell.strip(' "')) for cell in header.split(",")]
    names = [form["name"].lower() if form else "" for form in forms]
    units = [form["unit"] if form else None for form in forms]
    time_at = [i for i, name in enumerate(names) if name in ("t", "time")]
    if channel is None:
        chosen = [i for i, name in enumerate(names) if name.startswith("acc") or name == "a"]
        expected = "names such as 'time [s],acceleration [m/s^2]', one of them an acceleration"
        if len(chosen) > 1:
            expected += f", or channel as one of {', '.join(names[i] for i in chosen)}"
    else:
        chosen = [i for i, name in enumerate(names) if name == channel.strip().lower() and i not in time_at]
        expected = f"one column {channel!r}"
    if len(chosen) != 1 or len(time_at) > 1:
        raise file.error(f"{header[:60]!r}, expected {expected}", header_line)
    stated = units[chosen[0]]
    unit = None if stated is None else unit_named(stated)
    if stated is not None and unit is None:
        raise file.error(f"unit {stated!r} of the acceleration, expected one of {', '.join(UNITS)}", header_line)
    if time_at and units[time_at[0]] not in (None, "s", "sec"):
        raise file.error(f"unit {units[time_at[0]]!r} of the time, expected s", header_line)
    times, values = [], []
    for line, text in content:
        cells = [cell.strip(' "') for cell in text.split(",")]
        if len(cells) != len(names):
            raise file.error(f"{len(cells)} columns, expected {len(names)} as in the header", line)
        times += [file.number(cells[column], line) for column in time_at]
        values.append(file.number(cells[chosen[0]], line))
    error_at = file.errors_at([line for line, _ in content])
    return checked_reading(values, error_at, unit=unit, times=times if time_at else None)
