# SPDX-License-Identifier: Apache-2.0
"""Measured data of any structure: arrays with named inputs and outputs, from MATLAB, NumPy or CSV files.

Tests of a rig are read from bags (`Run`). Both types have the attributes that identification needs.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass, field, replace
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from abrace_core import signals
from abrace_core.errors import AbraceError
from abrace_core.matlab_loader import load_matlab

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pandas
    from numpy.typing import ArrayLike, NDArray

EVEN = 0.01
"""Greatest difference of a time step from the mean step, as a share of it."""

DataHold = Literal["band", "zero"]

SUFFIXES = (".mat", ".csv", ".npz", ".npy")


@dataclass(frozen=True)
class MeasuredData:
    """A test with any inputs and outputs.

    Parameters
    ----------
    source
        Origin of the data, for messages and provenance.
    sample_period
        Seconds.
    inputs, names
        Names of the inputs, and of the outputs.
    excitation, outputs
        (samples, inputs) and (samples, outputs), in the units of the file.
    units
        Units by name, for figures; may lack some.
    hold
        "band": inputs and outputs are band-limited below half the sample rate and sampled alike; "zero": each input
        keeps its value until the next sample (zero-order hold), as commands do.
    """

    source: str
    sample_period: float
    inputs: tuple[str, ...]
    names: tuple[str, ...]
    excitation: NDArray[np.float64]
    outputs: NDArray[np.float64]
    units: Mapping[str, str] = field(default_factory=dict)
    hold: DataHold = "band"

    def __post_init__(self) -> None:
        if not self.inputs or not self.names:
            raise AbraceError(f"{self.source}: {len(self.inputs)} inputs and {len(self.names)} outputs, expected both")
        if not (np.isfinite(self.sample_period) and self.sample_period > 0):
            raise AbraceError(f"{self.source}: sample period {self.sample_period} s, expected a number > 0")
        named = (*self.inputs, *self.names)
        twice = [name for name in named if named.count(name) > 1]
        if twice:
            names = ", ".join(dict.fromkeys(twice))
            raise AbraceError(f"{self.source}: named twice: {names}; expected each column once")
        if self.hold not in get_args(DataHold):
            raise AbraceError(f"{self.source}: hold {self.hold!r}, expected {' or '.join(get_args(DataHold))}")
        unknown = [name for name in self.units if name not in named]
        if unknown:
            raise AbraceError(f"{self.source}: units of {', '.join(unknown)}, expected of some of {', '.join(named)}")

    @property
    def sequence(self) -> NDArray[np.uint64]:
        """(samples,) sample numbers."""
        return np.arange(len(self.outputs), dtype=np.uint64)

    @property
    def command_names(self) -> tuple[str, ...]:
        """Empty: `inputs` has all inputs of measured data; only a rig's tests have commands."""
        return ()

    @property
    def seconds(self) -> float:
        """Length of the record [s]."""
        return len(self.outputs) * self.sample_period

    def channels(self, names: Sequence[str]) -> NDArray[np.float64]:
        """(samples, len(names)) the inputs or outputs with these `names`, in either form (`signals.positions`)."""
        chosen = signals.positions(names, (*self.inputs, *self.names), f"{self.source}: no channel")
        return np.hstack([self.excitation, self.outputs])[:, chosen]

    def part(self, first: int, last: int) -> MeasuredData:
        """The samples from `first` to before `last`."""
        return replace(self, excitation=self.excitation[first:last], outputs=self.outputs[first:last])

    def select(self, names: Sequence[str]) -> MeasuredData:
        """The same test with only the outputs `names`."""
        kept = {name: unit for name, unit in self.units.items() if name in (*self.inputs, *names)}
        return replace(self, names=tuple(names), outputs=self.channels(names), units=kept)


def read_data(
    path: Path | str | Mapping[str, ArrayLike] | pandas.DataFrame,
    inputs: Sequence[str],
    outputs: Sequence[str] = (),
    sample_rate: float = 0.0,
    time: str = "",
    units: Mapping[str, str] | None = None,
    hold: DataHold = "band",
) -> MeasuredData:
    """Read measured data from a file, or take them from arrays or a DataFrame.

    Parameters
    ----------
    path
        A `.mat` (up to version 7), `.npz`, `.npy` or `.csv` file; the first line of a `.csv` file has the names. A
        vector is a column with the vector's name. Column i (from 1) of a matrix M is named M_i, of an `.npy` file i.
        Instead of a file: arrays (samples,) by name, or a DataFrame.
    inputs, outputs
        Names of columns, a rig's signals in either form (`signals.positions`). Without outputs all columns are outputs
        that are neither an input nor the time.
    sample_rate
        [Hz]; 0: computed from the time column.
    time
        Name of the column with the times [s] of the samples, evenly spaced.
    units, hold
        As of `MeasuredData`.

    Raises
    ------
    AbraceError
        If the file cannot be read, a column does not exist, columns differ in length, or the times are not evenly
        spaced.
    """
    if isinstance(path, (str, Path)):
        columns = _columns_of(_read(Path(path)), path)
    elif hasattr(path, "keys"):
        columns = _columns_of({str(name): np.asarray(path[name]) for name in path}, "data")
        path = "data"
    else:
        raise AbraceError(f"data {type(path).__name__}, expected a file, a DataFrame, or arrays by name")
    if not isinstance(sample_rate, Real):
        raise AbraceError(f"{path}: sample_rate {sample_rate!r}, expected a number in Hz")
    if (sample_rate > 0) == bool(time):
        raise AbraceError(f"{path}: sample_rate {sample_rate:g} Hz and time {time!r}, expected just one of the two")
    named = {signals.meaning(name) for name in (*inputs, time)}
    outputs = outputs or [name for name in columns if signals.meaning(name) not in named]
    wanted = (*inputs, *outputs, *([time] if time else []))
    known = list(columns)
    columns = {
        name: columns[known[i]]
        for name, i in zip(wanted, signals.positions(wanted, known, f"{path}: no column"), strict=True)
    }
    lengths = {name: len(columns[name]) for name in wanted}
    if len(set(lengths.values())) > 1:
        (one, other), *_ = [(a, b) for a in wanted for b in wanted if lengths[a] < lengths[b]]
        found = f"{one} has {lengths[one]} samples and {other} {lengths[other]}"
        raise AbraceError(f"{path}: {found}, expected the same; name the inputs and outputs that belong together")
    period = 1 / sample_rate if sample_rate > 0 else _period(path, time, columns[time])
    excitation, measured = (np.column_stack([columns[name] for name in names]) for names in (inputs, outputs))
    return MeasuredData(str(path), period, tuple(inputs), tuple(outputs), excitation, measured, units or {}, hold)


