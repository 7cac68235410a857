# SPDX-License-Identifier: Apache-2.0
"""The motion of a table that plays an acceleration, and the check against the table's limits.

The acceleration is linear between samples, as the simulated rig takes it, and zero before the first and after the last.
Velocity and displacement are its exact integrals from rest. The commanded motion is not corrected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError
from abrace_plant.records.intensity import integrate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.safety.table_stop import Table

REST = 1e-4
"""Share of the table's velocity limit that may be left at the end of a motion: 0.1 mm/s of 1 m/s."""
ROUNDING = 1e-9
"""Relative error by which a limit may be exceeded."""

RECORD_REMEDIES = {
    "acceleration": "a smaller peak_acceleration",
    "jerk": "a smaller peak_acceleration, or a lower band_limit",
    "velocity": "a smaller peak_acceleration, a low_cut or a shorter time_scale",
    "displacement": "a low_cut (with a taper), a baseline, a smaller peak_acceleration or a shorter time_scale",
    "velocity at the end": "a low_cut (with a taper) or a baseline",
}
"""Remedies for a record that exceeds a limit, by the limit."""
SIGNAL_REMEDIES = {
    "acceleration": "a smaller rms",
    "jerk": "a smaller rms, or a band that ends lower",
    "velocity": "a smaller rms, or a band that begins higher",
    "displacement": "a band that begins higher, or a smaller rms",
    "velocity at the end": "a longer duration",
}
"""The same for white noise and multisines."""


@dataclass(frozen=True)
class Demand:
    """The demand of a motion on a table for one quantity.

    Parameters
    ----------
    name, unit
        Of the quantity: "acceleration", "jerk", "velocity", "displacement" or "velocity at the end".
    value
        Greatest absolute value.
    time
        When it is reached, from the first sample on [s].
    limit
        The table's.
    """

    name: str
    unit: str
    value: float
    time: float
    limit: float

    @property
    def exceeded(self) -> bool:
        """Whether the demand exceeds the table's limit."""
        return not self.value <= self.limit * (1 + ROUNDING)

    def __str__(self) -> str:
        return f"{self.name} {self.value:.4g} {self.unit} at {self.time:.3f} s, the table's limit is {self.limit:.4g}"


@dataclass(frozen=True)
class TableMotion:
    """The motion of a table, from a sample before the first of an acceleration to one after its last.

    Parameters
    ----------
    sample_period
        [s].
    acceleration, velocity, displacement
        (samples + 2,) each [m/s^2, m/s, m].
    """

    sample_period: float
    acceleration: NDArray[np.float64]
    velocity: NDArray[np.float64]
    displacement: NDArray[np.float64]

    def demands(self, table: Table) -> list[Demand]:
        """The demands of the motion on a table, with the table's limits."""
        jerk = np.diff(self.acceleration) / self.sample_period
        found = [
            self._peak("acceleration", "m/s^2", self.acceleration, table.peak_acceleration),
            self._peak("jerk", "m/s^3", jerk, table.peak_jerk),
            self._peak("velocity", "m/s", self.velocity, table.peak_velocity),
            self._peak("displacement", "m", self.displacement, table.peak_displacement),
        ]
        left, end = abs(float(self.velocity[-1])), (len(self.velocity) - 2) * self.sample_period
        return [*found, Demand("velocity at the end", "m/s", left, end, REST * table.peak_velocity)]

    def _peak(self, name: str, unit: str, values: NDArray[np.float64], limit: float) -> Demand:
        peak = int(np.argmax(np.abs(values)))
        return Demand(name, unit, abs(float(values[peak])), max(0, peak - 1) * self.sample_period, limit)


def table_motion(acceleration: NDArray[np.float64], sample_rate: float, displacement: float = 0.0) -> TableMotion:
    """The motion of a table.

    Parameters
    ----------
    acceleration
        (samples,) [m/s^2].
    sample_rate
        [Hz].
    displacement
        Where the table rests before [m].
    """
    period = 1 / sample_rate
    whole = np.concatenate([[0.0], acceleration, [0.0]])
    velocity, path = integrate(whole, period)
    return TableMotion(period, whole, velocity, displacement + path)


def check_motion(
    acceleration: NDArray[np.float64],
    sample_rate: float,
    table: Table,
    name: str,
    remedies: dict[str, str],
    displacement: float = 0.0,
) -> None:
    """Refuse a motion that exceeds a table's limits.

    Parameters
    ----------
    acceleration
        (samples,) [m/s^2].
    sample_rate
        [Hz].
    table
        Its limits.
    name
        Of the motion, for the message.
    remedies
        `RECORD_REMEDIES` or `SIGNAL_REMEDIES`.
    displacement
        Where the table rests before [m].

    Raises
    ------
    AbraceError
        In one line: each quantity beyond its limit, its value, when it is reached, the limit, and what to do.
    """
    demands = table_motion(acceleration, sample_rate, displacement).demands(table)
    beyond = [demand for demand in demands if demand.exceeded]
    if beyond:
        excess = "; ".join(f"{demand}, expected {remedies[demand.name]}" for demand in beyond)
        share = min(demand.limit / demand.value for demand in beyond)
        # only if the table starts in the middle: otherwise the displacement does not scale
        fits = (
            f"; scaled by {math.floor(999 * share) / 1000:g} it would fit" if share > 0.002 and not displacement else ""
        )
        raise AbraceError(f"ground motion {name} exceeds the table's limits: {excess}{fits}")
