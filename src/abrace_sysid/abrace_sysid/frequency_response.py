"""Transfer functions from recorded white-noise tests: Welch's method and the local polynomial method.

The paper's "FFT technique" behind Figs. 3 to 5. What is estimated is the response of the *sampled* rig: from an input's
value at each sample (a command held until the next, a ground acceleration linear in between) to the recorded outputs.
Lightly damped modes make leakage, not noise, the error that matters; the local polynomial method models it away.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import fft, signal

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_core.run import Run

LINES_AT_ONCE = 1024
"""Frequency lines that the local polynomial method solves together; bounds its memory."""


@dataclass(frozen=True)
class FrequencyResponse:
    """A measured transfer function from one input to several outputs.

    Parameters
    ----------
    input
        Name of the input.
    outputs
        Names of the outputs.
    omega
        (lines,) [rad/s], rising.
    response
        (lines, channels) complex, of the sampled rig: hold and delays included.
    sigma
        (lines, channels) standard deviation of `response`.
    sample_period
        Seconds.
    method
        How it was estimated, in words.
    """

    input: str
    outputs: tuple[str, ...]
    omega: NDArray[np.float64]
    response: NDArray[np.complex128]
    sigma: NDArray[np.float64]
    sample_period: float
    method: str

    def select(self, outputs: Sequence[str]) -> FrequencyResponse:
        """The same estimate with only these outputs, in this order."""
        columns = [self.outputs.index(name) for name in outputs]
        return replace(self, outputs=tuple(outputs), response=self.response[:, columns], sigma=self.sigma[:, columns])

    def divided_by(self, factor: NDArray[np.complex128]) -> FrequencyResponse:
        """The response with a known factor (lines,), such as a hold's, taken out."""
        return replace(self, response=self.response / factor[:, None], sigma=self.sigma / np.abs(factor)[:, None])


def held_input(run: Run, name: str) -> NDArray[np.float64]:
    """(samples,) the input `name` of `run`: the ground acceleration at each sample, or the command from it on."""
    if name in run.command_names:
        return run.command_from_here[:, run.command_names.index(name)]
    return run.channels([name])[:, 0]


def local_polynomial(
    run: Run, input_name: str, band: tuple[float, float], order: int = 4, half_width: int = 6
) -> FrequencyResponse:
    """Transfer functions by the local polynomial method (Schoukens et al. 2009; Pintelon and Schoukens 2012, sec. 7.2).

    About each line of the whole record's discrete Fourier transform, the response and the transient (leakage) are
    polynomials of the line number, found together by least squares; what is left over is noise.

    Parameters
    ----------
    run
        The test.
    input_name
        The input that was excited.
    band
        Lowest and highest frequency [Hz]; the input must be excited throughout.
    order
        Of both polynomials.
    half_width
        Lines on either side; 2 half_width + 1 of them carry 2 (order + 1) unknowns.

    Raises
    ------
    AbraceError
        If the window has too few lines, or the band has fewer lines than the window.
    """
    window, unknowns = 2 * half_width + 1, 2 * (order + 1)
    if order < 0 or window <= unknowns:
        expected = f"order >= 0 and half_width >= {max(order, 0) + 1}"
        raise AbraceError(f"local polynomial method: order {order} and half_width {half_width}, expected {expected}")
    lines, omega = _lines_within(run, len(run.outputs), band)
    if len(lines) < window:
        seconds = window / (band[1] - band[0])
        raise AbraceError(
            f"{run.source}: {len(run.outputs) * run.sample_period:g} s, expected at least {seconds:.0f} s"
        )
    excitation, outputs = _spectra(held_input(run, input_name), run.outputs)

    channels = outputs.shape[1]
    response = np.empty((len(lines), channels), dtype=np.complex128)
    sigma = np.empty((len(lines), channels))
    # windows are shifted inwards at the ends of the band, where the polynomials are evaluated off their centre
    first = np.clip(lines - half_width, lines[0], lines[-1] - window + 1)
    for start in range(0, len(lines), LINES_AT_ONCE):
        block = slice(start, start + LINES_AT_ONCE)
        inside = first[block, None] + np.arange(window)
        offset = (inside - lines[block, None]) / half_width
        powers = offset[:, :, None] ** np.arange(order + 1)
        regressors = np.concatenate([powers * excitation[inside][:, :, None], powers], axis=2)
        scale = np.linalg.norm(regressors, axis=1)
        q, r = np.linalg.qr(regressors / scale[:, None, :])
        measured = outputs[inside]
        projected = np.swapaxes(q.conj(), 1, 2) @ measured
        left_over = np.linalg.norm(measured - q @ projected, axis=1) / np.sqrt(window - unknowns)
        # the response at the line itself is the first unknown: its row of the inverse of R
        unit = np.zeros((unknowns, 1), dtype=np.complex128)
        unit[0] = 1.0
        row = np.linalg.solve(np.swapaxes(r, 1, 2), np.broadcast_to(unit, (len(r), unknowns, 1)))[:, :, 0]
        response[block] = np.einsum("lu,luc->lc", row, projected) / scale[:, :1]
        sigma[block] = np.linalg.norm(row, axis=1)[:, None] * left_over / scale[:, :1]
    method = f"local polynomial method, order {order}, half-width {half_width}"
    return FrequencyResponse(input_name, run.names, omega, response, sigma, run.sample_period, method)


