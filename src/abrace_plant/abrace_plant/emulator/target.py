# SPDX-License-Identifier: Apache-2.0
"""An emulated target: the simulated rig with its own tick, and the protections that a real target must have.

A target follows commands while they keep coming. When the life counter of the commands has not changed for `LIFE_TIME`,
or a command is not enabled, it brings force and table to rest by itself, along a ramp of its own.
It follows again once it has been commanded zero.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from abrace_plant.rig.motion import RigMotion
from abrace_plant.rig.sensors import Measurement, parse_fault

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_plant.rig.model import Rig

LIFE_TIME = 0.05
"""Seconds for which the life counter may stay unchanged."""
RAMP_TIME = 0.1
"""Seconds in which the target then brings the force to zero, along half a cosine."""
BRAKING_TIME = 0.05
"""Time constant with which the table then comes to rest [s]."""


STILL = 1e-6
"""Velocity below which the table counts as being at rest [m/s]."""
AT_REST = 1e-3
"""Share of capacity and of the table's peak acceleration below which a command counts as zero."""


class Target:
    """The rig, its sensors, and the guard of its outputs; `step` is one tick.

    Parameters
    ----------
    rig
        The rig.
    seed
        Of the sensors' noise.
    channels
        Names of the measured channels, for their faults.

    Attributes
    ----------
    tick
        Number of the last tick.
    following
        Whether commands act.
    stops
        Times that the target brought itself to rest.
    worst_step
        Greatest change of a brace's force command from one tick to the next that reached the actuators [N].
    worst_step_over_rate_limit
        The same over what the rate limit allows in a tick.
    worst_table_step
        Likewise of the table's acceleration [m/s^2].
    worst_force
        Greatest force command that reached the actuators [N].
    worst_command
        Greatest command that was received, of force or table, over the greatest that the rig has, before it is limited
        to that; infinite: one that was not finite.
    worst_seconds_to_zero
        Longest time from the last command to zero force, of all stops.
    """

    def __init__(self, rig: Rig, seed: int, channels: Sequence[str]) -> None:
        self.period = 1 / rig.sample_rate
        self._motion = RigMotion(rig)
        self._measurement = Measurement(rig.channel_sensors, seed, self.period)
        self._channels = tuple(channels)
        self._most = np.append(rig.capacity, rig.table.peak_acceleration)
        self._rate_limit = rig.rate_limit
        self._jerk_step = rig.table.peak_jerk * self.period
        self._measured_outputs = rig.measured_outputs
        self._true = np.zeros(len(channels))
        self._command = np.zeros(rig.groups + 1)
        self._acting = np.zeros(rig.groups + 1)
        self._velocity = 0.0
        self._stopped_at, self._stopped_from = 0, self._acting
        self._alive = 0
        self.tick = -1
        self.following = False
        self.stops = 0
        self.worst_step = self.worst_step_over_rate_limit = self.worst_table_step = self.worst_force = 0.0
        self.worst_seconds_to_zero = self.worst_command = 0.0

    def command(self, values: NDArray[np.float64], enabled: bool) -> None:
        """Take a command whose life counter is new.

        Parameters
        ----------
        values
            (groups + 1,) force of one brace of each group [N], acceleration of the table [m/s^2].
        enabled
            Whether it is to be followed.
        """
        self._alive = self.tick
        share = float(np.nan_to_num(np.abs(values) / self._most, nan=np.inf, posinf=np.inf).max())
        self.worst_command = max(self.worst_command, share)
        if not enabled:
            self.stop()
        elif self.following:
            self._command = np.clip(values, -self._most, self._most)
        elif not self._acting.any() and (np.abs(values) <= AT_REST * self._most).all():
            self.following = True
            self._command = values

    def stop(self) -> None:
        """Bring force and table to rest."""
        if self.following:
            self.following = False
            self.stops += 1
            self._stopped_at, self._stopped_from = self.tick, self._acting

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
        for _ in range(ticks):
            self.tick += 1
            self._stopped_at += 1
            self._move()

    def step(self) -> NDArray[np.float64]:
        """The readings (channels,) at the next tick, in SI units."""
        self.tick += 1
        if self.following and (self.tick - self._alive) * self.period > LIFE_TIME:
            self.stop()
        before = self._acting
        self._acting = self._command if self.following else self._falling()
        steps = np.abs(self._acting - before)
        self.worst_step = max(self.worst_step, float(steps[:-1].max()))
        over = float((steps[:-1] / (self._rate_limit * self.period)).max())
        self.worst_step_over_rate_limit = max(self.worst_step_over_rate_limit, over)
        self.worst_table_step = max(self.worst_table_step, float(steps[-1]))
        self.worst_force = max(self.worst_force, float(np.abs(self._acting[:-1]).max()))
        if before[:-1].any() and not self._acting[:-1].any() and not self.following:
            self.worst_seconds_to_zero = max(self.worst_seconds_to_zero, (self.tick - self._alive) * self.period)
        return self._move()

    def _move(self) -> NDArray[np.float64]:
        """The readings at this tick, after one with the outputs that act."""
        ground = float(self._acting[-1])
        self._velocity += ground * self.period
        self._true[:-1] = self._motion.outputs(ground, self._acting[:-1])[self._measured_outputs]
        self._true[-1] = self._motion.ground_acceleration
        return self._measurement.read(self._true)

    def _falling(self) -> NDArray[np.float64]:
        """The next values of the ramp: half a cosine to zero force, and a table that brakes to rest."""
        share = min((self.tick - self._stopped_at) * self.period / RAMP_TIME, 1.0)
        acting = self._stopped_from * (1 + math.cos(math.pi * share)) / 2 if share < 1 else np.zeros(len(self._most))
        ground, most = float(self._acting[-1]), float(self._most[-1])
        aim = min(max(-self._velocity / BRAKING_TIME, -most), most)
        acting[-1] = ground + min(max(aim - ground, -self._jerk_step), self._jerk_step)
        if abs(self._velocity) < STILL and abs(acting[-1]) < STILL / BRAKING_TIME:
            self._velocity = acting[-1] = 0.0
        return acting
