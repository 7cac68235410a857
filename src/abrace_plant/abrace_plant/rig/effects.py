# SPDX-License-Identifier: Apache-2.0
"""Text for the effects of a rig that its linear model and exact sensors do not contain."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from abrace_plant.rig.model import Rig


def effects(rig: Rig) -> list[str]:
    """The effects that the linear model of a `rig` leaves out, with their amounts; none: it is exact."""
    return list(_effects(rig))


def _effects(rig: Rig) -> Iterator[str]:
    building, table = rig.building, rig.table_dynamics
    if any(building.friction):
        yield f"friction of {', '.join(f'{limit:g}' for limit in building.friction)} N in the storeys"
    for spring in building.hysteresis:
        yield f"storey {spring.storey} yields at {spring.stiffness * spring.yield_drift:g} N"
    for number, group in enumerate(rig.braces, 1):
        actuator, braces = group.actuator, f"brace group {number}"
        if actuator.friction:
            yield f"{braces}: {actuator.friction:g} N of friction in the seals"
        if group.backlash:
            yield f"{braces}: {1e3 * group.backlash:g} mm of backlash in the pins"
        if actuator.deadband:
            yield f"{braces}: a valve with a deadband of {actuator.deadband:g} N"
        if np.isfinite(actuator.stall_force):
            yield f"{braces}: a valve whose flow ends at {actuator.stall_force:g} N"
    if table is not None:
        yield f"a table of {table.mass:g} kg on oil columns of {table.frequency:g} rad/s"
    sensors = rig.sensors
    if sensors.anti_alias is not None:
        yield f"anti-alias filters of {sensors.anti_alias.cutoff:g} Hz"
    kinds = sensors.displacement, sensors.stroke, sensors.acceleration, sensors.force, sensors.ground_acceleration
    if any(np.isfinite(sensor.bandwidth) for sensor in kinds):
        yield "transducers of finite bandwidth"
    if sensors.cross_axis and any(any(mode.transverse_share) for mode in rig.local_modes):
        yield f"accelerometers with {100 * sensors.cross_axis:g} % of cross-axis sensitivity"
