# SPDX-License-Identifier: Apache-2.0
"""Columns of numbers by name: of files (`table_files`) and arrays, for records, measured data and ambient tests."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from datetime import date, datetime
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from abrace_core import AbraceError
from abrace_core.files.even_times import even_step, half_last_digits
from abrace_core.files.units import TIME, Unit, unit_in_header

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

MOST_NAMED = 5
"""Mistakes of a file that are named; of more the number."""
_NAME = re.compile(r"^(?P<name>.*?)\s*(?:[\[(]\s*(?P<unit>[^\])]*?)\s*[\])]\s*)$")
_OTHER_UNIT = re.compile(
    r"-|m?V|volts?|counts?|raw|lsb|[kM]?N|[kM]?Pa|k?Hz|°?[CF]|m?A|rad/s|deg/s|.*strain|µ?m/m", re.IGNORECASE
)
_SUFFIX = re.compile(r"^(?P<name>.*?)(?:[_ ]|\s*[/,]\s*)(?P<unit>s|ms|us|µs|sec|msec|usec|seconds)$", re.IGNORECASE)
_CLOCK = re.compile(
    r"(?:.*?(\d{4})[-/](\d\d)[-/](\d\d)|.*?)(?:.*?\D)??(\d{1,2}):(\d\d):(\d\d)([.,]\d+)?(?:Z|[+-]\d\d:?\d\d)?"
)
_TIME = re.compile(r"t|.*time|time.*|tiempo|temps|zeit|tempo|.*timestamp|sampletimefine|seconds|sec", re.IGNORECASE)


def name_and_unit(written: str) -> tuple[str, str]:
    """The name without its unit in brackets, as `written`, and that unit; empty: it has none.

    >>> name_and_unit("a1 [g]"), name_and_unit("displacement[0]")
    (('a1', 'g'), ('displacement[0]', ''))
    """
    found = _NAME.match(written)
    if found and (_OTHER_UNIT.fullmatch(found["unit"]) or unit_in_header(found["unit"])):
        return found["name"], found["unit"]
    return written, ""  # also of displacement[0], acceleration (x)


@dataclass(frozen=True, eq=False)
class Column:
    """A column: `name` without its `unit`, which is as written (empty: none), and `written` as in the file.

    `cells` are (samples,) numbers, or their texts, whose `lines` are those of the file.
    """

    written: str
    name: str
    unit: str
    cells: NDArray[Any] | Sequence[str]
    lines: Sequence[int] = ()

    @classmethod
    def of(cls, written: str, unit: str, cells: NDArray[Any] | Sequence[str], lines: Sequence[int] = ()) -> Self:
        """A column of the name `written`, which may end with a unit, and its `cells` in `lines`."""
        written = written.strip()
        name, own = name_and_unit(written)
        if not own and (short := _SUFFIX.match(written)) and _TIME.fullmatch(short["name"]):
            name, own = short["name"], short["unit"]
        return cls(written, name or written, unit or own, cells, lines)

    @property
    def is_dates(self) -> bool:
        """Whether its cells are dates or durations of NumPy or pandas."""
        return isinstance(self.cells, np.ndarray) and self.cells.dtype.kind in "mM"

    @property
    def as_seconds(self) -> Self:
        """Of times: dates as seconds since the first, texts of hours, minutes and seconds as seconds of the day."""
        if isinstance(self.cells, np.ndarray):
            if not self.is_dates:
                return self
            since = self.cells - self.cells[0]
            seconds = since.astype("timedelta64[ns]").astype(np.int64) / 1e9
            return replace(self, cells=np.where(np.isnat(since), np.nan, seconds), unit="s")
        dated = len(self.cells) and ":" in self.cells[0]
        return replace(self, cells=_seconds(self.cells)) if dated else self

    @property
    def is_time(self) -> bool:
        """Whether it is one of times, by its name, or by its unit and the lack of a name."""
        unit = unit_in_header(self.unit)
        return bool(_TIME.fullmatch(self.name)) and (unit is None or unit.dimension == TIME)


@dataclass(frozen=True, eq=False)
class Table:
    """The columns of a `source`, and what its `header` states; `unit` and `sample_period` [s] are of all columns."""

    source: str
    columns: tuple[Column, ...]
    header: str = ""
    sample_period: float | None = None
    unit: str = ""
    count: float | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The names by which columns can be asked for: their own, or else their numbers, from 1."""
        return tuple(column.written or str(i) for i, column in enumerate(self.columns, 1))

    def find(self, name: str) -> Column | None:
        """The column of this name, with or without its unit in any case, or of this number; None: none, or several."""
        for key in (
            lambda each: each.written == name,
            lambda each: each.name == name,
            lambda each: name.strip().lower() in (each.written.lower(), each.name.lower()),
        ):
            found = [column for column in self.columns if key(column)]
            if found:
                return found[0] if len(found) == 1 else None
        number = int(name) if name.strip().isdecimal() and name.isascii() else 0
        return self.columns[number - 1] if 0 < number <= len(self.columns) else None

    def values(self, columns: Sequence[Column]) -> list[NDArray[np.float64]]:
        """(samples,) of each of the columns.

        Raises
        ------
        AbraceError
            Naming the cells of all of them that are no numbers.
        """
        found, mistakes = [], []
        for column in columns:
            if isinstance(column.cells, np.ndarray):
                if column.is_dates:
                    raise AbraceError(f"{self.source}: column {column.name} holds dates, expected numbers")
                found.append(np.asarray(column.cells, dtype=np.float64))
                continue
            numbers = [_number(cell) for cell in column.cells]
            wrong = [i for i, number in enumerate(numbers) if number is None]
            of = f" in {column.name}" if column.name and len(self.columns) > 1 else ""
            mistakes += [(column.lines[i], f"{str(column.cells[i])[:20]!r}{of}") for i in wrong]
            found.append(np.array([np.nan if number is None else number for number in numbers]))
        if mistakes:
            mistakes.sort()
            (line, first), *more = mistakes[:MOST_NAMED]
            others = "".join(f"; line {where}: {what}" for where, what in more)
            left = f"; and {len(mistakes) - MOST_NAMED} more" if len(mistakes) > MOST_NAMED else ""
            raise AbraceError(f"{self.source}, line {line}: {first}, expected a finite number{others}{left}")
        return found

    def step(self, column: Column, given: float | None = None) -> float:
        """The sample period [s] of a `column` of times, of which none may be wrong; as `sampling`.

        Raises
        ------
        AbraceError
            As of `sampling`, and where that warns.
        """
        step, warnings = self.sampling(column, given)
        if warnings:
            raise AbraceError(warnings[0])
        return step

    def sampling(self, column: Column, given: float | None = None) -> tuple[float, tuple[str, ...]]:
        """The sample period [s] of a `column` of times, and what is wrong with them although no sample is missing.

        Times are in their unit, or in s where it has none, or dates; `given` [s] decides where it fits.

        Raises
        ------
        AbraceError
            If its unit is none of time, the steps are not even, or a sample may be missing.
        """
        column = column.as_seconds
        (times,) = self.values([column])
        unit = unit_in_header(column.unit) if column.unit else Unit(1.0, TIME)
        if unit is None or unit.dimension != TIME:
            raise AbraceError(f"{self.source}: unit {column.unit!r} of the time, expected s, ms or us")
        half = half_last_digits([str(cell) for cell in column.cells]) * unit.factor

        def error_at(message: str, sample: int | None) -> AbraceError:
            lines = column.lines
            where = "" if sample is None else f", line {lines[sample]}" if lines else f", row {sample + 1}"
            return AbraceError(f"{self.source}{where}: {message}")

        wrong = np.flatnonzero(~np.isfinite(times))
        if wrong.size:
            raise error_at(f"{times[wrong[0]]:g}, expected a finite time", int(wrong[0]))
        step, noted = even_step(times * unit.factor, half, given, error_at)
        return step, tuple(str(error_at(text, sample)) for sample, text in noted.items())


