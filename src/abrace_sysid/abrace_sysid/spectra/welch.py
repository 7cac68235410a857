# SPDX-License-Identifier: Apache-2.0
"""Transfer functions by Welch's method: averages over overlapping windowed segments (Bendat and Piersol 2010, ch. 6).

This is the usual "FFT technique", included for comparison. Its segments are shorter than the record, so that its
dominant error is leakage at lightly damped modes, not noise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import fft, signal

from abrace_core import AbraceError
from abrace_sysid.spectra.fourier import lines_within
from abrace_sysid.spectra.frequency_response import FrequencyResponse

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_sysid.recorded.test import Test


def check_segment(segment: int, samples: Mapping[str, int]) -> None:
    """Check that a `segment` fits into tests of so many `samples`, by the tests' names.

    Raises
    ------
    AbraceError
        If not.
    """
    whole = sum(samples.values())
    most = min(whole // 2, *samples.values())
    if not 2 <= segment <= most:
        raise AbraceError(f"{' and '.join(samples)}: segments of {segment} in {whole} samples, expected 2 to {most}")


def welch(tests: Sequence[Test], input_name: str, band: tuple[float, float], segment: int) -> FrequencyResponse:
    """Transfer functions by Welch's method: H1, for noise in the outputs, with a Hann window and an overlap of half.

    Parameters
    ----------
    tests
        The test, or repeated ones, of any length: all their segments are averaged.
    input_name
        The input that was excited. The effect of another, uncorrelated input excited at the same time counts as noise.
    band
        Lowest and highest frequency [Hz].
    segment
        Samples in each averaged segment.

    Raises
    ------
    AbraceError
        If the tests have fewer than two segments.
    """
    check_segment(segment, {each.source: len(each.outputs) for each in tests})
    lines, omega = lines_within(tests[0], segment, band)
    power, cross, outputs, averages = _averaged(tests, input_name, lines, segment)
    response = cross / power
    sigma = np.sqrt((1 - _coherence(power, cross, outputs)) * outputs / power / max(averages - 1, 1))
    method = f"Welch, H1, hann, overlap 0.5, {segment} points"
    hold = tests[0].hold_of(input_name)
    return FrequencyResponse(input_name, tests[0].names, omega, response, sigma, tests[0].sample_period, method, hold)


def coherence_of(
    test: Test, input_name: str, band: tuple[float, float], segment: int
) -> tuple[NDArray[np.float64], float]:
    """(lines, channels) coherence of outputs with an input (Hann window, overlap 1/2), and the number of averages.

    Parameters
    ----------
    test, input_name
    band
        Lowest and highest frequency [Hz].
    segment
        Samples in each averaged segment.
    """
    lines, _ = lines_within(test, segment, band)
    power, cross, outputs, averages = _averaged((test,), input_name, lines, segment)
    return _coherence(power, cross, outputs), averages


def _averaged(
    tests: Sequence[Test], input_name: str, lines: NDArray[np.int64], segment: int
) -> tuple[NDArray[np.float64], NDArray[np.complex128], NDArray[np.float64], float]:
    """Sums of input power (lines, 1), cross spectra and output powers (lines, channels), and the number of averages."""
    taper, step, averages = signal.get_window("hann", segment), segment - segment // 2, 0.0
    power = np.zeros((len(lines), 1))
    outputs = np.zeros((len(lines), len(tests[0].names)))
    cross = np.zeros(outputs.shape, dtype=np.complex128)
    for test in tests:
        recorded = np.column_stack([test.channel(input_name), test.outputs])
        starts = range(0, len(recorded) - segment + 1, step)
        for start in starts:
            piece = recorded[start : start + segment]
            spectrum = fft.rfft((piece - piece.mean(axis=0)) * taper[:, None], axis=0)[lines]
            power += np.abs(spectrum[:, :1]) ** 2
            outputs += np.abs(spectrum[:, 1:]) ** 2
            cross += spectrum[:, :1].conj() * spectrum[:, 1:]
        averages += _independent(len(starts), taper, step)
    return power, cross, outputs, averages


def _coherence(
    power: NDArray[np.float64], cross: NDArray[np.complex128], outputs: NDArray[np.float64]
) -> NDArray[np.float64]:
    scale = power * outputs
    return np.divide(np.abs(cross) ** 2, scale, out=np.zeros_like(scale), where=scale > 0).clip(0, 1)


def _independent(segments: int, taper: NDArray[np.float64], step: int) -> float:
    """Equivalent number of independent segments of overlapping ones (Welch 1967)."""
    correlation = [
        (1 - apart / segments) * (taper[: -apart * step] @ taper[apart * step :] / (taper @ taper)) ** 2
        for apart in range(1, min(segments, -(-len(taper) // step)))
    ]
    return float(segments / (1 + 2 * sum(correlation)))
