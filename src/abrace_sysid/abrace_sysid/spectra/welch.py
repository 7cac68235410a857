# SPDX-License-Identifier: Apache-2.0
"""Transfer functions by Welch's method: averages over overlapping windowed segments (Bendat and Piersol 2010, ch. 6).

This is the usual "FFT technique", included for comparison. Its segments are shorter than the record, so that its
dominant error is leakage at lightly damped modes, not noise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy import fft, signal

from abrace_core.errors import AbraceError
from abrace_sysid.spectra.fourier import Test, held_input, lines_within, runs_of_one_rig
from abrace_sysid.spectra.frequency_response import FrequencyResponse
from abrace_sysid.spectra.holds import hold_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_core.run import Run
    from abrace_sysid.measured_data import MeasuredData

Estimator = Literal["H1", "H2", "Hv"]


def welch(
    run: Test | Sequence[Test],
    input_name: str,
    band: tuple[float, float],
    segment: int = 32768,
    estimator: Estimator = "H1",
    window: str = "hann",
    overlap: float = 0.5,
) -> FrequencyResponse:
    """Transfer functions by Welch's method.

    Parameters
    ----------
    run
        The test, or repeated ones, of any length: all their segments are averaged.
    input_name
        The input that was excited. The effect of another, uncorrelated input excited at the same time counts as noise.
    band
        Lowest and highest frequency [Hz].
    segment
        Samples in each averaged segment.
    estimator
        "H1": for noise in the outputs; "H2": for noise in the input; "Hv": for both, the geometric mean of H1 and H2.
    window
        Name of a window of scipy.signal.get_window.
    overlap
        Share by which neighbouring segments overlap, from 0 to less than 1.

    Raises
    ------
    AbraceError
        If the tests have fewer than two segments, or an option is not one of those above.
    """
    runs = runs_of_one_rig(run)
    samples = sum(len(each.outputs) for each in runs)
    source = " and ".join(each.source for each in runs)
    if not (2 <= segment <= samples // 2 and all(segment <= len(each.outputs) for each in runs)):
        raise AbraceError(f"{source}: segments of {segment} in {samples} samples, expected 2 to {samples // 2}")
    if estimator not in ("H1", "H2", "Hv"):
        raise AbraceError(f"Welch's method: estimator {estimator!r}, expected 'H1', 'H2' or 'Hv'")
    if not 0 <= overlap < 1:
        raise AbraceError(f"Welch's method: overlap {overlap:g}, expected 0 to less than 1")
    try:
        taper = signal.get_window(window, segment)
    except ValueError as cause:
        raise AbraceError(f"Welch's method: window {window!r}, expected one of scipy.signal.get_window") from cause
    lines, omega = lines_within(runs[0], segment, band)
    shared = int(overlap * segment)

    power, cross, outputs, averages = _averaged(runs, input_name, lines, taper, segment - shared)
    coherence = _coherence(power, cross, outputs)
    response = cross / power
    sigma = np.sqrt((1 - coherence) * outputs / power / max(averages - 1, 1))
    if estimator != "H1":
        excess = np.sqrt(coherence) if estimator == "Hv" else coherence
        ratio = np.divide(1.0, excess, out=np.full_like(excess, np.inf), where=excess > 0)
        response, sigma = response * ratio, sigma * ratio
    method = f"Welch, {estimator}, {window}, overlap {overlap:g}, {segment} points"
    hold = hold_of(runs[0], input_name)
    return FrequencyResponse(input_name, runs[0].names, omega, response, sigma, runs[0].sample_period, method, hold)


def coherence_of(
    run: Run | MeasuredData, input_name: str, band: tuple[float, float], segment: int
) -> tuple[NDArray[np.float64], float]:
    """(lines, channels) coherence of outputs with an input (Hann window, overlap 1/2), and the number of averages.

    Parameters
    ----------
    run
        The test.
    input_name
        The input.
    band
        Lowest and highest frequency [Hz].
    segment
        Samples in each averaged segment.
    """
    lines, _ = lines_within(run, segment, band)
    taper = signal.get_window("hann", segment)
    power, cross, outputs, averages = _averaged((run,), input_name, lines, taper, segment // 2)
    return _coherence(power, cross, outputs), averages


def _averaged(
    runs: tuple[Run | MeasuredData, ...],
    input_name: str,
    lines: NDArray[np.int64],
    taper: NDArray[np.float64],
    step: int,
) -> tuple[NDArray[np.float64], NDArray[np.complex128], NDArray[np.float64], float]:
    """Sums of input power (lines, 1), cross spectra and output powers (lines, channels), and the number of averages."""
    segment, averages = len(taper), 0.0
    power = np.zeros((len(lines), 1))
    outputs = np.zeros((len(lines), len(runs[0].names)))
    cross = np.zeros(outputs.shape, dtype=np.complex128)
    for run in runs:
        recorded = np.column_stack([held_input(run, input_name), run.outputs])
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
