# SPDX-License-Identifier: Apache-2.0
"""A recorded test: inputs and outputs of a rig, or of any structure, and which of its channels can be used."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from pydantic import Field
from scipy import signal

from abrace_bags import Bag
from abrace_bags.sequence import breaks
from abrace_core import AbraceError
from abrace_core.files.options import NonNegative, Options
from abrace_core.files.table import LONGEST_STEP, Column, Table, array_table
from abrace_core.files.table_files import read_table
from abrace_core.files.units import unit_as_stated
from abrace_core.model import signals
from abrace_core.model.discretization import HOLDS
from abrace_core.model.run import Run
from abrace_core.model.si_units import si_factor
from abrace_sysid.recorded.series import find_period, hann_power, transform

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    import pandas
    from numpy.typing import ArrayLike, NDArray

    from abrace_core.model.discretization import Hold

InputHold = Literal["zero", "first", "band"]
"""Zero-order hold, linear between samples (first-order hold), or band-limited below half the sample rate and sampled
like the outputs, so that the response is that of the continuous structure."""

MARGIN = 200
"""Samples by which a record is continued at its ends before its outputs are moved in time."""
AGREES = 0.01
"""Share by which a sample rate that is given may differ from that of times that are not asked for."""

DataHold = Literal["band", "zero"]
TestHold = Literal["rig", "band", "zero"]


@dataclass(frozen=True)
class Test:
    """A recorded test without a gap. `of` makes it of a Run, `read` of a bag or file, `from_arrays` of arrays.

    Parameters
    ----------
    source
        Origin, for messages and provenance.
    sample_period
        Seconds.
    inputs, names
        Names of the inputs, and of the outputs.
    excitation, outputs
        (samples, inputs) and (samples, outputs). A command is that which acts from each sample on.
    units
        Units by name; a rig's signal that is not among them is in SI units.
    hold
        How inputs move between samples. "rig": a command keeps its value, the table's acceleration is linear; "band":
        inputs and outputs are band-limited below half the sample rate and sampled alike; "zero": every input keeps its
        value (zero-order hold).
    floors, braces
        Of a rig: number of floors, and of braces in each group.
    facts
        Of the test, from the bag.
    flagged
        Samples that the sensors reported at the end of their range, by channel.
    faults
        Outputs that do not respond to the inputs, each with the reason; from `examination`.
    clipped
        Samples at their own extremes, by channel; from `examination`.
    warnings
        One sentence each: of the bag, and from `examination` about channels.
    """

    __test__ = False  # pytest takes it for tests of its own

    source: str
    sample_period: float
    inputs: tuple[str, ...]
    names: tuple[str, ...]
    excitation: NDArray[np.float64]
    outputs: NDArray[np.float64]
    units: Mapping[str, str] = field(default_factory=dict)
    hold: TestHold = "band"
    floors: int = 0
    braces: tuple[int, ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)
    flagged: Mapping[str, int] = field(default_factory=dict)
    faults: Mapping[str, str] = field(default_factory=dict)
    clipped: Mapping[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.names:
            raise AbraceError(f"{self.source}: no output, expected at least one")
        if not (np.isfinite(self.sample_period) and self.sample_period > 0):
            raise AbraceError(f"{self.source}: sample period {self.sample_period} s, expected a number > 0")
        named = (*self.inputs, *self.names)
        once(named, self.source)
        if self.hold not in get_args(TestHold):
            raise AbraceError(f"{self.source}: hold {self.hold!r}, expected {' or '.join(get_args(TestHold))}")
        unknown = [name for name in self.units if name not in named]
        if unknown:
            raise AbraceError(f"{self.source}: units of {', '.join(unknown)}, expected of some of {', '.join(named)}")

    def __repr__(self) -> str:
        faults = f", {', '.join(self.faults)} not used" if self.faults else ""
        return (
            f"<Test {self.source}: {self.seconds:g} s at {1 / self.sample_period:g} Hz, {', '.join(self.inputs)} to "
            f"{', '.join(self.names)}{faults}>"
        )

    @classmethod
    def of(cls, run: Run) -> Test:
        """The test that a `run` recorded or simulated.

        Raises
        ------
        AbraceError
            If samples are missing; a bag is read without (`abrace_bags.Bag.tests`).
        """
        gaps = breaks(run.sequence)
        if len(gaps):
            raise AbraceError(
                f"{run.source}: sample {run.sequence[gaps[0] + 1]} after {run.sequence[gaps[0]]}, expected consecutive "
                "samples, as a bag's tests have them"
            )
        excitation = np.column_stack([run.ground_acceleration, run.command_from_here])
        braces, inputs = run.braces or (1,) * run.groups, (run.disturbance, *run.command_names)
        of_rig = not run.signals
        flagged = {name: count or 0 for name, count in (run.clipped_samples or {}).items()}
        return cls(
            run.source,
            run.sample_period,
            inputs,
            run.names,
            excitation,
            run.outputs,
            run.units,
            hold="rig" if of_rig else "zero",
            floors=run.floors,
            braces=braces if of_rig else (),
            facts=run.facts,
            flagged=flagged,
            warnings=tuple(run.facts.get("warnings", ())),
        )

    @classmethod
    def read(
        cls,
        path: Path | str,
        inputs: Sequence[str] | None = (),
        outputs: Sequence[str] = (),
        sample_rate: float = 0.0,
        time: str = "",
        units: Mapping[str, str] | None = None,
        hold: TestHold = "band",
    ) -> Test:
        """Read the folder of a bag, for which `path` is enough, or a file with columns.

        Parameters
        ----------
        path
            A bag with one test, or a file with columns: MATLAB's, NumPy's, a text (`table_files`). A vector
            is a column with the vector's name. Column i (from 1) of a matrix M is named M_i, of an `.npy` file i.
        inputs, outputs, sample_rate, time, units, hold
            As of `from_arrays`.

        Raises
        ------
        AbraceError
            If the file cannot be read, or as in `from_arrays`.
        """
        if isinstance(path, str | Path) and Path(path).is_dir():
            tests = Bag(path).tests()
            if len(tests) > 1:
                raise AbraceError(f"{path}: {len(tests)} tests, expected one")
            return cls.of(tests[0])
        return cls.from_arrays(read_table(Path(path)), inputs, outputs, sample_rate, time, units, hold, str(path))

    @classmethod
    def from_arrays(
        cls,
        arrays: Mapping[str, ArrayLike] | pandas.DataFrame | Table,
        inputs: Sequence[str] | None,
        outputs: Sequence[str] = (),
        sample_rate: float = 0.0,
        time: str = "",
        units: Mapping[str, str] | None = None,
        hold: TestHold = "band",
        source: str = "data",
    ) -> Test:
        """The test in arrays by name, or in a DataFrame.

        Parameters
        ----------
        arrays
            (samples,) each, or matrices as in `read`.
        inputs, outputs
            Names of columns with or without their units, one alone as a text, a rig's signals in either form
            (`signals.positions`). Inputs None: of an ambient test. Without outputs all columns are outputs that are
            neither an input nor the time.
        sample_rate
            [Hz]; 0: computed from the time column, or as the file states it. It decides where times are rounded.
        time
            Name of the column with the times of the samples, evenly spaced: in s unless it states ms or us, or dates.
            Where one is wrong and no sample can be missing (`Table.sampling`), that is a warning.
        units, hold
            As of `Test`. With "rig" the names are those of a rig: `w` and the commands `U`, `x1`, `a1`, `xf`, `f` ...
        source
            Origin, for messages.

        Raises
        ------
        AbraceError
            If a column does not exist, columns differ in length, the times are not evenly spaced, or a sample may be
            missing.
        """
        if not isinstance(arrays, Table):
            if not hasattr(arrays, "keys"):
                raise AbraceError(f"data {type(arrays).__name__}, expected a file, a DataFrame, or arrays by name")
            once([str(name) for name in arrays], source)
            arrays = array_table({str(name): np.asarray(arrays[name]) for name in arrays}, source)
        if inputs is not None and not inputs:
            raise AbraceError(f"{source}: no input, expected some of {', '.join(arrays.names)}")
        inputs, outputs = ((names,) if isinstance(names, str) else names or () for names in (inputs, outputs))
        if not isinstance(sample_rate, Real):
            raise AbraceError(f"{source}: sample_rate {sample_rate!r}, expected a number of Hz")
        if not arrays.columns:
            raise AbraceError(f"{source}: {arrays.left_out or 'no array of real numbers, expected at least one'}")
        columns, asked = _asked(arrays, [*inputs, *outputs, *([time] if time else [])])
        if not outputs:
            columns |= {name: column for name, column in _others(arrays, asked).items() if name not in columns}
            outputs = [name for name in columns if name not in (*inputs, time)]
        given = 1 / sample_rate if sample_rate > 0 else None
        period, wrong = arrays.sampling(columns[time], given) if time else (given or arrays.sample_period, ())
        if period is None:
            times = [column.name for column in arrays.columns if column.is_time]
            hint = f", such as time={times[0]!r}" if times else ""
            raise AbraceError(f"{source}: sample_rate 0 Hz and time '', expected one of the two{hint}")
        if given and not time:
            _require_agreement(arrays, given)
        lengths = {name: len(columns[name].cells) for name in columns}
        if len(set(lengths.values())) > 1:
            (one, other), *_ = [(a, b) for a in columns for b in columns if lengths[a] < lengths[b]]
            found = f"{one} has {lengths[one]} samples and {other} {lengths[other]}"
            raise AbraceError(f"{source}: {found}, expected the same; name the inputs and outputs that belong together")
        once([*inputs, *outputs], source)
        wanted = [*inputs, *outputs]
        values = np.column_stack(arrays.values([columns[name] for name in wanted]))
        excitation, measured = values[:, : len(inputs)], values[:, len(inputs) :]
        units = {name: columns[name].unit for name in wanted if columns[name].unit} | dict(units or {})
        floors, groups = (sum(name[:1] == letter and name[1:2] != "f" for name in wanted) for letter in "xU")
        rig = (floors, (1,) * groups) if hold == "rig" else (0, ())
        inputs, outputs = tuple(inputs), tuple(outputs)
        return cls(source, period, inputs, outputs, excitation, measured, units, hold, *rig, warnings=wrong)

    @property
    def seconds(self) -> float:
        """Length of the record [s]."""
        return len(self.outputs) * self.sample_period

    @property
    def groups(self) -> int:
        """Number of a rig's brace groups."""
        return len(self.braces)

    @property
    def commands(self) -> tuple[str, ...]:
        """Names of a rig's commands."""
        return tuple(name for name in self.inputs if name != signals.GROUND) if self.hold == "rig" else ()

    @property
    def moving(self) -> tuple[str, ...]:
        """The commands that are not zero throughout."""
        return tuple(name for name in self.commands if self.channel(name).any())

    @cached_property
    def periods(self) -> dict[str, int | None]:
        """By input the samples in its period; None: it is not periodic."""
        return {name: find_period(self.channel(name)) for name in self.inputs}

    @property
    def period(self) -> int | None:
        """The longest period of an input [samples]; None: no input is periodic."""
        return max((each or 0 for each in self.periods.values()), default=0) or None

    def hold_of(self, name: str) -> InputHold:
        """The hold of the input `name`."""
        return HOLDS.get(name, "zero") if self.hold == "rig" else self.hold

    @property
    def holds(self) -> dict[str, Hold]:
        """By input whether its value is held between samples, or linear; not of a band-limited test."""
        return {name: "first" if self.hold_of(name) == "first" else "zero" for name in self.inputs}

    def channel(self, name: str) -> NDArray[np.float64]:
        """(samples,) the input or output `name`."""
        return self.channels([name])[:, 0]

    def channels(self, names: Sequence[str]) -> NDArray[np.float64]:
        """(samples, len(names)) the inputs or outputs with these `names`, in either form (`signals.positions`)."""
        chosen = signals.positions(names, (*self.inputs, *self.names), f"{self.source}: no channel")
        return np.column_stack(
            [self.excitation[:, i] if i < len(self.inputs) else self.outputs[:, i - len(self.inputs)] for i in chosen]
        )

    def part(self, first: int, last: int) -> Test:
        """The samples from `first` to before `last`."""
        return replace(self, excitation=self.excitation[first:last], outputs=self.outputs[first:last])

    def in_time(self, late: Mapping[str, float]) -> Test:
        """The test with channels moved in time; the ends are lost.

        Parameters
        ----------
        late
            By name: by how many seconds an output is late, or an input acts late; of other channels without effect.
        """
        late = {name: by for name, by in late.items() if name in (*self.names, *self.inputs)}
        lost = max((int(np.ceil(abs(by) / self.sample_period)) for by in late.values()), default=0)
        if not lost:
            return self
        outputs, excitation = self.outputs.copy(), self.excitation.copy()
        margin = min(MARGIN, len(self.outputs) - 1)
        taper = np.sin(np.linspace(0, np.pi / 2, margin)) ** 2
        window = np.concatenate([taper, np.ones(len(self.outputs)), taper[::-1]])
        for name, by in late.items():
            # an output is moved ahead, an input back
            is_output = name in self.names
            column = outputs[:, self.names.index(name)] if is_output else excitation[:, self.inputs.index(name)]
            offset = column.mean()
            longer = np.pad(column - offset, margin, "reflect", reflect_type="odd") * window
            turn = np.exp(2j * np.pi * np.fft.rfftfreq(len(longer), self.sample_period) * (by if is_output else -by))
            column[:] = offset + np.fft.irfft(np.fft.rfft(longer) * turn, len(longer))[margin:-margin]
        return replace(self, outputs=outputs, excitation=excitation).part(lost, len(self.outputs) - lost)

    def select(self, names: Sequence[str]) -> Test:
        """The same test with only the outputs `names`."""
        kept = {name: unit for name, unit in self.units.items() if name in (*self.inputs, *names)}
        return replace(self, names=tuple(names), outputs=self.channels(names), units=kept)

    @cached_property
    def still(self) -> Test:
        """The test with trends removed from all that was measured; commands are known exactly and stay.

        From a response to noise a straight line is removed, from a periodic one only the mean, since a line fitted to
        it would follow the periods.
        """
        kind: Literal["linear", "constant"] = "constant" if self.period else "linear"
        excitation = self.excitation.copy()
        measured = [i for i, name in enumerate(self.inputs) if name not in self.commands]
        excitation[:, measured] = signal.detrend(excitation[:, measured], axis=0, type=kind)
        return replace(self, excitation=excitation, outputs=signal.detrend(self.outputs, axis=0, type=kind))

    @cached_property
    def _computed(self) -> dict[tuple[Any, str], NDArray[Any]]:
        return {}

    def _once(self, compute: Callable[[NDArray[np.float64]], NDArray[Any]], names: Sequence[str]) -> NDArray[Any]:
        """What `compute` gives of the channels `names`, each computed once; a value that is not finite counts as 0."""
        missing = [name for name in dict.fromkeys(names) if (compute, name) not in self._computed]
        if missing:
            found = compute(np.nan_to_num(self.channels(missing), posinf=0.0, neginf=0.0))
            self._computed.update({(compute, name): column for name, column in zip(missing, found.T, strict=True)})
        return np.column_stack([self._computed[compute, name] for name in names])

    def spectra(self, names: Sequence[str]) -> NDArray[np.complex128]:
        """(lines, len(names)) the `transform` of the whole channels `names`."""
        return self._once(transform, names)

    def powers(self, names: Sequence[str]) -> NDArray[np.float64]:
        """(lines, len(names)) the `hann_power` of the whole channels `names`."""
        return self._once(hann_power, names)

    def examined(self, faults: Mapping[str, str], clipped: Mapping[str, int], warnings: Sequence[str]) -> Test:
        """The same test with these `faults`, `clipped` samples and `warnings`, and what was computed of its samples."""
        found = copy(self)
        found.__dict__.pop("still", None)
        found.__dict__.update(faults=faults, clipped=clipped, warnings=tuple(warnings))
        return found

    def in_si_units(self) -> Test:
        """The same test with its signals in SI units, as far as their units are known; itself where they are.

        Raises
        ------
        AbraceError
            If a rig's signal has a unit that cannot be converted.
        """
        found = {name: si_factor(name, unit, f"{self.source}: channel") for name, unit in self.units.items()}
        units = {name: unit for name, (_, unit) in found.items()}
        if units == self.units:
            return self
        into, out_of = (
            np.array([found[name][0] if name in found else 1.0 for name in names])
            for names in (self.inputs, self.names)
        )
        return replace(self, excitation=self.excitation * into, outputs=self.outputs * out_of, units=units)

    def is_same(self, other: Test) -> bool:
        """Whether the `other` is the same test: every sample of every channel is equal, whatever the tests' names."""
        return self is other or all(
            np.array_equal(getattr(self, one), getattr(other, one)) for one in ("outputs", "excitation")
        )


