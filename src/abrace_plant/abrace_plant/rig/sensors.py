# SPDX-License-Identifier: Apache-2.0
"""Sensors: bias, drift, hum, noise, range and quantisation of the readings, and channels that fail."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
import pydantic

from abrace_core import AbraceError
from abrace_plant.rig.checks import Hertz  # noqa: TC001, as pydantic reads the annotations

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

BLOCK = 256
"""Samples of noise that are drawn at a time: by the clock 4096 of ten channels made an answer late."""


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
    bias
        Constant error, in the channel's SI unit.
    drift
        Growth of the error [the channel's SI unit per second].
    hum, hum_frequency
        Amplitude of the mains' hum in the cables, in the channel's SI unit, and its frequency [Hz].
    bandwidth
        Of the transducer with its conditioner [Hz]; see `sensor_dynamics`.
    """

    range: float
    noise: float
    bits: int
    bias: float = 0.0
    drift: float = 0.0
    hum: float = 0.0
    hum_frequency: float = 60.0
    bandwidth: float = math.inf

    @property
    def step(self) -> float:
        """Of the converter, in the channel's SI unit."""
        return self.range / 2 ** (self.bits - 1)

    @property
    def highest(self) -> float:
        """The highest reading, a step below the range; the lowest is -range."""
        return self.range - self.step


TRUE = b"\1"


class OverRange:
    """Finds the readings that are the first or the last of their converters: the true value is there or beyond.

    Parameters
    ----------
    channels
        One sensor a channel.

    Attributes
    ----------
    lowest, highest
        (channels,) a reading below or above these is at the end of its channel's range.
    """

    def __init__(self, channels: Sequence[Sensor]) -> None:
        self.highest = np.array([sensor.highest - sensor.step / 2 for sensor in channels])
        self.lowest = np.array([-sensor.range + sensor.step / 2 for sensor in channels])
        self._above = np.zeros(len(channels), dtype=np.bool_)
        self._below = self._above.copy()

    def check(self, reading: NDArray[np.float64]) -> int:
        """The channels of a `reading` (channels,) that are at the end of their range, as bits: bit i for channel i."""
        np.greater(reading, self.highest, out=self._above)
        np.less(reading, self.lowest, out=self._below)
        np.logical_or(self._above, self._below, out=self._above)
        if TRUE not in self._above.tobytes():  # quicker than any() by half a microsecond
            return 0
        return sum(1 << i for i in np.flatnonzero(self._above).tolist())


@dataclass(frozen=True)
class AntiAlias:
    """A Butterworth low-pass in front of every converter.

    Parameters
    ----------
    cutoff
        Frequency at which the gain is 3 dB less than at rest [Hz].
    order
        1 or more.
    """

    cutoff: Hertz
    order: Annotated[int, pydantic.Field(ge=1, le=10)]


KINDS = ("displacement", "stroke", "acceleration", "force", "ground_acceleration")
"""Of sensors."""


@dataclass(frozen=True)
class SensorSet:
    """The sensor of each kind of quantity.

    Parameters
    ----------
    displacement, stroke, acceleration, force, ground_acceleration
        The sensors; None: there are none of that kind.
    anti_alias
        The filter in front of every converter; None: none.
    cross_axis
        Share of an acceleration across its axis that an accelerometer of a floor reads as one along it.
    without
        Names of channels without a sensor, of a kind that others have.
    """

    displacement: Sensor | None
    stroke: Sensor | None
    acceleration: Sensor | None
    force: Sensor | None
    ground_acceleration: Sensor | None
    anti_alias: AntiAlias | None = None
    cross_axis: float = 0.0
    without: frozenset[str] = frozenset()

    def channels(self, floors: int, groups: int, braces: int) -> list[Sensor | None]:
        """The kind of sensor of each channel of a rig of `floors` floors and `braces` braces in `groups` groups.

        In the order displacements, strokes, absolute accelerations, load cells, the table's acceleration.
        """
        return (
            [self.displacement] * floors
            + [self.stroke] * groups
            + [self.acceleration] * floors
            + [self.force] * braces
            + [self.ground_acceleration]
        )


@dataclass(frozen=True)
class SensorFault:
    """A channel that fails.

    Parameters
    ----------
    channel
        Position in the readings.
    kind
        "stuck": the last reading is held; "zero": readings are zero; "noise": an open input, white noise with a
        standard deviation of a third of the range.
    start
        First sample of the fault.
    """

    channel: int
    kind: str
    start: int


FAULTS = ("stuck", "zero", "noise")
"""Kinds of sensor faults."""