def _seconds(cells: Sequence[str]) -> list[str]:
    """The seconds of times such as 12:00:00.005 since midnight, of the first date where they have dates.

    >>> _seconds(["2020-02-28 23:59:59.5", "2020-02-29T00:00:00.0"])
    ['86399.5', '86400.0']
    """
    first: int | None = None
    found = []
    for cell in cells:
        written = _CLOCK.fullmatch(cell.strip(' "'))
        try:
            day = date(*map(int, written.groups()[:3])).toordinal() if written and written[1] else 0
        except ValueError:  # no such day
            written = None
        if not written:
            found.append(cell)
            continue
        first = day if first is None else first
        seconds = 86400 * (day - first) + 3600 * int(written[4]) + 60 * int(written[5]) + int(written[6])
        found.append(f"{seconds}{(written[7] or '').replace(',', '.')}")
    return found


def _number(cell: str) -> float | None:
    """A finite number; Fortran's D is an E."""
    try:
        number = float(cell) if cell.isascii() and "_" not in cell else np.nan
    except ValueError:
        try:
            number = float(cell.lower().replace("d", "e"))
        except ValueError:
            return None
    return number if np.isfinite(number) else None


def array_table(arrays: Mapping[str, Any], source: str) -> Table:
    """The columns of arrays by name, which errors call `source`, without what is no vector or matrix of real numbers.

    Fields of structs are `struct.field`; column i (from 1) of a matrix M is M_i, of one that is wider than it is long
    row i. A structure with time of Simulink has its `time` and `signals.values`.
    """
    columns: list[Column] = []
    for name, array in _flat(arrays, ""):
        if array.dtype.kind in "OU":
            array = _numbers_or_none(array)
        if array.dtype.kind not in "fiumM" or array.size < 2 or array.ndim not in (1, 2):
            continue
        if array.ndim == 1 or 1 in array.shape:
            columns.append(Column.of(name, "", array.ravel()))
        else:
            series = array.T if array.shape[0] >= array.shape[1] else array
            columns += [Column.of(f"{name}_{i}" if name else str(i), "", one) for i, one in enumerate(series, 1)]
    return Table(source, tuple(columns))


