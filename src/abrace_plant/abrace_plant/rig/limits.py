# SPDX-License-Identifier: Apache-2.0
"""Limits of the interlocks of a rig: from its file, or else computed from the rig's other numbers.

No rig is without interlocks: one that the file does not name has a limit computed from the sensors' ranges, the
actuators' capacity and stroke, the storeys' height and the table. The terms are those of a servo-controller's limit
detectors: a value, a time for which it has to be exceeded, the action, and how it is reset.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError
from abrace_plant.rig.model import Interlock

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from abrace_plant.rig.model import Rig

TIMES = {
    "drift": 0.01,
    "displacement": 0.01,
    "velocity": 0.01,
    "stroke": 0.01,
    "acceleration": 0.01,
    "force": 0.01,
    "force_error": 0.02,
    "oscillation": 0.05,
    "table_displacement": 0.01,
    "table_velocity": 0.01,
    "implausible_acceleration": 0.05,
    "implausible_stroke": 0.05,
    "noisy": 0.01,
    "dead": 0.2,
    "stuck": 0.05,
    "clipped": 0.02,
}
"""Every interlock, and the time for which its value has to be exceeded unless the rig file says otherwise [s]."""
UNITS = {
    "drift": "m",
    "displacement": "m",
    "velocity": "m/s",
    "stroke": "m",
    "acceleration": "m/s^2",
    "force": "N",
    "force_error": "N",
    "oscillation": "N",
    "table_displacement": "m",
    "table_velocity": "m/s",
    "implausible_acceleration": "m/s^2",
    "implausible_stroke": "m",
    "noisy": "of the range",
    "dead": "times its noise",
}
"""Units of their values; `stuck` and `clipped` have none."""

YIELD_DRIFT = 0.0125
"""Drift over storey height up to which a steel moment frame is taken for elastic: it yields at 0.01 to 0.02."""
FORCES = ("force", "force_error", "oscillation")
"""Interlocks whose values hold for the strongest actuator; see `group_limits`."""
NOISE_MARGIN = 6.0
"""A value is at least so many standard deviations of its sensors' noise."""


def limit_table(rig: Rig, noise: Mapping[str, float]) -> dict[str, Interlock]:
    """Every interlock of a rig, in the order of `TIMES`: from its file, or computed from the rig's numbers.

    Parameters
    ----------
    rig
        The rig.
    noise
        Standard deviation of what each interlock watches, from the sensors' noise alone; of the noisiest channel.
    """
    values = _values(rig)

    def default(name: str) -> Interlock:
        return Interlock(max(values.get(name, 0.0), NOISE_MARGIN * noise.get(name, 0.0)), TIMES[name])

    return {name: rig.interlocks.get(name) or default(name) for name in TIMES}


def check_limits(rig: Rig, noise: Mapping[str, float]) -> None:
    """Refuse limits of the rig file that could never act, or that the sensors' noise alone would trip.

    `rig` and `noise` are as for `limit_table`.

    Raises
    ------
    AbraceError
        Naming the key, its value and what was expected.
    """
    sensors, table = rig.sensors, rig.table
    stops = min((group.actuator.stroke_limit for group in rig.braces), default=np.inf)
    capacity = max((group.actuator.capacity for group in rig.braces), default=np.inf)
    most = {
        "drift": (sensors.displacement.range, "the displacement sensors' range"),
        "displacement": (sensors.displacement.range, "the sensors' range"),
        "velocity": (sensors.displacement.range * 100, "the displacement sensors' range within 10 ms"),
        "stroke": min((sensors.stroke.range, "the sensors' range"), (stops, "the actuators' stroke_limit")),
        "acceleration": (sensors.acceleration.range, "the sensors' range"),
        "force": (sensors.force.range, "the sensors' range"),
        "force_error": (2 * capacity, "twice the capacity"),
        "oscillation": (capacity, "the capacity"),
        "table_displacement": (table.peak_displacement, "table.peak_displacement"),
        "table_velocity": (table.peak_velocity, "table.peak_velocity"),
        "implausible_acceleration": (sensors.acceleration.range, "the sensors' range"),
        "implausible_stroke": (sensors.stroke.range, "the sensors' range"),
        "noisy": (1.0, "the sensors' range"),
        "dead": (1.0, "the noise itself"),
    }
    for name, interlock in rig.interlocks.items():
        key, unit = f"interlocks.{name}.value: {interlock.value:g}", UNITS.get(name, "")
        if name in most and interlock.value >= most[name][0]:
            end, what = most[name]
            raise AbraceError(f"{key} {unit}, expected less than {end:g} {unit}, {what}")
        least = NOISE_MARGIN * noise.get(name, 0.0)
        if name in UNITS and interlock.value < least:
            raise AbraceError(
                f"{key} {unit}, expected {least:.3g} {unit} or more, {NOISE_MARGIN:g} times its standard "
                "deviation from the sensors' noise"
            )


