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
_STATED = re.compile(
    r"(?:dt|t_?s|delta_?t|sampl[a-z]*_?(?:period|interval|step|time)|time_?step)(?:_(?P<unit>s|ms|us))?"
    r"|(?P<rate>f_?s|sampl[a-z]*_?(?:rate|freq|frequency))(?:_(?P<hertz>k?hz))?",
    re.IGNORECASE,
)
"""Names of a sample period or rate."""
LONGEST_STEP = 0.5
"""Of times without a unit [s]: greater numbers count samples, or are of another unit."""
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

    `cells` are (samples,) numbers, or their texts, whose `lines` are those of the file; the `sample_period` [s] is that
    of a number beside the array, such as `dt`.
    """

    written: str
    name: str
    unit: str
    cells: NDArray[Any] | Sequence[str]
    lines: Sequence[int] = ()
    sample_period: float | None = None

    @classmethod
    def of(cls, written: str, unit: str, cells: NDArray[Any] | Sequence[str], lines: Sequence[int] = ()) -> Self:
        """A column of the name `written`, which may end with a unit, and its `cells` in `lines`."""
        written = written.strip()
        name, own = name_and_unit(written)
        if not own and (short := _SUFFIX.match(written)) and _TIME.fullmatch(short["name"]):
            name, own = short["name"], short["unit"]
        return cls(written, name or written, unit or own, cells, lines)

    def is_same(self, other: Column) -> bool:
        """Whether it is the `other`, or the times that another structure has as well."""
        arrays = isinstance(self.cells, np.ndarray) and isinstance(other.cells, np.ndarray)
        return self is other or (arrays and self.is_time and other.is_time and np.array_equal(self.cells, other.cells))

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
        """Whether it is one of times, by its name, of a struct's field by the field's."""
        unit = unit_in_header(self.unit)
        field = self.name.rpartition(".")[2] if isinstance(self.cells, np.ndarray) else self.name
        return bool(_TIME.fullmatch(field)) and (unit is None or unit.dimension == TIME)


@dataclass(frozen=True, eq=False)
class Table:
    """The columns of a `source`, and what its `header` states; `unit` and `sample_period` [s] are of all columns."""

    source: str
    columns: tuple[Column, ...]
    header: str = ""
    sample_period: float | None = None
    unit: str = ""
    count: float | None = None
    left_out: str = ""
    """What of the source is no column, and why."""

    @property
    def names(self) -> tuple[str, ...]:
        """The names by which columns can be asked for: their own, or else their numbers, from 1."""
        return tuple(column.written or str(i) for i, column in enumerate(self.columns, 1))

    def find(self, name: str) -> Column | None:
        """The column of this name, with or without its unit in any case, or of this number; None: none, or several.

        The last part of a name is enough, as `w` of `model/table/w` or `test.w`.
        """
        for key in (
            lambda each: each.written == name,
            lambda each: each.name == name,
            lambda each: name.strip().lower() in (each.written.lower(), each.name.lower()),
            lambda each: re.split(r"[./]", each.name)[-1] == name.strip(),
        ):
            found = [column for column in self.columns if key(column)]
            if found:
                return found[0] if all(each.is_same(found[0]) for each in found) else None
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

    def rises(self, column: Column) -> bool:
        """Whether the numbers of a `column` rise throughout, as times do."""
        try:
            (values,) = self.values([column.as_seconds])
        except AbraceError:
            return False
        return bool(len(values) > 1 and (np.diff(values) > 0).all())

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

    Column i (from 1) of a matrix M is M_i, of one that is wider than it is long row i. Fields of structs are
    `struct.field`. Of Simulink's structure S the values are S, or their labels where there are several, and the times
    `S.time`; of a recording R of dSPACE each series has its own name, and the times are `R.time`. A number that is
    named `dt` or `fs` is the sample period or rate.
    """
    columns: list[Column] = []
    left_out: list[str] = []
    stated: dict[str, float] = {}
    for name, value in _flat(arrays, ""):
        array = _numbers_or_none(value) if value.dtype.kind in "OU" else value
        if array.size == 1 and array.dtype.kind in "fiu" and (period := _stated_period(name, float(array.ravel()[0]))):
            stated.setdefault(name.rpartition(".")[0], period)
        if array.ndim > 2 and array.size > 1 and array.dtype.kind in "fiu":
            size = " x ".join(map(str, array.shape))
            left_out.append(f"{name or 'the array'} is {size}, expected each record of it as a matrix of its own")
        elif array.dtype.kind == "c":
            left_out.append(f"{name or 'the array'} is complex, expected real numbers")
        if array.dtype.kind not in "fiumM" or array.size < 2 or array.ndim not in (1, 2):
            continue
        if array.ndim == 1 or 1 in array.shape:
            columns.append(Column.of(name, "", array.ravel()))
        else:
            series = array.T if array.shape[0] >= array.shape[1] else array
            columns += [Column.of(f"{name}_{i}" if name else str(i), "", one) for i, one in enumerate(series, 1)]
    columns = [
        replace(each, sample_period=stated.get(each.name.rpartition(".")[0], stated.get(""))) for each in columns
    ]
    periods = {each.sample_period for each in columns}
    period = periods.pop() if len(periods) == 1 else None
    return Table(source, tuple(columns), sample_period=period, left_out="; ".join(left_out))


