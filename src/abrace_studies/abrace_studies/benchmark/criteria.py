# SPDX-License-Identifier: Apache-2.0
"""The evaluation criteria of the structural-control benchmarks, of responses as arrays.

Those of Ohtori, Christenson, Spencer and Dyke (J. Eng. Mech. 130(4), 2004, 366-385) for a structure that stays elastic:
J1 to J7 and J10 compare the responses with those without control, J11 to J14 state what the devices need, J15 to J17
count devices, sensors and states. J8 and J9 are of yielded members, which an elastic structure has not. Norms are root
mean squares over the whole test.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

GRAVITY = 9.81
"""As the benchmark takes it for the weight [m/s^2]."""

MEANINGS = {
    "J1": "greatest drift ratio",
    "J2": "greatest acceleration",
    "J3": "greatest base shear",
    "J4": "rms drift ratio",
    "J5": "rms acceleration",
    "J6": "rms base shear",
    "J7": "greatest curvature over yield",
    "J10": "rms curvature over yield",
    "J11": "greatest force of a device over weight",
    "J12": "greatest stroke over displacement",
    "J13": "greatest power of all devices",
    "J14": "mean power of all devices",
    "J15": "devices",
    "J16": "sensors",
    "J17": "states of the controller",
}
"""Meaning of each criterion."""

OF_RESPONSE = ("J1", "J2", "J3", "J4", "J5", "J6")


@dataclass(frozen=True)
class Layout:
    """What the criteria need to know of a building and its devices.

    Parameters
    ----------
    masses, heights
        (levels,) [kg], and of the storeys below the levels [m]; the lowest first.
    storeys
        (commands,) the storey that each command's devices stand in, 1 the lowest.
    counts
        (commands,) how many equal devices have the command.
    cosines
        (commands,) stroke of a device for each metre of drift.
    """

    masses: NDArray[np.float64]
    heights: NDArray[np.float64]
    storeys: tuple[int, ...]
    counts: tuple[int, ...]
    cosines: tuple[float, ...]

    @property
    def weight(self) -> float:
        """[N]."""
        return GRAVITY * float(self.masses.sum())


@dataclass(frozen=True)
class Responses:
    """What a test gave, sample by sample from rest.

    Parameters
    ----------
    period
        Between samples [s].
    displacement, velocity
        (samples, levels) relative to the ground [m], [m/s].
    acceleration
        (samples, levels) absolute [m/s^2].
    force
        (samples, commands) of one device [N].
    curvature
        (samples, ends) at the members' ends over that at which they yield; None: not known.
    """

    period: float
    displacement: NDArray[np.float64]
    velocity: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    force: NDArray[np.float64]
    curvature: NDArray[np.float64] | None = None


def storey_quantities(levels: NDArray[np.float64]) -> NDArray[np.float64]:
    """(samples, storeys) differences between a quantity of `levels` (samples, levels) and that of the level below."""
    return np.diff(levels, axis=1, prepend=0.0)


def peaks(found: Responses, layout: Layout) -> dict[str, float]:
    """What the criteria are ratios of, by name, `found` on a building with this `layout`.

    Those of a test without control are what others are divided by. Drift ratios `d_max` and `d_max_norm`, accelerations
    `xdd_max` and `xdd_max_norm` [m/s^2], base shears `F_max` and `F_max_norm` [N], `x_max` [m] and `xd_max` [m/s] of
    any level, and where it is known curvature over yield `phi_max` and `phi_max_norm`.

    Raises
    ------
    AbraceError
        If the responses do not have the layout's levels.
    """
    levels = len(layout.masses)
    for name in ("displacement", "velocity", "acceleration"):
        shape = getattr(found, name).shape
        if len(shape) != 2 or shape[1] != levels or shape[0] < 2:
            raise AbraceError(f"criteria: {name} of shape {shape}, expected (samples, {levels})")
    duration = (len(found.displacement) - 1) * found.period

    def norm(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.sqrt((values**2).sum(axis=0) * found.period / duration)

    drift = storey_quantities(found.displacement) / layout.heights
    shear = found.acceleration @ layout.masses
    values = {
        "d_max": np.abs(drift).max(),
        "xdd_max": np.abs(found.acceleration).max(),
        "F_max": np.abs(shear).max(),
        "d_max_norm": norm(drift).max(),
        "xdd_max_norm": norm(found.acceleration).max(),
        "F_max_norm": norm(shear),
        "x_max": np.abs(found.displacement).max(),
        "xd_max": np.abs(found.velocity).max(),
    }
    if found.curvature is not None:
        values["phi_max"] = np.abs(found.curvature).max()
        # over the samples, not over the duration: so is the benchmark's own value
        values["phi_max_norm"] = np.sqrt((found.curvature**2).mean(axis=0)).max()
    return {name: float(value) for name, value in values.items()}


RATIOS = {
    "J1": "d_max",
    "J2": "xdd_max",
    "J3": "F_max",
    "J4": "d_max_norm",
    "J5": "xdd_max_norm",
    "J6": "F_max_norm",
    "J7": "phi_max",
    "J10": "phi_max_norm",
}
"""Criteria that are ratios of a quantity of `peaks` with and without control."""


def criteria(
    found: Responses, layout: Layout, uncontrolled: Mapping[str, float], sensors: int = 0, states: int = 0
) -> dict[str, float]:
    """J1 to J7 and J10 to J17, as far as they are known.

    Parameters
    ----------
    found
        The responses with control.
    layout
        Layout of the building and its devices.
    uncontrolled
        `peaks` without control, under the same motion of the ground; J7 and J10 need its `phi_max`.
    sensors, states
        Numbers of sensors and states of the controller, J16 and J17; 0: not known, they are left out.

    Raises
    ------
    AbraceError
        If the responses do not fit the layout, or there are none without control.
    """
    still = [name for name, value in uncontrolled.items() if not value > 0]
    if still:
        raise AbraceError(f"criteria: {still[0]} without control is 0, expected a ground that moves")
    reached = peaks(found, layout)
    values = {
        name: reached[quantity] / uncontrolled[quantity]
        for name, quantity in RATIOS.items()
        if quantity in reached and quantity in uncontrolled
    }
    return values | _of_devices(found, layout, uncontrolled) | _counts(layout, sensors, states)


def _of_devices(found: Responses, layout: Layout, uncontrolled: Mapping[str, float]) -> dict[str, float]:
    storeys = np.array(layout.storeys, dtype=np.intp) - 1
    shape = (len(found.displacement), len(storeys))
    stroke, rate = (
        storey_quantities(levels)[:, storeys] * layout.cosines for levels in (found.displacement, found.velocity)
    )
    if found.force.shape != shape:
        raise AbraceError(f"criteria: force of shape {found.force.shape}, expected (samples, {len(storeys)})")
    if not len(storeys):
        return {}
    power = np.abs(rate * found.force) @ np.array(layout.counts, dtype=np.float64)
    duration = (len(power) - 1) * found.period
    unit = uncontrolled["xd_max"] * layout.weight
    return {
        "J11": float(np.abs(found.force).max() / layout.weight),
        "J12": float(np.abs(stroke).max() / uncontrolled["x_max"]),
        "J13": float(power.max() / unit),
        "J14": float(power.sum() * found.period / duration / unit),
    }


def _counts(layout: Layout, sensors: int, states: int) -> dict[str, float]:
    counts = {"J15": sum(layout.counts), "J16": sensors, "J17": states}
    return {name: float(value) for name, value in counts.items() if value}
