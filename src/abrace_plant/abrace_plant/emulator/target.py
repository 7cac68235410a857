# SPDX-License-Identifier: Apache-2.0
"""An emulated target: the simulated rig with its own tick behind the C99 target, which guards its outputs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace_plant.devices.c_target import ARMED, DISARMED, CTarget
from abrace_plant.rig.motion import RigMotion
from abrace_plant.rig.sensors import Measurement, parse_fault

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_plant.devices.device import Wanted
    from abrace_plant.rig.model import Rig

LIFE_TIME = 0.05
"""Seconds without a new command, or with ticks missed, after which the target stops, where nothing else is said."""
RAMP_TIME = 0.1
"""Seconds in which it then brings the force to zero, along half a cosine."""


class Target:
    """The rig, its sensors, and the guard of its outputs; `step` is one tick.

    Parameters
    ----------
    rig
        The rig.
    seed
        Of the sensors' noise.
    life_time
        Seconds without a new command, or with ticks missed, after which it stops.

    Attributes
    ----------
    tick
        Number of the last tick.
    outputs
        What guards the outputs.
    displacement
        Of the table [m], as a sensor of its own measures it.
    stops
        Times that the target brought itself to rest.
    worst_step
        Greatest change of a brace's force from one tick to the next, commanded to the armed target or made by it [N].
    worst_step_over_rate_limit
        The same over what the rate limit allows in a tick.
    worst_table_step
        Likewise of the table's acceleration [m/s^2].
    worst_force
        Greatest force that reached the actuators [N].
    worst_command
        Greatest command that was received, of force or table, over the greatest that the rig has, before it is limited
        to that; infinite: one that was not finite.
    worst_seconds_to_zero
        Longest time from the last command that was followed to zero force, of all stops.
    """

    def __init__(self, rig: Rig, seed: int, life_time: float = LIFE_TIME) -> None:
        self.period = 1 / rig.sample_rate
        self._motion = RigMotion(rig)
        self._measurement = Measurement(rig.channel_sensors, seed, self.period)
        self._channels = rig.channel_names
        self._most = np.append(rig.capacity, rig.table.peak_acceleration)
        self._rate_limit = rig.rate_limit
        self._measured_outputs = rig.measured_outputs
        self._true = np.zeros(len(rig.channel_names))
        self.outputs = CTarget(rig, life_time, RAMP_TIME)
        self._missed = 0
        self._heard = 0
        self._armed = False
        self._ground, self._velocity, self.displacement = 0.0, 0.0, 0.0
        self.tick = -1
        self.stops = 0
        self.worst_step = self.worst_step_over_rate_limit = self.worst_table_step = self.worst_force = 0.0
        self.worst_seconds_to_zero = self.worst_command = 0.0

    def command(self, counter: int, values: NDArray[np.float64], arm: int, wanted: Wanted | int) -> str:
        """Take a command, as `CTarget` does; returns why it is not obeyed, or nothing."""
        share = float(np.nan_to_num(np.abs(values) / self._most[: len(values)], nan=np.inf, posinf=np.inf).max())
        self.worst_command = max(self.worst_command, share)
        outcome = self.outputs.command(counter, values.tolist(), arm, wanted)
        if not outcome and self.outputs.state == ARMED:
            self._heard = self.tick
        return outcome

    def set_sensor_faults(self, texts: Sequence[str]) -> None:
        """Let channels fail as the `texts` say, each as for `parse_fault`, and no others.

        Raises
        ------
        AbraceError
            As in `parse_fault`.
        """
        self._measurement.faults = tuple(parse_fault(text, self._channels, self.period) for text in texts)

    def hold(self, ticks: int) -> None:
        """Step the rig for `ticks` that the target misses: its outputs are held, without any check."""
        self._missed += ticks
        for _ in range(ticks):
            self.tick += 1
            self._move()

    def step(self) -> NDArray[np.float64]:
        """The readings (channels,) at the next tick, in SI units."""
        self.tick += 1
        outputs = self.outputs
        before = outputs.applied
        outputs.tick(1 + self._missed)
        self._missed = 0
        applied = outputs.applied
        self.stops += self._armed and outputs.state != ARMED
        self._armed = outputs.state == ARMED
        # what was commanded counts before the target limits it: no step is to be left to that
        reached = outputs.obeyed if self._armed else applied
        steps = np.maximum(np.abs(applied - before), np.abs(reached - before))
        self.worst_step = max(self.worst_step, float(steps[:-1].max()))
        over = float((steps[:-1] / (self._rate_limit * self.period)).max())
        self.worst_step_over_rate_limit = max(self.worst_step_over_rate_limit, over)
        self.worst_table_step = max(self.worst_table_step, float(steps[-1]))
        self.worst_force = max(self.worst_force, float(np.abs(applied[:-1]).max()))
        if before[:-1].any() and not applied[:-1].any() and not self._armed:
            self.worst_seconds_to_zero = max(self.worst_seconds_to_zero, (self.tick - self._heard) * self.period)
        return self._move()

    def _move(self) -> NDArray[np.float64]:
        """The readings at this tick, after one with the outputs that act."""
        applied = self.outputs.applied
        of_structure = len(self._measured_outputs)
        self._true[:of_structure] = self._motion.outputs(float(applied[-1]), applied[:-1])[self._measured_outputs]
        self._true[of_structure:] = before = self._motion.ground_acceleration
        self.displacement += self.period * (self._velocity + self.period / 6 * (2 * self._ground + before))
        self._velocity += self.period / 2 * (self._ground + before)
        self._ground = before
        if self.outputs.state == DISARMED:
            self._velocity = 0.0  # the brake acts
        return self._measurement.read(self._true)
