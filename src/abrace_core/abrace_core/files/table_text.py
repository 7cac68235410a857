# SPDX-License-Identifier: Apache-2.0
"""Columns of numbers in a text: finds separator, decimal sign, comments, names, units, sample period and rows.

Whatever stands above the numbers is the header. The last of its lines with as many cells as there are columns has the
names, a line of units may follow; elsewhere it may state unit, sample period or rate, and number of values.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from abrace_core import AbraceError
from abrace_core.files.table import Column, Table
from abrace_core.files.units import ACCELERATION, TIME, unit_in_header

if TYPE_CHECKING:
    from collections.abc import Sequence

NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eEdD][-+]?[0-9]+)?"
_NUMBER = re.compile(NUMBER)
_COMMA_NUMBER = re.compile(r"[-+]?(?:[0-9]+(?:,[0-9]+)?|,[0-9]+)(?:[eEdD][-+]?[0-9]+)?")
_NOTHING = re.compile(r"(?:nan|n/?a|-|null|none|[-+]?inf(?:inity)?)?", re.IGNORECASE)
_COMMENT = re.compile(r"\s*(?:#|%|//|!|\*)")
_BRACKET_CELLS = re.compile(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?")
_VALUE = (
    r"(?![a-z])(?:(?P<label>[^:=\n]{0,30}?)[:=]\s*/?|(?: of| is)?(?= ))\s*"
    rf"(?P<value>{NUMBER})(?!\d|\s*(?:-|to)\s*\d)\s*(?P<after>[a-zµ]*)"
)
"""A number after a name, of which it may be divided by a label; two ends of a range are none."""
_INTERVAL = re.compile(
    r"(?<![a-z])(?:sampl\w*[ _-]*(?:interval|period|time|step)|time[ _-]*(?:step|interval|increment)|"
    rf"delta(?:[ _-]*t)?|dt|intervalo de muestreo){_VALUE}",
    re.IGNORECASE,
)
_RATE = re.compile(
    rf"(?<![a-z])(?:(?:sampl\w*[ _-]*(?:rate|freq\w*)|fs){_VALUE}"
    rf"|sampled (?:at|with) (?P<at>{NUMBER})\s*(?P<hertz>k?hz|sps))",
    re.IGNORECASE,
)
_LABEL_UNIT = re.compile(r"[\[(](\w+)[\])]|_(s|ms|us)\b", re.IGNORECASE)
_COUNT = re.compile(
    rf"(?<![a-z])(?:npts?|ndata|num(?:ber)?\.? of (?:data|points|samples|values)){_VALUE}", re.IGNORECASE
)
_UNIT = re.compile(
    r"(?<![a-z])(?:(?:amplitude|accel\w*|data)?[ _-]*units?(?: of (?:the )?(?:data|accel\w*))?|unidades de los datos)"
    r"[ \t]*(?:[:=]|\bof\b|\bis\b|\bin\b)[ \t]*([^\n,;(]+?)(?=\s{2,}|[\n,;(]|\.\s|$)",
    re.IGNORECASE,
)
_IN_UNIT = re.compile(
    r"(?<![a-z])(?:acc|accel|acceleration|value|amplitude|data)s?(?: (?:time )?(?:history|series|record|values|data))?"
    r"(?:,? (?:are |is )?in (?:units of )?|, |\s*[\[(]\s*)([a-z%][^\s,;:()\[\]]*)",
    re.IGNORECASE,
)
"""A unit in a sentence, such as `accelerations in g`."""
_ONE_VALUE = re.compile(r"peak|max|min|pga|threshold|filter|scal|factor", re.IGNORECASE)
"""Words of a line that states the unit of another number."""
_JOINED = re.compile(r"(\.[0-9]+)(?=[-+][0-9.])")
"""In columns of a fixed width a number may begin where the one before ends."""
LAST = 60
"""Lines at the end by which it is known how lines are divided."""
_FIELD_UNITS = re.compile(r"field_unit:(.*)")
SHOWN = 40


class _Form(NamedTuple):
    """How a line is divided, and which sign stands before decimals."""

    separator: str | None
    decimal: str

    def cells(self, line: str) -> list[str]:
        if self.separator is None:
            return line.replace('"', " ").split()
        if '"' in line:
            found = next(csv.reader([line], delimiter=self.separator, skipinitialspace=True), [])
            return [cell.strip() for cell in found]
        return [cell.strip() for cell in line.split(self.separator)]

    def is_number(self, cell: str) -> bool:
        return bool((_NUMBER if self.decimal == "." else _COMMA_NUMBER).fullmatch(cell))


def text_table(text: str, source: str) -> Table:
    """The table in a text, which errors call `source`.

    Raises
    ------
    AbraceError
        If there are no columns of numbers, or it cannot be known what divides them.
    """
    lines = [(number, line) for number, line in enumerate(text.split("\n"), 1) if line.strip()]
    separator = re.fullmatch(r'"?sep=(.)"?', lines[0][1].strip(), re.IGNORECASE) if lines else None
    plain = [(number, line) for number, line in lines[bool(separator) :] if not _COMMENT.match(line)]
    if not plain:
        raise AbraceError(f"{source}: empty, expected columns of numbers")
    if any(_JOINED.search(line) and ":" not in line for _, line in plain[-LAST:]):
        plain = [(number, _JOINED.sub(r"\1 ", line)) for number, line in plain]
    form, width, numeric = _form(plain, separator[1] if separator else None, source)
    rows = [(number, _even(form.cells(re.split(r"\s#", line)[0]), width)) for number, line in plain]
    last = len(rows) - 1

    def fits(i: int) -> bool:
        cells = rows[i][1]
        if i == last and 0 < len(cells) < width:  # the rest of values by rows
            return all(map(form.is_number, cells))
        return len(cells) == width and _is_row(cells, numeric, form)

    def begins(i: int) -> bool:  # a mistake in the first rows does not make a header of them
        below = [fits(k) for k in range(i, min(i + 5, last + 1))]
        return below[0] and sum(below) >= 0.5 * len(below)

    first = next((i for i in range(len(rows)) if begins(i)), None)
    if first is None:
        raise AbraceError(f"{source}, line {plain[0][0]}: {plain[0][1].strip()[:60]!r}, expected columns of numbers")
    top = rows[first][0]
    header = [(number, line) for number, line in lines if number < top and not (separator and number == lines[0][0])]
    rows, stated = _counted(rows, first, header, form)
    ends_empty = width > 1 and not any(len(cells) == width and cells[-1] for _, cells in rows)
    names, units, used = _names(header, form, width, ends_empty) if width > 1 or header else ([], [], 0)
    above = "\n".join(line for _, line in header[: len(header) - used])
    if (stated_units := _FIELD_UNITS.search(above)) and stated_units[1].count(",") == width - 1:  # GeoCSV
        units = [re.sub(r"\s|UTC", "", unit) for unit in stated_units[1].split(",")]
        above = above.replace(stated_units[0], "")
    facts = _facts(above) | stated
    short = len(rows[-1][1]) < width and all(len(cells) == width for _, cells in rows[:-1])
    numbered = not names and width > 3 and [cells[-1] for _, cells in rows] == [str(i + 1) for i in range(len(rows))]
    by_rows = numbered or short or len(rows) == 1 or facts.get("count") == len(rows) * width
    if not names and _are_pairs(rows, width, form):  # several times and values in a row
        rows = [(number, cells[i : i + 2]) for number, cells in rows for i in range(0, len(cells), 2)]
        width, ends_empty = 2, False
    elif width > 1 and not names and by_rows:  # several values of one series in a row, and the number of the row
        rows = [(number, [cell]) for number, cells in rows for cell in cells[: len(cells) - numbered] if cell]
        width, ends_empty = 1, False
    for number, cells in rows:
        if len(cells) != width:
            raise AbraceError(f"{source}, line {number}: {len(cells)} columns, expected {width} as before")
    numbers = [number for number, _ in rows]
    columns = zip(*(cells for _, cells in rows), strict=True)
    comma = form.decimal == ","
    return Table(
        source,
        tuple(
            Column.of(
                names[i] if names else "",
                units[i] if units else "",
                [cell.replace(",", ".") for cell in cells] if comma else cells,
                numbers,
            )
            for i, cells in enumerate(columns)
            if i < width - ends_empty or (names and names[i])
        ),
        above,
        **facts,  # type: ignore[arg-type]
    )


def _form(plain: Sequence[tuple[int, str]], separator: str | None, source: str) -> tuple[_Form, int, list[int]]:
    """How the lines are divided, the number of columns, and which of these hold numbers; by the last lines."""
    sample = [re.split(r"\s#", line)[0] for _, line in plain[-LAST:]]
    best: tuple[float, int] = (0.0, 0)
    found: list[tuple[_Form, int, list[int]]] = []
    for each in [separator] if separator else ["\t", ";", ",", "|", None]:
        for decimal in ".,":
            form = _Form(each, decimal)
            cells = [form.cells(line) for line in sample if each is None or each in line]
            if len(cells) < 0.5 * len(sample):
                continue
            width = Counter(map(len, cells)).most_common(1)[0][0]
            cells = [one for one in cells if len(one) == width and any(map(form.is_number, one))]
            number = [sum(form.is_number(one[i]) for one in cells) for i in range(width)]
            filled = [sum(not _NOTHING.fullmatch(one[i]) for one in cells) for i in range(width)]
            if not sum(number):
                continue
            score = (round(sum(number) / max(sum(filled), 1), 2), len(cells))
            if score > best:
                best, found = score, []
            if score == best:
                found.append((form, width, [i for i in range(width) if number[i] > 0.8 * max(filled[i], 1)]))
    if not found or not found[0][2]:
        raise AbraceError(f"{source}, line {plain[0][0]}: {plain[0][1].strip()[:60]!r}, expected columns of numbers")
    form, width, numeric = found[0]
    comma_number = next(
        (other for other in found if other[0].separator is None and other[0].decimal == "," and other[1] == 1), None
    )
    if comma_number and not (form.separator is None and form.decimal == "."):  # 0,01
        above = next((line for _, line in reversed(plain) if re.search(r"[A-Za-z]{2}|[A-Za-z]\s*[\[(]", line)), "")
        if re.search(r",0[0-9]", "\n".join(sample)):
            return comma_number
        names = [Column.of(cell, "", ()) for cell in above.split(",")]
        if (
            f"{form.separator}{form.decimal}" != ",."
            or len(names) != width
            or not any(name.is_time or name.unit for name in names)
        ):
            raise AbraceError(
                f"{source}, line {plain[-1][0]}: {sample[-1].strip()!r} may be one number with a decimal comma, or two "
                "whole numbers; expected decimal points, or semicolons between columns"
            )
    return form, width, numeric


def _value(number: str) -> float:
    """The value of a number as written, also with a decimal comma, and with Fortran's D for an exponent."""
    return float(number.lower().replace(",", ".").replace("d", "e"))


