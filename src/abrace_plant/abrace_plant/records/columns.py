# SPDX-License-Identifier: Apache-2.0
"""A column of a table as a record: the one that is asked for, or the only one that is named an acceleration.

No column is taken because no other is left.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_core.files.table import LONGEST_STEP
from abrace_plant.records.reading import LEAST, Reading, checked_reading, factor_of

if TYPE_CHECKING:
    from abrace_core.files.table import Column, Table
    from abrace_plant.records.asked import Asked

_ACCELERATION = re.compile(r"(?<![a-z])(?:acc|accel|acceleration|beschleunigung|aceleracion)s?(?![a-z])", re.IGNORECASE)
_SHORT = {"a", "ag", "ug_ddot", "acc", "ground_acceleration"}
_OTHER_MOTIONS = re.compile(r"(?<![a-z])(velocity|displacement|spectr(?:um|a|al)|velocidad)(?![a-z])", re.IGNORECASE)
_COUNTS = re.compile(r"counts?|digits?|raw|lsb", re.IGNORECASE)


def read_columns(table: Table, asked: Asked) -> Reading:
    """Read the record that is `asked` for from a `table`.

    Raises
    ------
    AbraceError
        If no column is one for certain: what can be given.
    """
    all_times = _times(table)
    others = [column for column in table.columns if not any(column is each for each in all_times)]
    column = _chosen(table, others, bool(all_times), asked)
    times = _times_of(table, all_times, column, asked)
    unit = column.unit or table.unit or None
    title = column.name or (f"column {table.columns.index(column) + 1}" if len(table.columns) > 1 else "")
    if unit is not None and factor_of(unit) is None:
        kind = " of the digitiser, which need the sensor's sensitivity" if _COUNTS.fullmatch(unit) else ""
        raise AbraceError(f"{table.source}: unit {unit!r}{kind} of {title or 'the values'}, expected an acceleration's")
    motions = {found.lower() for found in _OTHER_MOTIONS.findall(table.header)}
    if motions and asked.channel is None and not _ACCELERATION.search(table.header) and unit is None:
        raise AbraceError(f"{table.source}: by its header {' and '.join(sorted(motions))}, expected an acceleration")
    (values,) = table.values([column])

    def error_at(message: str, sample: int | None) -> AbraceError:
        where = f", {column.name}" if column.name and not column.lines else ""
        if sample is not None:
            where += f", line {column.lines[sample]}" if column.lines else f", row {sample + 1}"
        return AbraceError(f"{table.source}{where}: {message}")

    period = _period(table, times, column, asked)
    reading = checked_reading(values, error_at, unit=unit, sample_period=period, chosen=title)
    return replace(reading, header=next(filter(None, map(str.strip, table.header.split("\n"))), ""))


def _times(table: Table) -> list[Column]:
    """The columns of times: by their names, or, in a table without names, the first one if it rises evenly."""
    named = [column for column in table.columns if column.is_time]
    plain = [column for column in named if column.name.lower() in ("t", "time")]
    if named:
        return plain[:1] if plain and named[0].lines else named
    first = table.columns[0] if len(table.columns) > 1 else None
    matrices = {_matrix(column) for column in table.columns}
    if first is None or matrices == {None} or len(matrices) > 1:
        return []
    return [first] if _is_times(table, first) else []


def _matrix(column: Column) -> str | None:
    """The name of the matrix whose column it is, empty where that or the table has none; None: it is none."""
    matrix, _, number = column.name.rpartition("_")
    return matrix if not column.name or number.isdecimal() else None


def _is_times(table: Table, first: Column) -> bool:
    """Whether the `first` column of a table or matrix without names has times."""
    try:
        return table.step(first) > 0
    except AbraceError:
        # 0, 0.01, 0.02, 0.04: times with a mistake, which is told
        (values,) = table.values([first])
        return len(table.columns) == 2 and not table.names[0].strip("1") and _rises(values)


def _times_of(table: Table, times: list[Column], column: Column, asked: Asked) -> Column | None:
    """The times of a `column`: those in its struct, or of its length; of a matrix its first column if it rises evenly.

    Raises
    ------
    AbraceError
        If there are several, and no sample period was given.
    """
    if not times:
        matrix = _matrix(column)
        first = next((each for each in table.columns if matrix and each.name == f"{matrix}_1"), column)
        return first if first is not column and not first.lines and _is_times(table, first) else None
    structs = {each.name.rpartition(".")[0]: each for each in times}
    own = next(
        (each for name, each in structs.items() if name and re.match(rf"{re.escape(name)}([._]|$)", column.name)), None
    )
    if own is not None:
        return own
    fitting = [each for each in times if len(each.cells) == len(column.cells)] or times
    if all(each.is_same(fitting[0]) for each in fitting):
        return fitting[0]
    if asked.sample_period is None and column.sample_period is None:
        names = ", ".join(each.name for each in fitting)
        raise AbraceError(f"{table.source}: {len(fitting)} columns of times, {names}; expected {asked.period()} in s")
    return None


def _rises(values: np.ndarray) -> bool:
    return bool(np.isfinite(values).all() and np.mean(np.diff(values) > 0) > 0.9) if len(values) > 2 else False


def _chosen(table: Table, others: list[Column], timed: bool, asked: Asked) -> Column:
    names = [name for name, column in zip(table.names, table.columns, strict=True) if column in others]
    if asked.channel is not None:
        column = table.find(asked.channel)
        if column is not None and column in others:
            return column
        rows = [each for each in others if each.name.rpartition("_")[0] == asked.channel.strip()]
        if len(rows) == 1:  # a matrix of times and values
            return rows[0]
        note = table.left_out and f" ({table.left_out})"
        raise AbraceError(f"{table.source}: no column {asked.channel!r}, expected {asked.one_of(names)}{note}")
    named = [column for column in others if _ACCELERATION.search(_words(column.name)) or column.name.lower() in _SHORT]
    if len(named) == 1 and (named[0].lines or len(named[0].cells) >= LEAST):
        return named[0]
    plain = not any(column.name for column in table.columns)
    only = len(others) == 1 and (plain or (timed and not others[0].lines))
    if only and (others[0].lines or len(others[0].cells) >= LEAST):
        return others[0]
    if not table.columns:
        note = table.left_out or "no array of real numbers, expected an acceleration"
        raise AbraceError(f"{table.source}: {note}")
    if not others:
        raise AbraceError(f"{table.source}: no column of an acceleration beside {', '.join(table.names)}")
    shown = [
        f"{name} ({len(column.cells)})" if not column.lines else name
        for name, column in zip(names, others, strict=True)
    ]
    likely = [each for each in named or others if factor_of(each.unit)] or named or others
    what = f"{len(named)} columns named an acceleration" if named else "no column named an acceleration"
    raise AbraceError(f"{table.source}: {what}, expected {asked.one_of(shown, likely[0].name)}")


def _words(name: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)


def _period(table: Table, times: Column | None, column: Column, asked: Asked) -> float | None:
    """The sample period [s] by the times, the header, or the user, who decides where they leave it open."""
    given = asked.sample_period
    stated = column.sample_period or table.sample_period
    if times is None:
        return stated
    if (count := len(times.cells)) != len(column.cells):
        if given is not None:
            return given
        what = f"{times.name} has {count} times and {column.name} {len(column.cells)} values"
        raise AbraceError(f"{table.source}: {what}, expected as many, or {asked.period()} in s")
    if not times.unit:
        plain = replace(times, unit="s")
        step = table.step(plain)
        whole = step >= LONGEST_STEP
        if whole and (given is not None or stated is not None):  # numbers of samples, or another unit
            return stated if given is None else given
        if whole:
            what = f"{times.name or 'column 1'} rises by {step:g} and states no unit"
            raise AbraceError(f"{table.source}: {what}, expected {asked.period()} in s")
    return table.step(times, given)
