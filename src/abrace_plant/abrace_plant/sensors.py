"""What stands between a quantity and its record: noise, range and quantisation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

BLOCK = 4096
"""Samples of noise that are drawn at a time."""


@dataclass(frozen=True)
class Sensor:
    """One kind of channel.

    Parameters
    ----------
    range
        Greatest reading, in the channel's SI unit; readings beyond it are clipped.
    noise
        Standard deviation of the white noise, in the channel's SI unit.
    bits
        Resolution of the converter over -range ... range.
    """

    range: float
    noise: float
    bits: int


@dataclass(frozen=True)
class SensorSet:
    """The sensor of each kind of quantity."""

    displacement: Sensor
    stroke: Sensor
    acceleration: Sensor
    force: Sensor
    ground_acceleration: Sensor

    def channels(self, floors: int, groups: int) -> list[Sensor]:
        """One sensor a channel, in the order [z, w] of a rig of `floors` floors and `groups` brace groups."""
        return (
            [self.displacement] * floors
            + [self.stroke] * groups
            + [self.acceleration] * floors
            + [self.force] * groups
            + [self.ground_acceleration]
        )


class Measurement:
    """Turns the true values of `channels` into readings, sample by sample; the same seed gives the same readings."""

    def __init__(self, channels: list[Sensor], seed: int) -> None:
        self._noise = np.array([channel.noise for channel in channels])
        self._limit = np.array([channel.range for channel in channels])
        self._step = np.array([channel.range / 2 ** (channel.bits - 1) for channel in channels])
        self._most = self._limit - self._step
        self._random = np.random.default_rng(seed)
        self._block = np.empty((0, len(channels)))
        self._next = 0

    def read(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Readings (channels,) of the true values (channels,)."""
        if self._next == len(self._block):
            self._block = self._random.standard_normal((BLOCK, len(self._noise))) * self._noise
            self._next = 0
        reading = values + self._block[self._next]
        self._next += 1
        np.clip(reading, -self._limit, self._most, out=reading)
        reading /= self._step
        np.rint(reading, out=reading)
        reading *= self._step
        return reading