def _even(cells: list[str], width: int) -> list[str]:
    """The cells without empty ones that separators at the end of a line make."""
    while len(cells) > width and not cells[-1]:
        cells = cells[:-1]
    return cells


def _are_pairs(rows: Sequence[tuple[int, list[str]]], width: int, form: _Form) -> bool:
    """Whether rows hold several pairs of a time and a value: every other number goes on evenly, from row to row."""
    cells = [cell for _, row in rows[:50] for cell in row[::2]]
    if width < 4 or width % 2 or len(rows) < 2 or not all(map(form.is_number, cells)):
        return False
    steps = np.diff([_value(cell) for cell in cells])
    return bool(steps.min() > 0 and steps.max() < 1.5 * steps.min())


def _is_row(cells: Sequence[str], numeric: Sequence[int], form: _Form) -> bool:
    """Whether a line is one of the table: numbers, or nothing, where there are numbers below."""
    numbers = sum(form.is_number(cells[i]) for i in numeric)
    return numbers > 0 and all(form.is_number(cells[i]) or _NOTHING.fullmatch(cells[i]) for i in numeric)


def _counted(
    rows: list[tuple[int, list[str]]], first: int, header: list[tuple[int, str]], form: _Form
) -> tuple[list[tuple[int, list[str]]], dict[str, float]]:
    """The rows of the table, and number of values and step where a first line has these."""
    before = [form.cells(line) for _, line in header[-1:]]
    if before and len(before[0]) == 2 and all(map(form.is_number, before[0])):
        head, rows = before[0], rows[first:]
    else:
        rows = rows[first:]
        head = rows[0][1]
    if len(head) == 2 and all(map(form.is_number, head)):
        count, step = map(_value, head)
        below = rows[0 if before and head is before[0] else 1 :]
        values = sum(len(cells) for _, cells in below)
        if count > 1 and count in (len(below), values) and 0 < step < 1:
            return below, {"sample_period": step, "count": count}
    if len(head) == 1 and len(rows) > 3 and len(rows[1][1]) == 1:  # count and step, or count, in lines of their own
        count, step = (_value(rows[i][1][0]) for i in (0, 1))
        if count == len(rows) - 2 and 0 < step < 1:
            return rows[2:], {"sample_period": step, "count": count}
        if count == len(rows) - 1:
            return rows[1:], {"count": count}
    return rows, {}


