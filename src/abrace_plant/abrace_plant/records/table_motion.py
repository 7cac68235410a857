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

from abrace_core import AbraceError
from abrace_plant.records.measures import integrate

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


def table_demands(
    acceleration: NDArray[np.float64], sample_rate: float, table: Table, displacement: float = 0.0
) -> list[Demand]:
    """The demands of a motion on a table, with the table's limits.

    Parameters
    ----------
    acceleration
        (samples,) [m/s^2].
    sample_rate
        [Hz].
    table
        Its limits.
    displacement
        Where the table rests before [m].
    """
    period = 1 / sample_rate
    whole = np.concatenate([[0.0], acceleration, [0.0]])
    velocity, path = integrate(whole, period)
    found = []
    for name, unit, values, limit in (
        ("acceleration", "m/s^2", whole, table.peak_acceleration),
        ("jerk", "m/s^3", np.diff(whole) / period, table.peak_jerk),
        ("velocity", "m/s", velocity, table.peak_velocity),
        ("displacement", "m", displacement + path, table.peak_displacement),
    ):
        peak = int(np.argmax(np.abs(values)))
        found.append(Demand(name, unit, abs(float(values[peak])), max(0, peak - 1) * period, limit))
    left, end = abs(float(velocity[-1])), len(acceleration) * period
    return [*found, Demand("velocity at the end", "m/s", left, end, REST * table.peak_velocity)]


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
    demands = table_demands(acceleration, sample_rate, table, displacement)
    beyond = [demand for demand in demands if demand.exceeded]
    if beyond:
        excess = "; ".join(f"{demand}, expected {remedies[demand.name]}" for demand in beyond)
        share = min(demand.limit / demand.value for demand in beyond)
        # only if the table starts in the middle: otherwise the displacement does not scale
        fits = (
            f"; scaled by {math.floor(999 * share) / 1000:g} it would fit" if share > 0.002 and not displacement else ""
        )
        raise AbraceError(f"ground motion {name} exceeds the table's limits: {excess}{fits}")
