# SPDX-License-Identifier: Apache-2.0
"""What is computed of a channel's samples: transform, power, period, and whether two channels are one signal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import fft

if TYPE_CHECKING:
    from numpy.typing import NDArray

LEAST_CORRELATION = 0.4
"""Least correlation of an input with itself a period later; two periods between long rests have 0.5."""

SAME_REALIZATION = 0.8
"""The inputs of two tests are the same realization if their correlation is at least this; with other phases it is near
0.1."""


def find_period(excitation: NDArray[np.float64]) -> int | None:
    """The period [samples] of a signal, or None if it is not periodic.

    The period is the lag of the greatest autocorrelation beyond the first lag at which it is negative.

    Parameters
    ----------
    excitation
        (samples,) of mean zero; may begin and end with rest.
    """
    length = fft.next_fast_len(2 * len(excitation), real=True)
    correlation = fft.irfft(np.abs(fft.rfft(excitation, length)) ** 2, length)[: len(excitation)]
    negative = np.flatnonzero(correlation < 0)
    if not len(negative):
        return None
    lag = int(negative[0] + np.argmax(correlation[negative[0] :]))
    return lag if repeats(excitation, lag) else None


def same_realization(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Whether two tests' inputs are the same signal, apart from level and time of beginning.

    Parameters
    ----------
    one, other
        (samples,) each.
    """
    length = fft.next_fast_len(len(one) + len(other), real=True)
    correlation = fft.irfft(fft.rfft(one, length) * fft.rfft(other, length).conj(), length)
    size = np.sqrt((one @ one) * (other @ other))
    shorter, longer = sorted((len(one), len(other)))
    return bool(np.abs(correlation).max() > SAME_REALIZATION * size * np.sqrt(shorter / longer))


def repeats(excitation: NDArray[np.float64], period: int) -> bool:
    """Whether an `excitation` (samples,) has two periods of `period` samples; it may begin and end with rest."""
    if not 0 < period < len(excitation):
        return False
    before, after = excitation[:-period], excitation[period:]
    return bool(before @ after > LEAST_CORRELATION * np.sqrt((before @ before) * (after @ after)))


def transform(series: NDArray[np.float64]) -> NDArray[np.complex128]:
    """(lines, columns) transform of `series` (samples, columns), means removed, over the square root of the length."""
    transformed: NDArray[np.complex128] = fft.rfft(series - series.mean(axis=0), axis=0)
    return transformed / np.sqrt(len(series))


def hann_power(series: NDArray[np.float64]) -> NDArray[np.float64]:
    """(lines, columns) power of `series` (samples, columns) with a Hann window; of white noise its variance."""
    window = np.hanning(len(series))[:, None]
    return np.asarray(np.abs(fft.rfft(series * window, axis=0)) ** 2 / np.sum(window**2))