def _flat(arrays: Mapping[str, Any], prefix: str) -> list[tuple[str, NDArray[Any]]]:
    found: list[tuple[str, NDArray[Any]]] = []
    for name, value in arrays.items():
        if str(name).startswith("__"):
            continue
        if isinstance(value, dict):
            found += _flat(value, f"{prefix}{name}.")
        elif isinstance(value, list) and value and all(isinstance(each, dict) for each in value):
            for i, each in enumerate(value, 1):
                found += _flat(each, f"{prefix}{name}_{i}.")
        elif hasattr(value, "toarray"):
            found.append((prefix + str(name), value.toarray()))
        else:
            found.append((prefix + str(name), np.asarray(value)))
    return found


def _numbers_or_none(array: NDArray[Any]) -> NDArray[Any]:
    """The numbers or times in an array of objects or texts, as columns of pandas may be; the array if it has others."""
    try:
        return array.astype(np.float64)
    except (TypeError, ValueError):
        cells = array.ravel().tolist()
    if all(isinstance(each, datetime) for each in cells):  # with a time zone
        seconds = np.array([(each - cells[0]).total_seconds() for each in cells])
    elif all(isinstance(each, str) and _CLOCK.fullmatch(each.strip(' "')) for each in cells):
        seconds = np.array([_number(each) or 0.0 for each in _seconds(cells)])
    else:
        return array
    return np.asarray((1e9 * seconds).round().astype("timedelta64[ns]").reshape(array.shape))