def parse_fault(text: str, names: Sequence[str], sample_period: float) -> SensorFault:
    """The fault that a text like `a2=stuck` or `x3=noise@20.0` describes: channel, kind, second at which it starts.

    Parameters
    ----------
    text
        As the user gave it.
    names
        The channels' names, in their order.
    sample_period
        [s].

    Raises
    ------
    AbraceError
        If there is no such channel or kind, or the time is no number of seconds.
    """
    channel, _, rest = text.partition("=")
    kind, at, time = rest.partition("@")
    start = 0.0
    if at:
        try:
            start = float(time)
        except ValueError:
            start = math.nan
    if channel not in names or kind not in FAULTS or not (math.isfinite(start) and start >= 0):
        raise AbraceError(
            f"sensor fault {text!r}: expected CHANNEL=KIND or CHANNEL=KIND@SECONDS, the channel out of "
            f"{', '.join(names)}, the kind out of {', '.join(FAULTS)}"
        )
    return SensorFault(names.index(channel), kind, math.ceil(start / sample_period - 1e-9))


class Measurement:
    """Turns the true values of `channels` into readings, sample by sample; the same seed gives the same readings.

    Parameters
    ----------
    channels
        One sensor a channel.
    seed
        Of the noise.
    sample_period
        [s].
    """

    def __init__(self, channels: Sequence[Sensor], seed: int, sample_period: float) -> None:
        self._noise = np.array([channel.noise for channel in channels])
        self._bias = np.array([channel.bias for channel in channels])
        self._drift = np.array([channel.drift for channel in channels]) * sample_period
        self._hum = np.array([channel.hum for channel in channels])
        self._turn = 2 * np.pi * sample_period * np.array([channel.hum_frequency for channel in channels])
        self._phase = np.random.default_rng((seed, 2)).uniform(0.0, 2 * np.pi, len(channels))
        self._limit = np.array([channel.range for channel in channels])
        self._step = np.array([channel.step for channel in channels])
        self._most = np.array([channel.highest for channel in channels])
        self._random = np.random.default_rng(seed)
        self._open_inputs = np.random.default_rng((seed, 1))
        self._errors = np.empty((0, len(channels)))
        self._next = 0
        self._drawn = 0
        self._last = np.zeros(len(channels))
        self.faults: tuple[SensorFault, ...] = ()
        """Present and later faults; may be changed at any time."""

    def read(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Readings (channels,) of the true `values` (channels,) at the next sample."""
        if self._next == len(self._errors):
            self._draw()
        reading = values + self._errors[self._next]
        if self.faults:
            self._apply_faults(reading[None], self._drawn - BLOCK + self._next)
        self._next += 1
        self._convert(reading)
        self._last = reading
        return reading

    def record(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Readings (samples, channels) of the true `values` (samples, channels) at the next samples, all at once."""
        readings = np.array(values, dtype=np.float64)
        done = 0
        while done < len(readings):
            if self._next == len(self._errors):
                self._draw()
            block = readings[done : done + len(self._errors) - self._next]
            block += self._errors[self._next : self._next + len(block)]
            if self.faults:
                self._apply_faults(block, self._drawn - BLOCK + self._next)
            self._convert(block)
            self._next += len(block)
            self._last = block[-1]
            done += len(block)
        return readings

    def _draw(self) -> None:
        """Draw the errors of the next block of samples."""
        samples = self._drawn + np.arange(BLOCK)[:, None]
        noise = self._random.standard_normal((BLOCK, len(self._noise))) * self._noise
        self._errors = noise + (self._bias + samples * self._drift)
        if self._hum.any():
            self._errors += self._hum * np.sin(samples * self._turn + self._phase)
        self._drawn += BLOCK
        self._next = 0

    def _apply_faults(self, readings: NDArray[np.float64], first: int) -> None:
        """Replace the `readings` (samples, channels) of channels that have failed, from sample number `first` on."""
        for fault in self.faults:
            channel, failed = fault.channel, readings[max(fault.start - first, 0) :, fault.channel]
            if not len(failed):
                continue
            if fault.kind == "stuck":
                failed[:] = readings[fault.start - first - 1, channel] if fault.start > first else self._last[channel]
            elif fault.kind == "zero":
                failed[:] = 0.0
            else:
                failed[:] = self._limit[channel] / 3 * self._open_inputs.standard_normal(len(failed))

    def _convert(self, readings: NDArray[np.float64]) -> None:
        """Clip to the range and round to the converter's steps, in place."""
        np.minimum(readings, self._most, out=readings)
        np.maximum(readings, -self._limit, out=readings)
        readings /= self._step
        np.rint(readings, out=readings)
        readings *= self._step