def _asked(table: Table, names: Sequence[str]) -> tuple[dict[str, Column], set[int]]:
    """The columns that are asked for by these `names`, and their places."""
    found, known = {name: table.find(name) for name in names}, table.names
    if None in found.values():
        missing = [name for name, column in found.items() if column is None]
        for name in missing:
            plain = [column.name for column in table.columns]
            if plain.count(name) > 1 or known.count(name) > 1:
                raise AbraceError(f"{table.source}: columns named twice: {name}; expected each name once")
        left_out = table.left_out and f" {table.left_out};"
        places = signals.positions(missing, known, f"{table.source}:{left_out} no column")
        found |= {name: table.columns[i] for name, i in zip(missing, places, strict=True)}
    columns = {name: column for name, column in found.items() if column is not None}
    return columns, {i for i, each in enumerate(table.columns) if any(each is column for column in columns.values())}


def _require_agreement(table: Table, given: float) -> None:
    """Refuse a sample period [s] that the file's own times contradict, although they were not asked for."""
    for column in [each for each in table.columns if each.is_time]:
        try:
            step, _ = table.sampling(column)
        except AbraceError:
            continue  # perhaps of something else
        known = column.unit or column.as_seconds.unit or step < LONGEST_STEP
        if known and abs(step / given - 1) > AGREES:
            times = f"the times {column.written} are of {1 / step:.6g} Hz"
            raise AbraceError(f"{table.source}: sample_rate {1 / given:g} Hz, but {times}; expected the same")
    stated = table.sample_period
    if stated and abs(stated / given - 1) > AGREES:
        raise AbraceError(f"{table.source}: sample_rate {1 / given:g} Hz, but the file states {1 / stated:.6g} Hz")