def welch(run: Run, input_name: str, band: tuple[float, float], segment: int = 32768) -> FrequencyResponse:
    """Transfer functions by Welch's method: H1, Hann window, half overlap.

    Parameters
    ----------
    run
        The test.
    input_name
        The input that was excited.
    band
        Lowest and highest frequency [Hz].
    segment
        Samples in each averaged piece.

    Raises
    ------
    AbraceError
        If the test is shorter than two segments.
    """
    samples = len(run.outputs)
    if not 2 <= segment <= samples // 2:
        raise AbraceError(f"{run.source}: segments of {segment} in {samples} samples, expected 2 to {samples // 2}")
    lines, omega = _lines_within(run, segment, band)
    excitation = held_input(run, input_name)
    rate = 1 / run.sample_period
    _, power = signal.welch(excitation, rate, "hann", segment)
    _, cross = signal.csd(excitation[:, None], run.outputs, rate, "hann", segment, axis=0)
    _, outputs = signal.welch(run.outputs, rate, "hann", segment, axis=0)
    power, cross, outputs = power[lines], cross[lines], outputs[lines]
    response = cross / power[:, None]
    unexplained = np.maximum(outputs - np.abs(cross) ** 2 / power[:, None], 0.0)
    averages = 2 * samples / segment - 1
    sigma = np.sqrt(unexplained / power[:, None] / averages)
    method = f"Welch, H1, Hann, half overlap, {segment} points"
    return FrequencyResponse(input_name, run.names, omega, response, sigma, run.sample_period, method)


def _lines_within(run: Run, samples: int, band: tuple[float, float]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Numbers and angular frequencies of the lines of a transform of so many samples within a band [Hz]."""
    frequency = np.arange(samples // 2) / (samples * run.sample_period)
    lines = np.flatnonzero((frequency >= band[0]) & (frequency <= band[1]) & (frequency > 0))
    if not len(lines):
        raise AbraceError(f"{run.source}: no frequency line between {band[0]:g} and {band[1]:g} Hz")
    return lines, 2 * np.pi * frequency[lines]


def _spectra(
    excitation: NDArray[np.float64], outputs: NDArray[np.float64]
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Transforms of the whole record without its mean, scaled by the square root of its length."""
    scale = 1 / np.sqrt(len(excitation))
    return (
        fft.rfft(excitation - excitation.mean()) * scale,
        fft.rfft(outputs - outputs.mean(axis=0), axis=0) * scale,
    )
