# SPDX-License-Identifier: Apache-2.0
"""Text for the effects of a rig that its linear model and exact sensors do not contain."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from abrace_plant.rig.model import Rig


def effects(rig: Rig) -> list[str]:
    """The effects that the linear model of a `rig` leaves out, with their amounts; none: it is exact."""
    found = []
    building, table = rig.building, rig.table_dynamics
    if any(building.friction):
        found.append(f"friction of {', '.join(f'{limit:g}' for limit in building.friction)} N in the storeys")
    for spring in building.hysteresis:
        found.append(f"storey {spring.storey} yields at {spring.stiffness * spring.yield_drift:g} N")
    for number, group in enumerate(rig.braces, 1):
        actuator, braces = group.actuator, f"brace group {number}"
        if actuator.friction:
            found.append(f"{braces}: {actuator.friction:g} N of friction in the seals")
        if group.backlash:
            found.append(f"{braces}: {1e3 * group.backlash:g} mm of backlash in the pins")
        if actuator.deadband:
            found.append(f"{braces}: a valve with a deadband of {actuator.deadband:g} N")
        if np.isfinite(actuator.stall_force):
            found.append(f"{braces}: a valve whose flow ends at {actuator.stall_force:g} N")
    if table is not None:
        found.append(f"a table of {table.mass:g} kg on oil columns of {table.frequency:g} rad/s")
    sensors = rig.sensors
    if sensors.anti_alias is not None:
        found.append(f"anti-alias filters of {sensors.anti_alias.cutoff:g} Hz")
    if any(np.isfinite(sensor.bandwidth) for sensor in rig.channel_sensors):
        found.append("transducers of finite bandwidth")
    if sensors.cross_axis and any(any(mode.transverse_share) for mode in rig.local_modes):
        found.append(f"accelerometers with {100 * sensors.cross_axis:g} % of cross-axis sensitivity")
    return found