def _others(table: Table, asked: set[int]) -> dict[str, Column]:
    """The columns of numbers, but of times, that are not asked for, by their names without units where these differ."""
    others = [
        (i, column)
        for i, column in enumerate(table.columns)
        if not (i in asked or column.is_dates or (column.is_time and table.rises(column)))
    ]
    short = [column.name for column in table.columns]
    names = [column.name if short.count(column.name) == 1 and column.name else table.names[i] for i, column in others]
    once(names, table.source)
    return {name: column for name, (_, column) in zip(names, others, strict=True)}


def once(names: Sequence[str], source: Path | str) -> None:
    """Refuse that two columns of a `source` have one of these `names`."""
    twice = [name for name in dict.fromkeys(names) if list(names).count(name) > 1]
    if twice:
        raise AbraceError(f"{source}: columns named twice: {', '.join(twice)}; expected each name once")


AnyTest = Test | Run | Path | str
"""A test, a Run, or the folder of a bag, which may have several tests."""


class TableOptions(Options):
    """Options of a table of samples; a bag states them."""

    sample_rate: NonNegative = Field(default=0.0, description="Hz, of a table; 0: by its times, or its header")
    time: str = Field(
        default="",
        description="of a table: name of the column of times, in s unless it states ms, us; empty: none",
    )


