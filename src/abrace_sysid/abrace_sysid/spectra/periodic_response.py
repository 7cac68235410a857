# SPDX-License-Identifier: Apache-2.0
"""Transfer functions from periodic tests (multisines), with the level of the noise.

P whole periods of the steady response are transformed together. The response to a periodic input, distortion included,
then appears only at every P-th line ("lines of the period"). The P - 1 lines in between contain noise and the rest of
the transient. A polynomial fitted to them removes the transient from the line in their middle, and its residual is the
noise: the fast local polynomial method (Pintelon and Schoukens 2012, sec. 7.3). The free decay of a lightly damped
mode is narrower than the lines are apart, and no polynomial: where the poles are known, it is removed before. The lines
of the period that an input excites give its transfer functions.

Period and length are found from the input: the period is the lag at which the input repeats itself, and the periodic
part ends where it no longer does. This is exact for a command, and robust for a measured acceleration.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import fft, ndimage, signal

from abrace_core import AbraceError
from abrace_sysid.recorded.series import find_period, repeats
from abrace_sysid.spectra.frequency_response import FrequencyResponse

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_sysid.recorded.test import Test


HALF_WIDTH = 2
"""The transient's polynomial is fitted to the lines in between up to this many lines of the period on either side."""

ORDER = 4
"""Greatest order of the transient's polynomial."""

EDGE = 50
"""Greatest error [samples] with which the ends of an input's periodic part are found."""

START = 4 * EDGE
"""Samples at the beginning of the dropped periods from which no free decay is estimated."""

SAME_PERIOD = 0.05
"""An input repeats itself if its mean square difference from itself a period later is below this share of its mean
square."""

LEAST_AMPLITUDE = 0.01
"""A line is excited only if its amplitude is at least this share of the input's strongest line."""

CERTAIN = 5.0
"""A line is excited only if its amplitude is at least this many standard deviations of the noise."""


