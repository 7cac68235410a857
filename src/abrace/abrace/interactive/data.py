# SPDX-License-Identifier: Apache-2.0
"""Any structure's measured inputs and outputs to a model; an ambient test to modes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace.interactive.given import band_of, runs_of, several, warn
from abrace.interactive.identification import pole_intervals
from abrace_core.errors import AbraceError
from abrace_core.one_thread import one_thread
from abrace_sysid import data_identification
from abrace_sysid.ambient.recorded import ambient_test
from abrace_sysid.data_identification import DataOptions
from abrace_sysid.figures.ambient import ambient_stabilization
from abrace_sysid.figures.data import figures_of_data
from abrace_sysid.measured_data import MeasuredData, read_data

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    import pandas
    from matplotlib.figure import Figure
    from numpy.typing import ArrayLike

    from abrace.interactive.given import AnyRun
    from abrace_core.linear_model import LinearModel
    from abrace_sysid.ambient.modes import AmbientTest
    from abrace_sysid.data_identification import DataIdentification
    from abrace_sysid.measured_data import DataHold


@dataclass(frozen=True)
class IdentifiedData:
    """The model of a structure from measured data.

    Parameters
    ----------
    found
        The whole identification.
    """

    found: DataIdentification

    def __repr__(self) -> str:
        low, high = self.found.band
        return f"<Identified: {len(self.found.pairs)} modes, {low:.3g} to {high:.3g} Hz, from {self.found.data.source}>"

    @property
    def model(self) -> LinearModel:
        """The continuous model."""
        return self.found.model

    def to_pandas(self) -> pandas.DataFrame:
        """The modes, slowest first, with 95 % confidence intervals."""
        return pole_intervals(self.found.pairs)

    def plot(self, what: str | None = None) -> Figure:
        """A figure.

        Parameters
        ----------
        what
            `transfer_functions_NAME` of an input, "residuals" or "confidence"; None: the first input's.

        Raises
        ------
        AbraceError
            If it is none of these.
        """
        drawn = figures_of_data(self.found)
        chosen = what or next(iter(drawn))
        if chosen not in drawn:
            raise AbraceError(f"figure {chosen!r} of an identification: expected one of {', '.join(drawn)}")
        return drawn[chosen]


@one_thread()
def identify_data(
    data: MeasuredData | Mapping[str, ArrayLike] | pandas.DataFrame | Path | str,
    inputs: Sequence[str] = (),
    outputs: Sequence[str] = (),
    *,
    sample_rate: float = 0.0,
    time: str = "",
    units: Mapping[str, str] | None = None,
    hold: DataHold = "band",
    band: tuple[float, float] | None = None,
) -> IdentifiedData:
    """Identify any structure from measured inputs and outputs.

    Parameters
    ----------
    data
        A file (.mat, .npz, .npy, .csv), a DataFrame or arrays by name.
    inputs, outputs
        Names of columns; no outputs: all others.
    sample_rate
        [Hz]; 0: from the column `time`.
    time
        Name of a column of times [s].
    units
        By column, for figures.
    hold
        "band": inputs and outputs sampled alike, below half the sample rate; "zero": inputs held between samples.
    band
        [Hz] that is used; None: from 10 / duration to half the sample rate.

    Raises
    ------
    AbraceError
        If the data cannot be used, with all columns that are missing.
    """
    columns = several(inputs), several(outputs)
    given = data if isinstance(data, MeasuredData) else read_data(data, *columns, sample_rate, time, units, hold)
    found = data_identification.identify_data(given, DataOptions(band=None if band is None else band_of(band)))
    warn(found.warnings)
    return IdentifiedData(found)


@dataclass(frozen=True)
class IdentifiedModes:
    """The modes of a building from an ambient test.

    Parameters
    ----------
    found
        Modes with shapes, and what the stabilisation diagram shows.
    """

    found: AmbientTest

    def __repr__(self) -> str:
        hertz = ", ".join(f"{mode.frequency / (2 * np.pi):.3f}" for mode in self.found.modes)
        return f"<Modes: {hertz} Hz, from {self.found.seconds:g} s of {', '.join(self.found.channels)}>"

    def to_pandas(self) -> pandas.DataFrame:
        """The modes, slowest first, with 95 % confidence intervals."""
        return pole_intervals([mode.interval for mode in self.found.modes])

    def plot(self) -> Figure:
        """The stabilisation diagram."""
        return ambient_stabilization(self.found)


@one_thread()
def identify_ambient(
    tests: AnyRun | Sequence[AnyRun],
    channels: Sequence[str] = (),
    *,
    band: tuple[float, float] | None = None,
    highest_order: int = 40,
) -> IdentifiedModes:
    """Find a building's modes from tests without commands, whatever moves the table.

    Parameters
    ----------
    tests
        Runs or bags, one or several of one state of the building.
    channels
        Outputs to use; none: all accelerations.
    band
        [Hz] of the modes; None: from 0.3 to 20 times the slowest resonance.
    highest_order
        Poles that are tried at most.

    Raises
    ------
    AbraceError
        If there is a command, the tests are too short, or no band is given and no resonance found.
    """
    found, warnings = ambient_test(runs_of(tests), several(channels), band_of(band), highest_order)
    warn(warnings)
    return IdentifiedModes(found)