def is_table(given: Any) -> bool:
    """Whether what was `given` has columns: a file that is no bag, a DataFrame, or arrays by name."""
    if isinstance(given, str | Path):
        return not Path(given).is_dir() and Path(given).suffix not in ("", ".mcap", ".db3")
    return hasattr(given, "keys")


def given_tests(given: Any, columns: Mapping[str, Any] | None = None) -> tuple[Test, ...]:
    """The tests that were `given`, one or several `AnyTest`.

    Parameters
    ----------
    given
    columns
        Arguments of `Test.from_arrays` with which files and tables that are no bags are read; None: these are refused.

    Raises
    ------
    AbraceError
        If there is none, or one is something else.
    """
    each = tuple(given) if isinstance(given, list | tuple) else (given,)
    if not each:
        raise AbraceError("no test given, expected at least one")
    found: list[Test] = []
    for one in each:
        is_path = isinstance(one, str | Path)
        if columns is not None and is_table(one):
            found.append(Test.read(one, **columns) if is_path else Test.from_arrays(one, **columns))
        elif is_path:
            found += [Test.of(run) for run in Bag(one).tests()]
        elif isinstance(one, Test | Run):
            found.append(one if isinstance(one, Test) else Test.of(one))
        else:
            raise AbraceError(f"test {one!r:.60}: expected a Test, a Run, or the folder of a bag")
    return tuple(found)


