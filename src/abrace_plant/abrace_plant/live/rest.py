# SPDX-License-Identifier: Apache-2.0
"""Whether a rig is at rest by what is measured: the load cells, and the place of a table that abrace drives.

An actuator that holds zero force in a building that still vibrates does not read zero. So a force counts as measured
when it is more than the interlock `force_error` of the rig file allows between a force and its command, here zero; or
when its mean over a period of the building's slowest mode, in which vibration cancels, is more than HELD.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING

from abrace_core.safety.table_guard import DRIFT
from abrace_plant.rig.limits import cell_limits, frequencies

if TYPE_CHECKING:
    from abrace_plant.devices.device import Reading
    from abrace_plant.rig.model import Interlock, Rig

HELD = 0.03
"""Share of its capacity that a brace's mean force may keep: friction of seals and a load cell's zero are 1 to 2 %."""
TABLE_TIME = 0.1
"""Seconds over which the table's velocity is measured by its displacement."""


def slowest_period(rig: Rig) -> float:
    """Period of the slowest mode of the building of a `rig` [s], over which the mean forces are taken."""
    return 2 * math.pi / float(frequencies(rig)[0])


class RestCheck:
    """Compares readings with rest.

    Parameters
    ----------
    rig
        The rig.
    force_error
        Its interlock of that name; None: there is no load cell, and only the table's rest is known.
    """

    def __init__(self, rig: Rig, force_error: Interlock | None) -> None:
        self._limits, self._held = dict[str, float](), dict[str, float]()
        if force_error and rig.sensors.force:
            self._limits = cell_limits(rig, force_error, 0.0)
            held = replace(force_error, value=HELD * max(rig.capacity, default=0.0))
            self._held = cell_limits(rig, held, rig.sensors.force.noise)
        first = rig.channel_names.index(next(iter(self._limits))) if self._limits else 0
        self._cells = slice(first, first + len(self._limits))
        self._longest = math.ceil(slowest_period(rig) * rig.sample_rate) if self._held else 0
        self.begin()
        self._driven = rig.table_driven
        self._slow = DRIFT * rig.table.peak_velocity
        self._window = round(TABLE_TIME * rig.sample_rate)
        self._time = self._window / rig.sample_rate
        self._places: deque[float] = deque(maxlen=self._window + 1)

    def begin(self) -> None:
        """Begin to take the mean forces anew: none is known."""
        self._count, self._sums = 0, [0.0] * len(self._held)
        self._means: list[float] = []

    @property
    def remaining(self) -> int:
        """Sample periods that are still to be measured before the mean forces are known."""
        return 0 if self._means else self._longest - self._count

    def problem(self, reading: Reading, commanded: bool) -> str:
        """What is not at rest in this `reading`, one of every sample; empty: all is at rest.

        `commanded`: whether a command that is not zero was in effect.
        """
        forces = reading.values[self._cells].tolist()
        found = [
            f"{name} {force:.0f} N"
            for (name, limit), force in zip(self._limits.items(), forces, strict=True)
            if not -limit <= force <= limit
        ]
        if commanded or found:
            self.begin()
        elif self._held:
            samples = 1 + reading.missed  # the reading stands for those that are missing before it
            self._count += samples
            self._sums = [total + samples * force for total, force in zip(self._sums, forces, strict=True)]
            if self._count >= self._longest:
                means = [total / self._count for total in self._sums]
                self.begin()
                self._means = means
            found += [
                f"{name} {mean:.0f} N on average"
                for (name, limit), mean in zip(self._held.items(), self._means, strict=False)
                if abs(mean) > limit
            ]
        places = self._places
        if self._driven and reading.target.table is not None:
            place = reading.target.table
            step = (place - (places[-1] if places else place)) / (1 + reading.missed)
            # of samples that are missing: those on the way
            places.extend(place - k * step for k in range(min(reading.missed, self._window), -1, -1))
            speed = abs(places[-1] - places[0]) / self._time
            if len(places) == places.maxlen and not speed <= self._slow:
                found.append(f"table at {speed:.3g} m/s")
        return ", ".join(found)
