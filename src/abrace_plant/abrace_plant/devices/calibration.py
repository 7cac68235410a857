# SPDX-License-Identifier: Apache-2.0
"""The calibration file: conversion of readings from volts or counts to SI units, and of commands to volts or counts.

    value = sign gain (raw - offset - zero) of a measured channel, in `unit`
    raw   = offset + sign value / gain      of a commanded one

A filter delays its signal: at frequencies well below its own frequency f by 1 / (2 pi f) for the first order and by
sqrt(2) / (2 pi f) for the second (Butterworth), a little less where f is near half the sample rate. This is a phase lag
of 360 degrees times frequency times delay, which the identified model contains.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import pydantic
import yaml

from abrace_core import AbraceError
from abrace_core.files.config_file import Checked, expect_entries, read_config
from abrace_core.files.quantity import Quantity
from abrace_core.files.units import unit_of
from abrace_core.files.writing import write_text
from abrace_core.model import signals
from abrace_plant.devices.device import DeviceError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

AT_END = 0.999
"""Share of half the range beyond which a reading counts as clipped: 16 bits of a converter end at 0.99997."""

Positive = Annotated[float, pydantic.Field(gt=0)]


class Filter(Checked):
    """A low-pass: order 1, or 2 (Butterworth); frequency [Hz] at which 0.71 of the amplitude is left."""

    order: Literal[1, 2]
    frequency: Annotated[Positive, Quantity("Hz")]


class CommandChannel(Checked):
    """An output: `gain` in `unit` per raw unit, `offset` and `range` in raw units (volts or counts)."""

    gain: Positive
    unit: str
    range: tuple[float, float]
    offset: float = 0.0
    sign: Literal[1, -1] = 1

    @property
    def at_zero(self) -> float:
        """Reading or output at zero, in raw units."""
        return self.offset


class Channel(CommandChannel):
    """A measured channel; `delay` is that of amplifier, converter and anti-aliasing filter [s].

    `zero`: reading at rest beyond `offset`, as zeroing found it last, in raw units.
    """

    zero: float = 0.0
    filter: Filter | None = None
    delay: Annotated[float, pydantic.Field(ge=0, lt=1), Quantity("s")] = 0.0

    @property
    def at_zero(self) -> float:
        """Reading at rest, in raw units."""
        return self.offset + self.zero


class CalibrationFile(Checked):
    """A calibration file: a channel by its signal's name (x1, xf, a1, fa, w) and a command by its (U, w)."""

    channels: dict[str, Channel]
    commands: dict[str, CommandChannel]


def read_calibration(path: Path | str) -> CalibrationFile:
    """Read a calibration file; `Calibration` checks it against the signals of a rig.

    Raises
    ------
    AbraceError
        Naming the file, the key, the value and what was expected.
    """
    return read_config(path, CalibrationFile, "calibration")


def write_calibration(path: Path | str, file: CalibrationFile) -> None:
    """Replace a calibration `file`, atomically; its comments are lost."""
    write_text(path, yaml.safe_dump(file.model_dump(exclude_defaults=True, mode="json"), sort_keys=False))