def of_one_rig(
    given: AnyTest | Sequence[AnyTest], alike: Sequence[Literal["inputs", "channels"]] = ("inputs", "channels")
) -> tuple[Test, ...]:
    """The tests that were `given`, one or several, all of one rig.

    Parameters
    ----------
    given
    alike
        Whether all have the same inputs, and the same channels (outputs).

    Raises
    ------
    AbraceError
        If there is none, or rigs, sample periods, units, or what is to be `alike`, differ.
    """
    tests = given_tests(given)
    first = tests[0]
    for other in tests[1:]:
        for what, one, two in (
            ("inputs", first.inputs, other.inputs if "inputs" in alike else first.inputs),
            ("channels", first.names, other.names if "channels" in alike else first.names),
            ("floors", first.floors, other.floors),
            ("brace groups", first.groups, other.groups),
            ("sample period", first.sample_period, other.sample_period),
            ("rig", first.facts.get("rig"), other.facts.get("rig")),
        ):
            if one != two and None not in (one, two):
                two, one = (", ".join(each) if isinstance(each, tuple) else each for each in (two, one))
                raise AbraceError(f"{other.source}: {what} {two}, expected {one}, as in {first.source}")
        for name, unit in first.units.items():
            theirs = other.units.get(name, unit)
            if theirs != unit and (unit_as_stated(theirs) is None or unit_as_stated(theirs) != unit_as_stated(unit)):
                raise AbraceError(f"{other.source}: {name} in {theirs}, expected {unit}, as in {first.source}")
    return tests
