# SPDX-License-Identifier: Apache-2.0
"""The sample period of times in a table: rounded ones have equal steps within half of the last digit printed.

To others a slope is fitted (`sample_times`): what is wrong with them is an error, or a warning where no sample can be
missing.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.files.sample_times import sample_times

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from abrace_core import AbraceError

TOLERANCE = 0.02
"""Greatest deviation of times from equal steps beyond their rounding, in steps; a missing sample is a whole one."""

SHOWS = 0.6
"""Greatest departure that jitter explains where a missing sample, which is a whole step, shows, in steps."""
GIVEN = 0.5
"""Greatest departure of the last time by a step that the user gives for times that are not even, in steps."""
LEAST_WRONG = 30
"""Times among which single ones may be wrong."""

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
) -> tuple[float, dict[int, str]]:
    """The step of evenly spaced `times` [s].

    Parameters
    ----------
    times, half
        (samples,) and half of their last printed digits.
    given
        The step that the user gives: it decides where it fits the times. Otherwise the roundest rate or step that fits.
    error_at
        Makes the error of a message about a sample (the first is 0), or about all (None).

    Returns
    -------
    tuple
        The step [s], and by sample what is wrong with times although no sample is missing: a counter wraps, single
        times are late, repeated or impossible, or steps differ a little.

    Raises
    ------
    AbraceError
        If times do not rise, no step fits, or a sample may be missing.
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        half = np.broadcast_to(np.minimum(half, 0.49 * np.abs(times[-1] - times[0])), times.shape)
        mean = float((times[-1] - times[0]) / max(len(times) - 1, 1))
        if math.isfinite(mean) and mean > 0:
            spread = (half[0] + half[-1] + 4 * np.spacing(np.abs(times).max())) / (len(times) - 1)
            candidates = _candidates(mean, spread) if given is None else [given]
            found = next((step for step in candidates if _fits(times, half, step)), None)
            uneven = found is not None and np.ptp(np.diff(times)) > TOLERANCE * found
            if found is not None and (
                given is not None or not (uneven and (half[:LEAST_PRECISE] > HIDES * found).any())
            ):
                return found, {}
        return _fitted_step(times, half, given, error_at)


def _fitted_step(
    times: NDArray[np.float64],
    half: NDArray[np.float64],
    given: float | None,
    error_at: Callable[[str, int | None], AbraceError],
) -> tuple[float, dict[int, str]]:
    """As `even_step`, where no step fits all times."""
    rounding = float(np.median(half))
    found = sample_times(times, resolution=2 * rounding)
    steps = np.diff(times)
    if not found.period > 0:
        falls = np.flatnonzero(~(steps > 0))
        at = (
            f" after sample {falls[0]}, from {times[falls[0]]:.6g} to {times[falls[0] + 1]:.6g} s" if len(falls) else ""
        )
        what = "times that fall" if len(falls) and np.median(steps) < 0 else "times that do not increase"
        raise error_at(f"{what}{at}, expected equal steps", int(falls[0]) + 1 if len(falls) else len(times) - 1)
    for fault in found.faults:
        if fault.kind in ("step", "drift", "uneven"):
            raise error_at(fault.text, fault.sample)
    period = found.period
    if given is not None:
        if abs(given - period) * (len(times) - 1) > GIVEN * period:
            raise error_at(f"sample period {period:g} s by its times, {given:g} s was given", None)
        period = given
    usual = float(np.median(steps))
    worst = int(np.argmax(np.abs(steps - usual) - half[1:] - half[:-1])) + 1
    few, differ = bool(found.faults) and len(times) < LEAST_WRONG, found.step_error > TOLERANCE * period
    if (differ and rounding > HIDES * period) or found.hidden > SHOWS * period or few:
        raise error_at(f"time step {steps[worst - 1]:.6g} s, expected equal steps of {period:.4g} s", worst)
    wrong = {fault.sample: fault.text for fault in found.faults}
    if found.step_error > 2 * (rounding + TOLERANCE * period):
        text = f"time steps depart from {period:.4g} s by up to {100 * found.step_error / period:.2g} %"
        wrong.setdefault(worst, f"{text}: the samples are taken as even")
    return period, wrong


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
