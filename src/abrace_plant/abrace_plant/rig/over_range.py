# SPDX-License-Identifier: Apache-2.0
"""Channels at the end of their sensors' range, where a reading means only that the true value is at or beyond it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_plant.rig.sensors import Sensor

TRUE = b"\1"


class OverRange:
    """Finds and counts the readings that are the first or the last of their converters.

    Parameters
    ----------
    channels
        One sensor a channel.

    Attributes
    ----------
    lowest, highest
        (channels,) a reading below or above these is at the end of its channel's range.
    counts
        (channels,) such readings so far.
    """

    def __init__(self, channels: Sequence[Sensor]) -> None:
        self.highest = np.array([sensor.highest - sensor.step / 2 for sensor in channels])
        self.lowest = np.array([-sensor.range + sensor.step / 2 for sensor in channels])
        self._above = np.zeros(len(channels), dtype=np.bool_)
        self._below = self._above.copy()
        self.counts: NDArray[np.int64] = np.zeros(len(channels), dtype=np.int64)

    def check(self, reading: NDArray[np.float64]) -> int:
        """The channels of a `reading` (channels,) that are at the end of their range, as bits: bit i for channel i."""
        np.greater(reading, self.highest, out=self._above)
        np.less(reading, self.lowest, out=self._below)
        np.logical_or(self._above, self._below, out=self._above)
        if TRUE not in self._above.tobytes():  # quicker than any() by half a microsecond
            return 0
        self.counts += self._above
        return sum(1 << i for i in np.flatnonzero(self._above).tolist())
