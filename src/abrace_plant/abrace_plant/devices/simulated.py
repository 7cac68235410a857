# SPDX-License-Identifier: Apache-2.0
"""The simulated rig as a device and its own target: a model that ticks, in real time, by the computer's clock."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.safety.table_stop import TableState
from abrace_plant.devices.device import Reading, TargetStatus, Wanted
from abrace_plant.rig.motion import RigMotion
from abrace_plant.rig.sensors import Measurement, parse_fault

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_plant.rig.model import Rig

LONGEST_CATCH_UP = 0.01
"""Longest delay [s] after which the samples are caught up one by one; after a longer one they are missed."""


def check_faults(texts: Sequence[str], rig: Rig) -> None:
    """Refuse `texts` that are no faults of a `rig`'s sensors, by an AbraceError as in `parse_fault`."""
    for text in texts:
        parse_fault(text, rig.channel_names, 1 / rig.sample_rate)


class SimulatedRig:
    """A rig that starts at rest.

    Parameters
    ----------
    rig
        The rig.
    seed
        Of the sensors' noise.
    by_the_clock
        Whether a sample is taken when it is due; otherwise at once, and stamps count from `begin`.
    begin
        Stamp of the first sample [ns].
    table_displacement
        Where the table rests [m].

    Attributes
    ----------
    next_stamp
        Stamp of the next sample that is taken at once [ns].
    """

    def __init__(
        self, rig: Rig, seed: int, by_the_clock: bool, begin: int = 0, table_displacement: float = 0.0
    ) -> None:
        self._period, self._names = 1 / rig.sample_rate, rig.channel_names
        self._motion = RigMotion(rig)
        self._measurement = Measurement(rig.channel_sensors, seed, self._period)
        self._measured_outputs, self._of_structure = rig.measured_outputs, len(rig.measured_outputs)
        self._true = np.zeros(len(rig.channel_names))
        self._table = TableState(self._period, table_displacement)
        self._zero = [0.0] * rig.groups
        self._armed = self._last_arm = 0
        self._by_the_clock = by_the_clock
        self._begin = self.next_stamp = begin
        self._samples = 0
        self._start = 0.0

    def set_sensor_faults(self, texts: Sequence[str]) -> None:
        """Let channels fail as the `texts` say, each as for `parse_fault` with times from sample 0, and no others."""
        self._measurement.faults = tuple(parse_fault(text, self._names, self._period) for text in texts)

    def open(self) -> None:
        """Begin: the first sample is due now."""
        self._start = time.monotonic()

    def exchange(self, command: Sequence[float], table: float, wanted: Wanted, arm: int) -> Reading:
        """Wait for the next sample; `command` and `table` act from its instant on. `wanted`, `arm`: as in `Device`."""
        missed, age = 0, 0.0
        stamp = self.next_stamp
        if self._by_the_clock:
            if self._samples == 1:
                # the middleware is slow with the first sample; the second one is due a period after that
                self._start = time.monotonic()
            delay = self._start + self._samples * self._period - time.monotonic()
            if delay > 0:
                time.sleep(delay)
                delay = self._start + self._samples * self._period - time.monotonic()
            age = max(0.0, -delay)
            if age > LONGEST_CATCH_UP:
                missed = int(age / self._period)
                age -= missed * self._period
            stamp = time.time_ns()
        if wanted is Wanted.SAFE or (self._armed and arm != self._armed):
            self._armed = 0
        elif wanted is Wanted.HOLD_ZERO and arm == self._last_arm + 1:
            self._armed = self._last_arm = arm
        if wanted is not Wanted.FOLLOW or not self._armed:
            command, table = self._zero, 0.0
        for _ in range(1 + missed):
            self._true[: self._of_structure] = self._motion.outputs(table, np.asarray(command))[self._measured_outputs]
            self._table.update(table)
        self._samples += 1 + missed
        self.next_stamp = self._begin + round(self._samples * self._period * 1e9)
        self._true[self._of_structure :] = self._motion.ground_acceleration
        values = self._measurement.read(self._true)
        target = TargetStatus(self._armed, self._last_arm, "", [*command, table], self._table.displacement)
        return Reading(values, stamp, 0, missed, target, age)

    def make_safe(self) -> None:
        """Do nothing: a model needs no protection."""

    def close(self) -> None:
        """Nothing is open."""
