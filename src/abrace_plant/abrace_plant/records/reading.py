# SPDX-License-Identifier: Apache-2.0
"""Common parts of the readers of all formats: units of acceleration, lines of text, and checks of the values read.

In every format a reading has at least two finite values, and its times, if the file has any, have equal steps. The
stamps of messages that were recorded in real time have jitter: there every sample must be present, and the sample
period is the slope of the straight line through the stamps.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike, NDArray

UNITS = {"g": 9.80665, "m/s^2": 1.0, "cm/s^2": 0.01}
"""Units of acceleration, in m/s^2."""

_SPELLINGS = {
    "g": ("g",),
    "m/s^2": ("m/s^2", "m/s**2", "m/s2", "m/s/s", "m/sec^2", "m/sec**2", "m/sec2", "m/sec/sec", "m/s²"),
    "cm/s^2": (
        *("cm/s^2", "cm/s**2", "cm/s2", "cm/s/s", "cm/sec^2", "cm/sec**2", "cm/sec2", "cm/sec/sec", "cm/s²"),
        *("gal", "gals"),
    ),
}
"""Spellings of the units in headers of files, without capital letters and spaces."""

TIME_TOLERANCE = 0.02
"""Greatest deviation of printed times from equal steps, in steps (that of a missing sample is at least half a step)."""


@dataclass(frozen=True)
class Reading:
    """The content of a file.

    Parameters
    ----------
    acceleration
        (samples,) in `unit`, at least two, all finite.
    sample_period
        [s]; None where the file does not state it.
    unit
        One of `UNITS`; None where the file does not state it.
    """

    acceleration: NDArray[np.float64]
    sample_period: float | None
    unit: str | None


def unit_named(spelling: str) -> str | None:
    """The unit of `UNITS` that a header means by a spelling; None if there is none."""
    plain = "".join(spelling.lower().split())
    return next((unit for unit, spellings in _SPELLINGS.items() if plain in spellings), None)


def record_error(name: str, message: str, where: str = "") -> AbraceError:
    """An error with this message about the record of this name, and where in it, as `line 3`."""
    return AbraceError(f"ground motion {name}{where and ', '}{where}: {message}")


def checked_reading(
    values: ArrayLike,
    error_at: Callable[[str, int | None], AbraceError],
    *,
    unit: str | None,
    sample_period: float | None = None,
    times: ArrayLike | None = None,
    stamps: ArrayLike | None = None,
    numbers: ArrayLike | None = None,
) -> Reading:
    """Values and times as a reading, after checks.

    Parameters
    ----------
    values
        (samples,) in `unit`.
    error_at
        Makes the error of a message about a sample (the first is 0), or about the whole file (None).
    unit
        One of `UNITS`; None where the file does not state it.
    sample_period
        [s], where the file states it.
    times
        (samples,) [s], where the file has them: they give the period.
    stamps
        (samples,) [s], instead of times: instants that were measured, with jitter.
    numbers
        (samples,) integers, of the samples, where messages with stamps have them: they must be consecutive. Without
        them each step between stamps must be nearer to the usual step than to none or two.

    Raises
    ------
    AbraceError
        If there are fewer than two values, one is not finite, the steps of time are not equal, or a sample is missing.
    """
    acceleration = np.asarray(values, dtype=np.float64)
    if len(acceleration) < 2:
        raise error_at(f"{len(acceleration)} values, expected at least 2", None)
    wrong = np.flatnonzero(~np.isfinite(acceleration))
    if wrong.size:
        raise error_at(f"{acceleration[wrong[0]]:g}, expected a finite acceleration", int(wrong[0]))
    if times is not None:
        sample_period = _equal_step(np.asarray(times, dtype=np.float64), error_at)
    elif stamps is not None:
        instants = np.asarray(stamps, dtype=np.float64)
        if numbers is not None:
            _check_consecutive(np.asarray(numbers), error_at)
        sample_period = _mean_step(instants, error_at)
        if numbers is None:
            _check_steps(instants, sample_period, error_at)
    return Reading(acceleration, sample_period, unit)


def _equal_step(times: NDArray[np.float64], error_at: Callable[[str, int | None], AbraceError]) -> float:
    """The equal step of times [s]."""
    with np.errstate(over="ignore", invalid="ignore"):
        period = float((times[-1] - times[0]) / (len(times) - 1))
        off = np.abs(times - times[0] - period * np.arange(len(times)))
        if not (math.isfinite(period) and period > 0):
            raise error_at("times that do not increase, expected equal steps", len(times) - 1)
        if not off.max() <= TIME_TOLERANCE * period:
            steps = np.diff(times)
            usual = float(np.median(steps))
            worst = int(np.argmax(np.abs(steps - usual))) + 1
            raise error_at(f"time step {steps[worst - 1]:g} s, expected equal steps of {usual:g} s", worst)
    return period


def _check_consecutive(numbers: NDArray[Any], error_at: Callable[[str, int | None], AbraceError]) -> None:
    """Raise an error that says which numbers of samples are missing, or not in order."""
    unequal = np.flatnonzero(numbers[1:] != numbers[:-1] + 1)
    if not unequal.size:
        return
    before, after = (int(number) for number in numbers[unequal[0] : unequal[0] + 2])
    sample = int(unequal[0]) + 1
    if after <= before:
        raise error_at(f"sample number {after} after {before}, expected consecutive numbers of one run", sample)
    missing = f"sample {before + 1} is" if after == before + 2 else f"samples {before + 1} to {after - 1} are"
    raise error_at(f"{missing} missing before it, expected consecutive numbers", sample)


def _mean_step(stamps: NDArray[np.float64], error_at: Callable[[str, int | None], AbraceError]) -> float:
    """The step of the straight line through stamps [s] with the least squares of deviations."""
    places = np.arange(len(stamps)) - (len(stamps) - 1) / 2
    period = float(places @ (stamps - stamps.mean()) / (places @ places))
    if not period > 0 or not stamps[-1] > stamps[0]:
        raise error_at("times that do not increase, expected equal steps", len(stamps) - 1)
    return period


def _check_steps(
    stamps: NDArray[np.float64], period: float, error_at: Callable[[str, int | None], AbraceError]
) -> None:
    """Raise an error at a stamp [s] that is not one step after the last, or half a period [s] from a straight line."""
    steps = np.diff(stamps)
    usual = float(np.median(steps))
    worst = int(np.argmax(np.abs(steps - usual))) + 1
    if not abs(steps[worst - 1] - usual) < usual / 2:
        raise error_at(f"time step {steps[worst - 1]:g} s, expected equal steps of {usual:g} s", worst)
    off = stamps - stamps.mean() - period * (np.arange(len(stamps)) - (len(stamps) - 1) / 2)
    farthest = int(np.argmax(np.abs(off)))
    if not abs(off[farthest]) < period / 2:
        message = f"{off[farthest]:g} s off equal steps of {period:g} s, expected less than half a step"
        raise error_at(message, farthest)


class RecordText:
    """The lines of a text file, and errors that name a line.

    Parameters
    ----------
    name
        Of the record, as the user gave it.
    content
        The file, in UTF-8, or else in ISO 8859-1.

    Raises
    ------
    AbraceError
        If it is not a text, or empty.
    """

    def __init__(self, name: str, content: bytes) -> None:
        self.name = name
        if b"\0" in content:
            raise self.error("binary, expected a text")
        # DOS, and the old strong-motion files from it, end a text with the character 26
        try:
            text = content.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = content.decode("latin-1")  # of Windows, in which a unit may be written as m/s²
        text = text.rstrip("\x1a\r\n\t ")
        self.lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
        if not text:
            raise self.error("empty, expected a ground acceleration")

    def error(self, message: str, line: int | None = None) -> AbraceError:
        """An error with this message about a line (the first is 1), or about the whole file."""
        return record_error(self.name, message, f"line {line}" if line else "")

    def errors_at(self, lines: Sequence[int]) -> Callable[[str, int | None], AbraceError]:
        """The `error_at` of `checked_reading` for samples that are in these `lines`."""
        return lambda message, sample: self.error(message, None if sample is None else lines[sample])

    def content(self) -> list[tuple[int, str]]:
        """(line, text) of each line that holds more than a comment."""
        texts = ((line, text.partition("#")[0].strip()) for line, text in enumerate(self.lines, 1))
        found = [(line, text) for line, text in texts if text]
        if not found:
            raise self.error("empty, expected a ground acceleration")
        return found

    def number(self, word: str, line: int) -> float:
        """A word in a line as a finite number."""
        try:
            value = math.nan if "_" in word else float(word)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            point = " with a decimal point" if re.fullmatch(r"[-+]?\d+,\d+", word) else ""
            raise self.error(f"{word[:20]!r}, expected a finite number{point}", line)
        return value