def units_of(given: Sequence[str]) -> dict[str, str]:
    """The units by name, from texts `given` as NAME=UNIT.

    >>> units_of(["a1=m/s^2", "force=N"])
    {'a1': 'm/s^2', 'force': 'N'}
    """
    found = {}
    for text in filter(None, given):
        name, equals, unit = text.partition("=")
        if not (name and equals and unit):
            raise AbraceError(f"unit {text!r}, expected NAME=UNIT")
        found[name] = unit
    return found


def _columns_of(arrays: Mapping[str, NDArray[Any]], source: Path | str) -> dict[str, NDArray[np.float64]]:
    """The columns of arrays, those of a matrix numbered; what is no vector or matrix of real numbers is left out."""
    columns: dict[str, NDArray[np.float64]] = {}
    for name, array in arrays.items():
        if array.dtype.kind == "O":
            array = _numbers_or_none(array)
        if array.dtype.kind not in "fiu" or array.size < 2 or array.ndim not in (1, 2):
            continue
        values = array.astype(np.float64)
        if values.ndim == 1 or 1 in values.shape:
            columns[name] = values.ravel()
        else:
            columns |= {f"{name}_{i + 1}" if name else str(i + 1): column for i, column in enumerate(values.T)}
    if not columns:
        raise AbraceError(f"{source}: no array of real numbers, expected at least one")
    return columns


def _numbers_or_none(array: NDArray[Any]) -> NDArray[Any]:
    """The numbers in an array of objects, as a column of pandas with empty cells is; the array if it has others."""
    try:
        return array.astype(np.float64)
    except (TypeError, ValueError):
        return array


def _read(path: Path) -> Mapping[str, NDArray[Any]]:
    """The arrays in a file by name."""
    ending = path.suffix.lower()
    if ending not in SUFFIXES:
        raise AbraceError(f"{path}: expected a file with the ending {', '.join(SUFFIXES)}")
    try:
        if ending == ".csv":
            return _csv_columns(path)
        if ending == ".mat":
            found = load_matlab(path).items()
            return {name: np.asarray(value) for name, value in found if not name.startswith("__")}
        if ending == ".npy":
            return {"": np.load(path)}
        with np.load(path) as content:
            return dict(content)
    except AbraceError:
        raise
    except OSError as error:
        raise AbraceError(f"{path}: {error.strerror or error}") from error
    except Exception as error:  # NumPy's reader raises many types for a damaged file
        raise AbraceError(f"{path}: cannot be read as {ending} ({error})") from error


def _csv_columns(path: Path) -> dict[str, NDArray[np.float64]]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            names = [name.strip() for name in next(csv.reader(file), [])]
            values = np.loadtxt(file, delimiter=",", ndmin=2)
    except ValueError as error:
        raise AbraceError(
            f"{path}, {_where(path)}, expected a line of names, then numbers with commas between"
        ) from error
    if values.shape[1] != len(names):
        raise AbraceError(f"{path}: {len(names)} names and {values.shape[1]} columns, expected as many")
    return dict(zip(names, values.T, strict=True))


def _where(path: Path) -> str:
    """A description of the first line of a CSV file that cannot be read as numbers."""
    columns = 0
    for number, line in enumerate(path.read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        if ";" in line or "\ufffd" in line:
            return f"line {number}: {'a semicolon' if ';' in line else 'a character that is not UTF-8'}"
        cells = line.split(",")
        columns = columns or len(cells)
        if len(cells) != columns:
            return f"line {number}: {len(cells)} columns, {columns} in the first line"
        for cell in cells if number > 1 else ():
            try:
                float(cell)
            except ValueError:
                return f"line {number}: {cell.strip()!r}"
    return "no numbers in it"


def _period(path: Path | str, name: str, time: NDArray[np.float64]) -> float:
    """The sample period [s] of a time column; an error if its steps are uneven."""
    steps = np.diff(time)
    period = float(np.mean(steps)) if len(steps) else 0.0
    uneven = np.flatnonzero(~(np.abs(steps - period) <= EVEN * period))
    if not period > 0 or len(uneven):
        where = f", first after sample {uneven[0]}" if len(uneven) else ""
        raise AbraceError(f"{path}: time column {name} does not rise in even steps{where}; expected within {EVEN:.0%}")
    return period
