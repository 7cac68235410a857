# SPDX-License-Identifier: Apache-2.0
"""Rigs, records and recorded tests, by name or file; a rig measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace.interactive.given import rig_of, told_of, warn
from abrace_bags import read_run as run_in_bag
from abrace_core.model.tabular import Tabular
from abrace_plant.records.files import read_record
from abrace_plant.rig import characteristics
from abrace_plant.rig.characteristics_figure import characteristics_figure
from abrace_plant.rig.effects import effects

if TYPE_CHECKING:
    from pathlib import Path

    import pandas
    from matplotlib.figure import Figure

    from abrace.interactive.given import AnyRig
    from abrace_core.model.run import Run
    from abrace_plant.records.record import Record
    from abrace_plant.rig.characteristics import Characteristics
    from abrace_plant.rig.model import Rig


def load_rig(rig: AnyRig) -> Rig:
    """Read and check a rig file.

    Parameters
    ----------
    rig
        A file (.yaml), or the name of one of abrace's rigs: `ncree_three_storey`, `five_storey`, ...

    Raises
    ------
    AbraceError
        If the file is wrong: with its keys and what was expected; or with the known names.
    """
    return rig_of(rig)


def load_record(
    record: Path | str, unit: str | None = None, sample_period: float | None = None, channel: str | int | None = None
) -> Record:
    """Read a ground motion record, in m/s^2; a clock that was set during a bag's recording is a Python warning.

    Parameters
    ----------
    record
        A known name (`el_centro`, `loma_prieta`, `san_fernando`, `northridge_aftershock`), a file, or a bag.
    unit
        "g", "m/s^2", "cm/s^2", "mm/s^2", "mg" or "in/s^2"; needed where the file does not state it.
    sample_period
        [s]; needed where the file does not state it. It decides where times are rounded or have no unit.
    channel
        Which of several: name or number of a column, variable, channel; of a bag an acceleration, by default w.

    Raises
    ------
    AbraceError
        If the file is wrong: with its line and what was expected; or with the known names.
    """
    found = read_record(record, unit, sample_period, channel)
    warn(found.warnings)
    return found


def read_run(bag: Path | str, topic: str | None = None) -> Run:
    """Read a recorded test from a bag; damage of the bag, stops and clipped sensors are Python warnings.

    Parameters
    ----------
    bag
        The folder of the bag, or a single file.
    topic
        Topic of the responses; None: the only one.

    Raises
    ------
    AbraceError
        If there is no such bag or topic, or samples are missing or not finite.
    """
    run = run_in_bag(bag, topic)
    warn(told_of(run))
    return run


@dataclass(frozen=True)
class Characterized(Tabular):
    """A rig measured as the paper measured its building: frequencies [rad/s], damping, bench test, first mode."""

    rig: Rig
    found: Characteristics

    def __repr__(self) -> str:
        hertz = ", ".join(f"{frequency / (2 * np.pi):.3f}" for frequency, _ in self.found.zero_command)
        lags = ", ".join(f"{1e3 * brace.bench_lag:.2f}" for brace in self.found.braces)
        return f"<Characteristics of {self.rig.name}: {hertz} Hz with zero command, servo lag {lags} ms>"

    def to_pandas(self) -> pandas.DataFrame:
        """Pole pairs of the bare frame, with zero command, and further ones: [Hz], damping ratio."""
        import pandas

        kinds = {"bare": self.found.bare, "zero command": self.found.zero_command, "further": self.found.extra}
        rows = [(kind, *pair) for kind, pairs in kinds.items() for pair in pairs]
        names, frequency, damping = zip(*rows, strict=True)
        columns = {"frequency [Hz]": np.array(frequency) / (2 * np.pi), "damping ratio": np.array(damping)}
        return pandas.DataFrame(columns, index=pandas.Index(names, name="poles"))

    def plot(self) -> Figure:
        """Bench test, f/U in the building, poles and first mode."""
        return characteristics_figure(self.rig, self.found)


def characterize(rig: AnyRig) -> Characterized:
    """Measure a rig: frequencies, damping, bench test of the actuators, first mode.

    Parameters
    ----------
    rig
        A rig, its file or its name. What its linear model leaves out (friction, backlash) is given as a warning.
    """
    given = rig_of(rig)
    if left_out := effects(given):
        warn([f"rig {given.name}: the numbers of its linear model, which leaves out: {'; '.join(left_out)}"])
    return Characterized(given, characteristics.characterize(given))
