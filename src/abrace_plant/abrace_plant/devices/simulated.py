# SPDX-License-Identifier: Apache-2.0
"""The simulated rig as a device: its hardware is a model, and its tick, in real time, the computer's clock."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from abrace_plant.devices.device import Reading
from abrace_plant.rig.motion import RigMotion
from abrace_plant.rig.sensors import Measurement, parse_fault

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_plant.rig.model import Rig
    from abrace_plant.rig.sensors import SensorFault

LONGEST_CATCH_UP = 0.01
"""Longest delay [s] after which the samples are caught up one by one; after a longer one they are missed."""


def sensor_faults(texts: Sequence[str], rig: Rig) -> tuple[SensorFault, ...]:
    """Sensor faults for `SimulatedRig.set_sensor_faults`; their times count from sample 0.

    Parameters
    ----------
    texts
        Each as for `parse_fault`, such as `["a2=stuck", "x3=noise@20.0"]`.
    rig
        Whose sensors fail.

    Raises
    ------
    AbraceError
        As in `parse_fault`.
    """
    return tuple(parse_fault(text, rig.channel_names, 1 / rig.sample_rate) for text in texts)


class SimulatedRig:
    """A rig that starts at rest.

    Parameters
    ----------
    rig
        The rig.
    seed
        Of the sensors' noise.
    by_the_clock
        Whether a sample is taken when it is due; otherwise at once, and stamps count from zero.
    """

    def __init__(self, rig: Rig, seed: int, by_the_clock: bool) -> None:
        self._period = 1 / rig.sample_rate
        self._motion = RigMotion(rig)
        self._measurement = Measurement(rig.channel_sensors, seed, self._period)
        self._measured_outputs = rig.measured_outputs
        self._true = np.zeros(len(rig.channel_names))
        self._by_the_clock = by_the_clock
        self._samples = 0
        self._start = 0.0

    def set_sensor_faults(self, faults: tuple[SensorFault, ...]) -> None:
        """Replace the sensor faults; none: every channel is well."""
        self._measurement.faults = faults

    def open(self) -> None:
        """Begin: the first sample is due now."""
        self._start = time.monotonic()

    def exchange(self, command: Sequence[float], table: float) -> Reading:
        """Wait for the next sample; `command` and `table` act from its instant on."""
        missed, age = 0, 0.0
        stamp = round(self._samples * self._period * 1e9)
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
        for _ in range(1 + missed):
            self._true[:-1] = self._motion.outputs(table, np.asarray(command))[self._measured_outputs]
        self._samples += 1 + missed
        self._true[-1] = self._motion.ground_acceleration
        values = self._measurement.read(self._true)
        return Reading(values, stamp, 0, missed, age)

    def make_safe(self) -> None:
        """Do nothing: a model needs no protection."""

    def close(self) -> None:
        """Nothing is open."""