def periodic_response(
    test: Test,
    input_name: str,
    band: tuple[float, float],
    poles: NDArray[np.complex128] | None = None,
) -> FrequencyResponse:
    """Transfer functions from a periodic input at the lines that it excites; their standard deviation is the noise's.

    Other inputs may run at the same time with the same period, on other lines. The first period is left out: the
    slowest mode's transient decays in it.

    Parameters
    ----------
    test, input_name
    band
        Lowest and highest frequency [Hz].
    poles
        Of modes [rad/s], one of each pair, whose free decay is estimated from the differences of periods and removed;
        None: the poles are not known.

    Raises
    ------
    AbraceError
        If the input is not periodic, too few periods are left, or another input excites the same lines.
    """
    names = (input_name, *(name for name in test.inputs if name != input_name))
    inputs = test.channels(names)
    period_samples, periods, last, repeating = _whole_periods(test.source, names, inputs)
    recorded = np.hstack([inputs, test.outputs])[max(0, last - (periods + 1) * period_samples) : last]
    if poles is not None:
        recorded = recorded - _free_decay(recorded, period_samples, poles * test.sample_period)
    recorded = recorded[-periods * period_samples :]
    spectra = fft.fft(recorded, axis=0) * (np.sqrt(2) / len(recorded))

    frequency = np.arange(1, (period_samples + 1) // 2) / (period_samples * test.sample_period)
    lines = 1 + np.flatnonzero((frequency >= band[0]) & (frequency <= band[1]))
    if not len(lines):
        raise AbraceError(f"{test.source}: no line of the period between {band[0]:g} and {band[1]:g} Hz")
    steady, left_over, uncertainty = _without_transient(spectra, lines, periods)
    count = len(names)
    noise = np.sqrt(np.mean(np.abs(left_over) ** 2, axis=1)) * uncertainty
    least = np.maximum(
        CERTAIN * np.sqrt(np.mean(noise[:, :count] ** 2, axis=0)),
        LEAST_AMPLITUDE * np.abs(spectra[periods::periods, :count]).max(axis=0),
    )
    exciting = (np.abs(steady[:, :count]) > least) & repeating
    excited = exciting[:, 0]
    if not excited.any():
        raise AbraceError(f"{test.source}: {input_name} excites no line between {band[0]:g} and {band[1]:g} Hz")
    shared = np.argwhere(exciting[:, 1:] & excited[:, None])
    if len(shared):
        raise AbraceError(
            f"{test.source}: {input_name} and {names[1 + shared[0, 1]]} both excite the line at "
            f"{frequency[lines[shared[0, 0]] - 1]:.4g} Hz, expected inputs on different lines"
        )

    excitation, outputs = steady[excited, :1], steady[excited, count:]
    response = outputs / excitation
    # the response's error is that of the outputs minus the response to the measured input's error
    errors = left_over[excited][:, :, count:] - response[:, None] * left_over[excited][:, :, :1]
    sigma = np.sqrt(np.mean(np.abs(errors) ** 2, axis=1)) * uncertainty / np.abs(excitation)
    method = f"multisine, {periods} periods of {period_samples} samples, 1 dropped"
    omega = 2 * np.pi * frequency[lines[excited] - 1]
    return FrequencyResponse(input_name, test.names, omega, response, sigma, test.sample_period, method)


def _whole_periods(
    source: str, names: tuple[str, ...], inputs: NDArray[np.float64]
) -> tuple[int, int, int, list[bool]]:
    """Samples in the longest period, periods to use, the sample after the last, and which inputs are periodic."""
    flattened = signal.detrend(inputs, axis=0)
    period_samples = max(find_period(excitation) or 0 for excitation in flattened.T)
    repeating = [repeats(excitation, period_samples) for excitation in flattened.T]
    if not repeating[0]:
        found = f"after {period_samples} samples" if period_samples else "after any time"
        raise AbraceError(f"{source}: {names[0]} does not repeat itself {found}, expected a periodic input")
    first, last = _periodic_part(flattened[:, repeating], period_samples)
    periods = max(0, last - first + 2 * EDGE) // period_samples - 1
    if periods < 2:
        raise AbraceError(
            f"{source}: {names[0]} lasts {max(0, last - first)} samples with a period of {period_samples}, "
            "expected at least 3 periods, of which 1 is dropped"
        )
    return period_samples, periods, last, repeating


def _periodic_part(inputs: NDArray[np.float64], period: int) -> tuple[int, int]:
    """First sample, and the one after the last, of the part in which all inputs (samples, inputs) are periodic."""
    first, last = 0, len(inputs)
    for excitation in inputs.T:
        before, after = excitation[:-period], excitation[period:]
        difference = ndimage.uniform_filter1d((after - before) ** 2, EDGE, mode="nearest")
        parts, count = ndimage.label(difference < SAME_PERIOD * (before @ before) / len(before))
        if not count:
            return 0, 0
        # rest is periodic as well, but its power is zero
        moves = ndimage.sum_labels(before * after, parts, np.arange(1, count + 1))
        (part,) = ndimage.find_objects(parts)[int(np.argmax(moves))]
        first, last = max(first, part.start), min(last, part.stop + period)
    return first, last


def _free_decay(recorded: NDArray[np.float64], period: int, exponents: NDArray[np.complex128]) -> NDArray[np.float64]:
    """(samples, channels) the free decay of modes in the response to a periodic input.

    The periodic part of a channel cancels in its difference from itself a period later; the decay of each mode remains,
    times a known factor, and is found by least squares.

    Parameters
    ----------
    recorded
        (samples, channels); the input may become periodic up to START samples after the first.
    exponents
        (modes,) poles times the sample period.
    """
    motion = np.exp(np.arange(len(recorded))[:, None] * exponents)
    columns = np.hstack([motion.real, -motion.imag])
    apart = recorded[START + period :] - recorded[START:-period]
    parts = np.linalg.lstsq(columns[START:-period], apart, rcond=None)[0]
    amplitudes = (parts[: len(exponents)] + 1j * parts[len(exponents) :]) / np.expm1(period * exponents)[:, None]
    return np.asarray(columns @ np.vstack([amplitudes.real, amplitudes.imag]))


def _without_transient(
    spectra: NDArray[np.complex128], lines: NDArray[np.int64], periods: int
) -> tuple[NDArray[np.complex128], NDArray[np.complex128], float]:
    """Steady spectra at the lines of the period, residuals at the lines in between, and the factor from these to error.

    Shapes (lines, channels) and (lines, lines in between, channels).
    """
    offsets = np.arange(-HALF_WIDTH * periods, HALF_WIDTH * periods + 1)
    offsets = offsets[offsets % periods != 0]
    order = min(ORDER, len(offsets) - 2)
    q, r = np.linalg.qr((offsets / offsets.max())[:, None] ** np.arange(order + 1))
    between = spectra[(lines[:, None] * periods + offsets) % len(spectra)]
    at_line = np.linalg.solve(r, q.T)[0]
    steady = spectra[lines * periods] - np.einsum("j,ljc->lc", at_line, between)
    left_over = between - np.einsum("jk,lkc->ljc", q @ q.T, between)
    freedom = 1 - (order + 1) / len(offsets)
    return steady, left_over, float(np.sqrt((1 + at_line @ at_line) / freedom))