def _names(
    header: Sequence[tuple[int, str]], form: _Form, width: int, ends_empty: bool
) -> tuple[list[str], list[str], int]:
    """Names and units of the columns, and how many lines of the header have them."""

    def divided(index: int) -> list[str]:
        if len(header) < -index:
            return []
        line = re.sub(r"^\s*(?:#+|%+|//|!|\*)\s*", "", header[index][1]).strip()
        ways = [form.cells(line), re.split(r"\s{2,}|\t", line), _BRACKET_CELLS.findall(line), line.split(",")]
        ways = [line.split(","), *ways] if "," in line and form.separator is None else ways
        for cells in ways:
            cells = [cell.strip(' "') for cell in cells]
            cells = cells[:-1] if len(cells) == width + 1 and not cells[-1] else cells
            cells = [*cells, ""] if ends_empty and len(cells) == width - 1 else cells
            if len(cells) == width and not any(form.is_number(cell) for cell in cells) and any(cells):
                rules = all(re.fullmatch(r"[-=+|\s]*", cell) for cell in cells)
                pairs = sum(bool(re.search(r"[:=]\s*\S|[:=]$", cell)) for cell in cells)
                one = width == 1 and (len(line) > SHOWN or _COMMENT.match(header[index][1]))
                if not rules and not (pairs and width < 3) and not (one and not Column.of(cells[0], "", ()).unit):
                    return cells
        return []

    while header and re.fullmatch(r"[\s\-=+|*_#]*", header[-1][1]):
        header = header[:-1]
    last, before = divided(-1), divided(-2)
    known = [unit_in_header(cell) is not None for cell in last]
    if (
        last
        and before
        and any(known)
        and all(is_unit or len(cell) < 6 for is_unit, cell in zip(known, last, strict=True))
    ):
        return before, [cell.strip("[]() ") for cell in last], 2
    return last, [], bool(last)


