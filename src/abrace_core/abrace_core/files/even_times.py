# SPDX-License-Identifier: Apache-2.0
"""The sample period of printed times: rounded ones have equal steps within half of the last digit printed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from abrace_core import AbraceError

TOLERANCE = 0.02
"""Greatest deviation of times from equal steps beyond their rounding, in steps; a missing sample is a whole one."""


_WRITTEN = str.maketrans(",d", ".e")
"""A decimal comma, and Fortran's D for an exponent."""
LEAST_PRECISE = 3
"""Times at the beginning that have to be printed so well that they cannot hide a missing sample."""
HIDES = 0.22
"""Share of a step: a sample that is missing moves times by a quarter of a step from the nearest even ones."""


def half_last_digits(texts: Sequence[str]) -> NDArray[np.float64]:
    """(samples,) half of the last digit printed in `texts`, also where zeros at the end were left out, as %g does.

    >>> half_last_digits(["99.955", "100.01"]).tolist()
    [0.0005, 0.005]
    """
    decimals, digits, powers = 0, 1, []
    for text in texts:
        mantissa, _, exponent = text.strip().lower().lstrip("+-").translate(_WRITTEN).partition("e")
        whole, _, fraction = mantissa.partition(".")
        power = int(exponent[:6]) if exponent.lstrip("+-").isdecimal() else 0
        decimals = max(decimals, len(fraction) - power)
        significant = (whole + fraction).lstrip("0")
        digits = max(digits, len(significant))
        powers.append(len(significant) - len(fraction) + power if significant else -300)
    rounded = 10.0 ** (np.array(powers, dtype=np.float64) - digits)
    return np.asarray(0.5 * np.maximum(rounded, 10.0 ** min(-decimals, 0)), dtype=np.float64)


def even_step(
    times: NDArray[np.float64],
    half: NDArray[np.float64] | float,
    given: float | None,
    error_at: Callable[[str, int | None], AbraceError],
) -> float:
    """The step of evenly spaced `times` [s].

    Parameters
    ----------
    times, half
        (samples,) and half of their last printed digits.
    given
        The step that the user gives: it decides where it fits the times. Otherwise the roundest rate or step that fits.
    error_at
        Makes the error of a message about a sample (the first is 0), or about all (None).

    Raises
    ------
    AbraceError
        If times do not rise, or no step fits.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        half = np.broadcast_to(np.minimum(half, 0.49 * np.abs(times[-1] - times[0])), times.shape)
        mean = float((times[-1] - times[0]) / max(len(times) - 1, 1))
        if not (math.isfinite(mean) and mean > 0):
            raise error_at("times that do not increase, expected equal steps", len(times) - 1)
        spread = (half[0] + half[-1] + 4 * np.spacing(np.abs(times).max())) / (len(times) - 1)
        if given is not None:
            if _fits(times, half, given):
                return given
            raise error_at(f"sample period {mean:g} s by its times, {given:g} s was given", None)
        found = next((step for step in _candidates(mean, spread) if _fits(times, half, step)), None)
        steps = np.diff(times)
        if found is None or (np.ptp(steps) > TOLERANCE * found and (half[:LEAST_PRECISE] > HIDES * found).any()):
            found = mean
            if not _fits(times, np.zeros_like(half), mean):
                usual = float(np.median(steps))
                worst = int(np.argmax(np.abs(steps - usual) - half[1:] - half[:-1])) + 1
                raise error_at(f"time step {steps[worst - 1]:g} s, expected equal steps of {usual:g} s", worst)
    return found


def _fits(times: NDArray[np.float64], half: NDArray[np.float64], step: float) -> bool:
    off = times - times[0] - step * np.arange(len(times))
    room = half + TOLERANCE * step
    return bool((off - room).max() <= (off + room).min())


def _candidates(mean: float, spread: float) -> list[float]:
    """Rates [1/s] and steps [s] of few digits within the spread, the roundest and then the nearest first."""
    found = []
    for digits in range(1, 7):
        step = float(f"{mean:.{digits - 1}e}")
        rate = float(f"{1 / mean:.{digits - 1}e}")
        power = 2.0 ** round(math.log2(1 / mean))
        for each, rank in ((1 / rate, digits), (step, digits), (1 / power, 2)):
            if each > 0 and abs(each - mean) <= spread:
                found.append((rank, abs(each - mean), each))
    return [each for _, _, each in sorted(found)]