def group_limits(rig: Rig, interlock: Interlock, noise: float) -> NDArray[np.float64]:
    """(groups,) value of an `interlock` of FORCES for the actuators of each group of a `rig` [N].

    The interlock has that of the strongest ones. `noise`: standard deviation from the load cells' noise alone [N].
    """
    capacities = np.array([group.actuator.capacity for group in rig.braces])
    return np.maximum(interlock.value * capacities / capacities.max(initial=0.0), NOISE_MARGIN * noise)


def cell_limits(rig: Rig, interlock: Interlock, noise: float) -> dict[str, float]:
    """By load cell, the `group_limits` of a `rig` for an `interlock` and `noise` [N]."""
    cells = rig.channel_names[2 * rig.floors + rig.groups : -1]
    limits = np.repeat(group_limits(rig, interlock, noise), rig.braces_in_group)
    return dict(zip(cells, limits.tolist(), strict=True))


def frequencies(rig: Rig) -> NDArray[np.float64]:
    """(floors,) of the building of a `rig` with its stiffeners [rad/s], undamped, slowest first."""
    stiffness = rig.building.stiffness.copy()
    for group in rig.braces:
        direction = group.direction(rig.floors)
        stiffness += group.connected * group.stiffener_stiffness * np.outer(direction, direction)
    return replace(rig.building, stiffness=stiffness).modes()[0]


def _values(rig: Rig) -> dict[str, float]:
    """The value of each interlock that follows from the rig's numbers."""
    sensors, table = rig.sensors, rig.table
    capacity = max((group.actuator.capacity for group in rig.braces), default=0.0)
    stops = min((group.actuator.stroke_limit for group in rig.braces), default=np.inf)
    displacement = 0.9 * sensors.displacement.range
    given = rig.interlocks.get("displacement")
    return {
        "drift": min(YIELD_DRIFT * float(rig.storey_heights.min()), displacement),
        "displacement": displacement,
        # the first mode's velocity at the greatest displacement, plus a quarter for the other modes
        "velocity": 1.25 * float(frequencies(rig)[0]) * (given.value if given else displacement),
        "stroke": 0.9 * min(sensors.stroke.range, stops),
        "acceleration": 0.95 * sensors.acceleration.range,
        # a command at the capacity is not a fault: a force above it comes from the stops, or from a faulty load cell
        "force": min(1.08 * capacity, 0.95 * sensors.force.range),
        "force_error": 0.25 * capacity,
        "oscillation": 0.25 * capacity,
        # those of a sinusoid of the table's greatest acceleration at 1 Hz, but not beyond what the table has
        "table_displacement": min(table.peak_acceleration / (2 * np.pi) ** 2, table.peak_displacement),
        "table_velocity": min(table.peak_acceleration / (2 * np.pi), table.peak_velocity),
        "implausible_acceleration": 0.05 * sensors.acceleration.range,
        "implausible_stroke": 0.05 * sensors.stroke.range,
        "noisy": 0.1,
        "dead": 0.25,
    }