class Calibration:
    """The calibration of a device, applied to all channels at once.

    Parameters
    ----------
    file
        The calibration file; None: readings and commands are in SI units already, and none is ever clipped.
    channels
        Names of the measured channels, in their order.
    commands
        Names of the commands, in their order.
    sample_rate
        Hz, for the filters.
    path
        Of the file.

    Attributes
    ----------
    file, path, channels
        As given.
    commands
        Number of commands.
    delay
        Delay that all channels have in common [s]: the samples were taken that much before the device's own stamp.

    Raises
    ------
    AbraceError
        Naming the channel, and what was expected of it.
    """

    def __init__(
        self,
        file: CalibrationFile | None,
        channels: Sequence[str],
        commands: Sequence[str],
        sample_rate: float,
        path: Path | None = None,
    ) -> None:
        self.file, self.path = file, path
        self._signals = channels, commands, sample_rate
        self.channels = tuple(channels)
        self.commands = len(commands)
        measured = _entries(file.channels if file else None, channels, "channels")
        commanded = _entries(file.commands if file else None, commands, "commands")
        self._scale, self._offset, self._low, self._high = _arrays(measured)
        self._command_scale, self._command_offset, self._command_low, self._command_high = _arrays(commanded)
        margin = (1 - AT_END) / 2 * (self._high - self._low) if file else 0.0
        self._clips = self._low + margin, self._high - margin
        delays = [file.channels[name].delay if file else 0.0 for name in channels]
        self.delay = min(delays)
        filters = [file.channels[name].filter if file else None for name in channels]
        self._filter = _Filters(filters, channels, sample_rate) if any(filters) else None
        self.lag = tuple(delay + _filter_delay(each, sample_rate) for delay, each in zip(delays, filters, strict=True))
        """(channels,) delay and that of the filter at low frequencies [s]."""

    def with_file(self, file: CalibrationFile) -> Calibration:
        """The calibration of the same channels by another `file`."""
        return Calibration(file, *self._signals, self.path)

    def reset(self) -> None:
        """Restart the filters with the next reading."""
        if self._filter is not None:
            self._filter.begun[:] = False

    def measured(self, raw: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
        """One tick's readings (channels,) in SI units, filtered, and a bit for each channel at the end of its range.

        Parameters
        ----------
        raw
            (channels,) as the device gives them; values beyond a channel's range are cut to it.
        """
        clipped = 0
        ends = (raw <= self._clips[0]) | (raw >= self._clips[1])
        if ends.any():
            clipped = sum(1 << i for i in np.flatnonzero(ends).tolist())
            raw = np.clip(raw, self._low, self._high)
        values = (raw - self._offset) * self._scale
        return (values if self._filter is None else self._filter.step(values)), clipped

    def outputs(self, values: Sequence[float]) -> list[float]:
        """(commands,) `values` in SI units as the device takes them, within the ranges of its outputs.

        Raises
        ------
        DeviceError
            If one is not finite: that must not reach a device.
        """
        if not math.isfinite(sum(values)):
            raise DeviceError(f"commands {list(values)}, expected finite numbers")
        raw = np.asarray(values) / self._command_scale + self._command_offset
        found: list[float] = np.clip(raw, self._command_low, self._command_high).tolist()
        return found

    def raw(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """(channels,) what the device gives for `values` in SI units: the inverse of `measured` without its filters."""
        return np.clip(values / self._scale + self._offset, self._low, self._high)

    def commanded(self, outputs: Sequence[float]) -> NDArray[np.float64]:
        """(commands,) SI values of a device's `outputs`: the inverse of the method `outputs`."""
        return (np.asarray(outputs) - self._command_offset) * self._command_scale

    def facts(self) -> dict[str, str]:
        """As text: gain, offset and lag of each channel."""
        if self.file is None:
            return {}
        return {
            name: f"{self.file.channels[name].sign * self.file.channels[name].gain:g} {self.file.channels[name].unit}, "
            f"offset {self.file.channels[name].at_zero:g}, lag {1e3 * lag:.2f} ms"
            for name, lag in zip(self.channels, self.lag, strict=True)
        }

    @property
    def range(self) -> NDArray[np.float64]:
        """(channels, 2) lower and upper end of a channel's readings in SI units; infinite without a file."""
        ends = (np.column_stack([self._low, self._high]) - self._offset[:, None]) * self._scale[:, None]
        return np.sort(ends, axis=1)


def _entries(
    given: dict[str, Channel] | dict[str, CommandChannel] | None, names: Sequence[str], key: str
) -> list[tuple[str, CommandChannel | None]]:
    """The entry of each name, checked; None where there is no file."""
    if given is None:
        return [(name, None) for name in names]
    expect_entries(given, names, key)
    for name, entry in given.items():
        try:
            si_gain(name, entry)
        except ValueError as error:
            raise AbraceError(f"{key}.{name}.unit: {error}") from error
        if not entry.range[0] < entry.at_zero < entry.range[1]:
            raise AbraceError(f"{key}.{name}.range: {list(entry.range)}, expected its ends around {entry.at_zero:g}")
    return [(name, given[name]) for name in names]


def si_gain(name: str, entry: CommandChannel) -> float:
    """The gain of the signal `name` in its SI unit; a ValueError says what is wrong with the entry's unit."""
    si, given = unit_of(signals.unit(name)), unit_of(entry.unit)
    if given.dimension != si.dimension:
        raise ValueError(f"{entry.unit!r} is another kind of quantity, expected one as {signals.unit(name)}")
    return entry.gain * given.factor


def _arrays(entries: Sequence[tuple[str, CommandChannel | None]]) -> tuple[NDArray[np.float64], ...]:
    """SI units per raw unit with the sign, offsets, low and high ends of the ranges, each (entries,)."""
    rows = [
        (1.0, 0.0, -math.inf, math.inf)
        if entry is None
        else (entry.sign * si_gain(name, entry), entry.at_zero, *entry.range)
        for name, entry in entries
    ]
    return tuple(np.array(rows, dtype=np.float64).reshape(-1, 4).T)


def _filter_delay(given: Filter | None, sample_rate: float) -> float:
    """Of a filter at frequencies well below its own [s]."""
    if given is None:
        return 0.0
    order = 1.0 if given.order == 1 else math.sqrt(2)
    return order / (2 * sample_rate * math.tan(math.pi * given.frequency / sample_rate))


class _Filters:
    """A second-order section for each channel, stepped together.

    Each begins at rest at its first finite value, also after one that is not finite.
    """

    def __init__(self, filters: Sequence[Filter | None], channels: Sequence[str], sample_rate: float) -> None:
        rows = []
        for name, given in zip(channels, filters, strict=True):
            if given is not None and given.frequency >= sample_rate / 2:
                raise AbraceError(
                    f"channels.{name}.filter.frequency: {given.frequency:g} Hz, expected less than half of "
                    f"{sample_rate:g} Hz"
                )
            rows.append(_section(given, sample_rate))
        self._b0, self._b1, self._b2, self._a1, self._a2 = np.array(rows).T
        self.begun = np.zeros(len(rows), dtype=np.bool_)
        self._first = self._second = np.zeros(len(rows))

    def step(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        if not self.begun.all():
            at_rest = (self._b2 - self._a2) * values
            self._second = np.where(self.begun, self._second, at_rest)
            self._first = np.where(self.begun, self._first, (self._b1 - self._a1) * values + at_rest)
        filtered = self._b0 * values + self._first
        self._first = self._b1 * values - self._a1 * filtered + self._second
        self._second = self._b2 * values - self._a2 * filtered
        self.begun = np.isfinite(filtered)
        return filtered


def _section(given: Filter | None, sample_rate: float) -> tuple[float, float, float, float, float]:
    """b0, b1, b2, a1, a2 of the bilinear transform, exact at the filter's frequency."""
    if given is None:
        return 1.0, 0.0, 0.0, 0.0, 0.0
    k = math.tan(math.pi * given.frequency / sample_rate)
    if given.order == 1:
        return k / (1 + k), k / (1 + k), 0.0, (k - 1) / (1 + k), 0.0
    scale = 1 / (1 + math.sqrt(2) * k + k * k)
    b = k * k * scale
    return b, 2 * b, b, 2 * (k * k - 1) * scale, (1 - math.sqrt(2) * k + k * k) * scale
