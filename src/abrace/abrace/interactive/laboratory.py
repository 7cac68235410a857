# SPDX-License-Identifier: Apache-2.0
"""Rigs, records and recorded tests, by name or file; a rig measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace.interactive.given import rig_of, warn
from abrace_bags import read_run as run_in_bag
from abrace_core.response import clipped_sentences
from abrace_core.tables import data_frame
from abrace_plant.records.files import read_record
from abrace_plant.rig import characteristics
from abrace_plant.rig.characteristics_figure import characteristics_figure
from abrace_plant.rig.effects import effects

if TYPE_CHECKING:
    from pathlib import Path

    import pandas
    from matplotlib.figure import Figure

    from abrace.interactive.given import AnyRig
    from abrace_core.run import Run
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
        With the file, the keys and what was expected, or the known names.
    """
    return rig_of(rig)


def load_record(
    record: Path | str, unit: str | None = None, sample_period: float | None = None, channel: str | None = None
) -> Record:
    """Read a ground motion record, in m/s^2.

    Parameters
    ----------
    record
        A known name (`el_centro`, `loma_prieta`, `san_fernando`, `northridge_aftershock`), a file, or a bag.
    unit
        "g", "m/s^2" or "cm/s^2"; needed where the file does not state it.
    sample_period
        [s]; needed where the file has no times.
    channel
        Which of several: column, variable, number, or `topic:field` of a bag.

    Raises
    ------
    AbraceError
        With the file, the line and what was expected, or the known names.
    """
    return read_record(record, unit, sample_period, channel)


def read_run(bag: Path | str, topic: str | None = None) -> Run:
    """Read a recorded test from a bag; damage of the bag and clipped sensors are given as Python warnings.

    Parameters
    ----------
    bag
        The folder of the bag, or a single file.
    topic
        Of the responses; None: the only one.

    Raises
    ------
    AbraceError
        If there is no such bag or topic, or samples are missing or not finite.
    """
    run = run_in_bag(bag, topic)
    clipped = clipped_sentences(run.clipped_samples)
    warn([*run.facts.get("warnings", []), *(f"{run.source}: {sentence}" for sentence in clipped)])
    return run


@dataclass(frozen=True)
class Characterized:
    """A rig measured as the paper measured its building.

    Parameters
    ----------
    rig
        The rig.
    found
        Frequencies [rad/s], damping ratios, bench test, first mode.
    """

    rig: Rig
    found: Characteristics

    def __repr__(self) -> str:
        hertz = ", ".join(f"{frequency / (2 * np.pi):.3f}" for frequency, _ in self.found.zero_command)
        lags = ", ".join(f"{1e3 * brace.bench_lag:.2f}" for brace in self.found.braces)
        return f"<Characteristics of {self.rig.name}: {hertz} Hz with zero command, servo lag {lags} ms>"

    def to_pandas(self) -> pandas.DataFrame:
        """Pole pairs of the bare frame, with zero command, and further ones: [Hz], damping ratio."""
        kinds = {"bare": self.found.bare, "zero command": self.found.zero_command, "further": self.found.extra}
        rows = [(kind, *pair) for kind, pairs in kinds.items() for pair in pairs]
        names, frequency, damping = zip(*rows, strict=True)
        columns = {"frequency [Hz]": np.array(frequency) / (2 * np.pi), "damping ratio": np.array(damping)}
        return data_frame(columns, "poles", names)

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
