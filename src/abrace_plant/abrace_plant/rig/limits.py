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

from abrace_core import AbraceError
from abrace_core.model import signals
from abrace_plant.rig.model import Interlock

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from abrace_plant.rig.model import Rig

INTERLOCKS = {
    "drift": (0.01, "m"),
    "displacement": (0.01, "m"),
    "velocity": (0.01, "m/s"),
    "stroke": (0.01, "m"),
    "acceleration": (0.01, "m/s^2"),
    "force": (0.01, "N"),
    "force_error": (0.02, "N"),
    "oscillation": (0.05, "N"),
    "table_displacement": (0.01, "m"),
    "table_velocity": (0.01, "m/s"),
    "implausible_acceleration": (0.05, "m/s^2"),
    "implausible_stroke": (0.05, "m"),
    "noisy": (0.01, "of the range"),
    "dead": (0.2, "times its noise"),
    "stuck": (0.05, ""),
    "clipped": (0.02, ""),
}
"""Every interlock: the time for which its value has to be exceeded unless the rig file says otherwise [s], and the
value's unit; `stuck` and `clipped` have no value."""

YIELD_DRIFT = 0.0125
"""Drift over storey height up to which a steel moment frame is taken for elastic: it yields at 0.01 to 0.02."""
FORCES = ("force", "force_error", "oscillation")
"""Interlocks whose values hold for the strongest actuator; see `group_limits`."""
NOISE_MARGIN = 6.0
"""A value is at least so many standard deviations of its sensors' noise."""


def limit_table(rig: Rig, noise: Mapping[str, float]) -> dict[str, Interlock]:
    """Every interlock of a rig, in the order of `INTERLOCKS`: from its file, or computed from the rig's numbers.

    Parameters
    ----------
    rig
        The rig.
    noise
        Standard deviation of what each interlock watches, from the sensors' noise alone; of the noisiest channel. An
        interlock that has none because a sensor is missing is left out.
    """
    found = {}
    computed = _values(rig)
    for name, (time, unit) in INTERLOCKS.items():
        if rig.not_measured and unit and name != "dead" and name not in noise:
            continue
        value = max(computed[name][0] if unit else 0.0, NOISE_MARGIN * noise.get(name, 0.0))
        found[name] = rig.interlocks.get(name) or Interlock(value, time)
    return found


def check_limits(rig: Rig, noise: Mapping[str, float]) -> None:
    """Refuse limits of the rig file that could never act, or that the sensors' noise alone would trip.

    `rig` and `noise` are as for `limit_table`.

    Raises
    ------
    AbraceError
        Naming the key, its value and what was expected.
    """
    computed = _values(rig)
    for name, interlock in rig.interlocks.items():
        _, unit = INTERLOCKS[name]
        if not unit or name not in computed:
            continue
        _, most, what = computed[name]
        key, least = f"interlocks.{name}.value: {interlock.value:g} {unit}", NOISE_MARGIN * noise.get(name, 0.0)
        if interlock.value >= most:
            raise AbraceError(f"{key}, expected less than {most:g} {unit}, {what}")
        if interlock.value < least:
            raise AbraceError(
                f"{key}, expected {least:.3g} {unit} or more, {NOISE_MARGIN:g} times its standard deviation from the "
                "sensors' noise"
            )


def group_limits(rig: Rig, interlock: Interlock, noise: float) -> NDArray[np.float64]:
    """(groups,) value of an `interlock` of FORCES for the actuators of each group of a `rig` [N].

    The interlock has that of the strongest ones. `noise`: standard deviation from the load cells' noise alone [N].
    """
    capacities = np.array([group.actuator.capacity for group in rig.braces])
    return np.maximum(interlock.value * capacities / capacities.max(initial=0.0), NOISE_MARGIN * noise)


def cell_limits(rig: Rig, interlock: Interlock, noise: float) -> dict[str, float]:
    """By load cell, the `group_limits` of a `rig` for an `interlock` and `noise` [N]."""
    cells = signals.load_cell_names(rig.braces_in_group)
    limits = np.repeat(group_limits(rig, interlock, noise), rig.braces_in_group)
    return {name: limit for name, limit in zip(cells, limits.tolist(), strict=True) if name in rig.channel_names}


def frequencies(rig: Rig) -> NDArray[np.float64]:
    """(floors,) of the building of a `rig` with its stiffeners [rad/s], undamped, slowest first."""
    stiffness = rig.building.stiffness.copy()
    for group in rig.braces:
        direction = group.direction(rig.floors)
        stiffness += group.connected * group.stiffener_stiffness * np.outer(direction, direction)
    return replace(rig.building, stiffness=stiffness).modes()[0]


def _values(rig: Rig) -> dict[str, tuple[float, float, str]]:
    """Of each interlock with a value: that computed of the rig's numbers; the least that could never act, and why.

    Those of sensors that the rig does not have are left out.
    """
    sensors, table = rig.sensors, rig.table
    capacity = max((group.actuator.capacity for group in rig.braces), default=0.0)
    stops = min((group.actuator.stroke_limit for group in rig.braces), default=np.inf)
    most_force = capacity or np.inf
    # those of a sinusoid of the table's greatest acceleration at 1 Hz, but not beyond what the table has
    path = min(table.peak_acceleration / (2 * np.pi) ** 2, table.peak_displacement)
    speed = min(table.peak_acceleration / (2 * np.pi), table.peak_velocity)
    of_range = "the sensors' range"
    found = {
        "table_displacement": (path, table.peak_displacement, "table.peak_displacement"),
        "table_velocity": (speed, table.peak_velocity, "table.peak_velocity"),
        "noisy": (0.1, 1.0, of_range),
        "dead": (0.25, 1.0, "the noise itself"),
    }
    if sensors.displacement:
        end = sensors.displacement.range
        displacement = 0.9 * end
        drift = min(YIELD_DRIFT * float(rig.storey_heights.min()), displacement)
        given = rig.interlocks.get("displacement")
        # the first mode's velocity at the greatest displacement, plus a quarter for the other modes
        velocity = 1.25 * float(frequencies(rig)[0]) * (given.value if given else displacement)
        found["drift"] = drift, end, "the displacement sensors' range"
        found["displacement"] = displacement, end, of_range
        found["velocity"] = velocity, end * 100, "the displacement sensors' range within 10 ms"
    if sensors.stroke:
        stroke = min((sensors.stroke.range, of_range), (stops, "the actuators' stroke_limit"))
        found["stroke"] = 0.9 * stroke[0], *stroke
        found["implausible_stroke"] = 0.05 * sensors.stroke.range, sensors.stroke.range, of_range
    if sensors.acceleration:
        most = sensors.acceleration.range
        found["acceleration"] = 0.95 * most, most, of_range
        found["implausible_acceleration"] = 0.05 * most, most, of_range
    if sensors.force:
        # a command at the capacity is not a fault: a force above it comes from the stops, or from a faulty load cell
        found["force"] = min(1.08 * capacity, 0.95 * sensors.force.range), sensors.force.range, of_range
        found["force_error"] = 0.25 * capacity, 2 * most_force, "twice the capacity"
        found["oscillation"] = 0.25 * capacity, most_force, "the capacity"
    return found