def _stated_period(name: str, number: float) -> float | None:
    """The sample period [s] that a `number` of this name states; None where it is named, or of a size, otherwise."""
    found = _STATED.fullmatch(name.rpartition(".")[2])
    if not (found and 0 < number < np.inf):
        return None
    if found["rate"]:
        return 1 / (number * (1e3 if (found["hertz"] or "").lower() == "khz" else 1.0))
    unit = unit_in_header(found["unit"] or "")
    if unit is None:
        return number if number < LONGEST_STEP else None
    return number * unit.factor


def _flat(arrays: Mapping[str, Any], prefix: str) -> list[tuple[str, NDArray[Any]]]:
    """Names and arrays of `arrays` and of the structs in them, whose names begin with the `prefix`."""
    found: list[tuple[str, NDArray[Any]]] = []
    for name, value in arrays.items():
        if str(name).startswith("__"):
            continue
        if isinstance(value, dict):
            named = _of_simulink(value, f"{prefix}{name}") or _of_dspace(value, f"{prefix}{name}")
            found += named or _flat(value, f"{prefix}{name}.")
        elif structs := _structs(value):
            for i, each in enumerate(structs, 1):
                found += _flat(each, f"{prefix}{name}_{i}.")
        elif hasattr(value, "toarray"):
            found.append((prefix + str(name), value.toarray()))
        else:
            found.append((prefix + str(name), np.asarray(value)))
    return found


def _structs(value: Any) -> list[dict[str, Any]]:
    """The structs of a struct array; none: it is none."""
    several = [value] if isinstance(value, dict) else value if isinstance(value, list) else []
    if isinstance(value, dict) and value and all(isinstance(each, list) for each in value.values()):  # of version 7.3
        several = [dict(zip(value, each, strict=True)) for each in zip(*value.values(), strict=False)]
    return several if several and all(isinstance(each, dict) for each in several) else []


def _of_simulink(struct: Mapping[str, Any], name: str) -> list[tuple[str, NDArray[Any]]]:
    """Names and arrays of Simulink's structure of this name, with or without time; none: it is none."""
    signals = _structs(struct.get("signals"))
    if not signals or not all("values" in each for each in signals):
        return []
    labels = [str(each.get("label", "")).strip() if isinstance(each.get("label"), str) else "" for each in signals]
    alone = len(signals) == 1
    names = [name if alone else label or f"{name}_{i}" for i, label in enumerate(labels, 1)]
    times = [(f"{name}.time", np.asarray(struct["time"]))] if np.size(struct.get("time", [])) else []
    return [*times, *((each, np.asarray(one["values"])) for each, one in zip(names, signals, strict=True))]


def _of_dspace(struct: Mapping[str, Any], name: str) -> list[tuple[str, NDArray[Any]]]:
    """Names and arrays of dSPACE's recording of this name, whose X has the times and Y the series; none: it is none."""
    axes, series = (_structs(struct.get(key)) for key in "XY")
    if not (axes and series and all("Data" in each for each in (*axes, *series))):
        return []
    times = [(f"{name}.time" if len(axes) == 1 else f"{name}.time_{i}", each) for i, each in enumerate(axes, 1)]
    paths = [" ".join(str(each.get("Name", "")).replace('"', "").split()) for each in series]
    names = [path or f"{name}.Y_{i}" for i, path in enumerate(paths, 1)]
    return [(each, np.asarray(one["Data"])) for each, one in (*times, *zip(names, series, strict=True))]


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