def _facts(above: str) -> dict[str, float | str]:
    """What the header states: sample period [s], number of values, unit of the acceleration."""
    facts: dict[str, float | str] = {}
    periods = set()
    for found in _INTERVAL.finditer(above):
        labelled = _LABEL_UNIT.search(found["label"] or "")
        unit = unit_in_header(next(filter(None, labelled.groups())) if labelled else found["after"] or "s")
        if unit is not None and unit.dimension == TIME:
            periods.add(float(f"{_value(found['value']) * unit.factor:.12g}"))
    for found in _RATE.finditer(above):
        stated = f"{found['label']}{found['after']}{found['hertz']}".lower()
        rate = _value(found["value"] or found["at"]) * (1e3 if "khz" in stated else 1.0)
        if rate > 0:
            periods.add(1 / rate)
    periods = {each for each in periods if each > 0}
    if periods and max(periods) - min(periods) < 1e-3 * max(periods):
        facts["sample_period"] = min(periods, key=lambda each: len(repr(each)))
    if (counts := {_value(found["value"]) for found in _COUNT.finditer(above)}) and len(counts) == 1:
        facts["count"] = counts.pop()
    units = [found[1].strip() for found in _UNIT.finditer(above)]
    for line in above.split("\n"):
        written = [found[1].rstrip(".") for found in _IN_UNIT.finditer("" if _ONE_VALUE.search(line) else line)]
        units += [each for each in written if (unit := unit_in_header(each)) and unit.dimension == ACCELERATION]
    known = {unit for each in units if (unit := unit_in_header(each)) is not None}
    if len(known) == 1:
        facts["unit"] = next(each for each in units if unit_in_header(each) is not None)
    elif units and not known:
        facts["unit"] = units[0]
    return facts
