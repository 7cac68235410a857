# SPDX-License-Identifier: Apache-2.0
"""Transfer functions from periodic tests (multisines), with the levels of noise and of nonlinear distortion.

Whole periods of the steady response are transformed together. The response to a periodic input, distortion included,
is then at every P-th line, where P is the number of periods; the P - 1 lines in between hold noise and what is left of
the transient. A polynomial through them takes the transient out of the line in their middle, and what is left over is
noise: the fast local polynomial method (Pintelon and Schoukens 2012, sec. 7.3). Of the lines of the period, those that
an input excites give its transfer functions, and those that none excites show nonlinear distortion.

Lines and samples follow from the input itself: the period is the lag at which it repeats itself, and the test ends
where it no longer does. That is exact for a command, and safe for an acceleration that was measured.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import fft, ndimage, signal

from abrace_core import signals
from abrace_core.errors import AbraceError
from abrace_sysid.spectra.distortion import distortion_beside
from abrace_sysid.spectra.fourier import held_input
from abrace_sysid.spectra.frequency_response import FrequencyResponse

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.run import Run

HALF_WIDTH = 2
"""Lines of the period on either side up to which the lines in between carry the transient's polynomial."""

ORDER = 4
"""Of the transient's polynomial at most."""

EDGE = 50
"""Greatest error, in samples, of the ends found of an input's periodic part."""

ALIKE = 0.05
"""Greatest mean square difference of an input from itself a period later, as a share of its mean square."""

LEAST_CORRELATION = 0.4
"""Least correlation of an input with itself a period later; two periods between long rests have 0.5."""

SAME = 0.8
"""Least correlation of two tests' inputs that are the same realization; of other phases it is near 0.1."""

LEAST_AMPLITUDE = 0.01
"""Share of an input's strongest line below which a line counts as not excited."""

CERTAIN = 5.0
"""Least amplitude of an excited line, in standard deviations of the noise."""


@dataclass(frozen=True)
class PeriodicResponse:
    """The response to one input from a periodic test, with levels of noise and distortion.

    The levels are root mean squares in each channel's unit, of as many lines as the input excites. They include the
    noise: in a linear test `even_distortion` and `odd_distortion` are as low as `noise`.

    Parameters
    ----------
    frequency_response
        At the excited lines; the standard deviation is that of the noise.
    periods
        That were used.
    period_samples
        Samples in a period.
    level
        (channels,) of the response at the excited lines.
    noise
        (channels,) of the noise at a line of the period.
    even_distortion, odd_distortion
        (channels,) of the even and the odd lines that no input excites; NaN where there is none.
    """

    frequency_response: FrequencyResponse
    periods: int
    period_samples: int
    level: NDArray[np.float64]
    noise: NDArray[np.float64]
    even_distortion: NDArray[np.float64]
    odd_distortion: NDArray[np.float64]


def periodic_response(
    run: Run, input_name: str, band: tuple[float, float], period_samples: int | None = None, dropped: int = 1
) -> PeriodicResponse:
    """Transfer functions from a periodic input at the lines that it excites.

    Other inputs may run at the same time with the same period, on other lines.

    Parameters
    ----------
    run
        The test, its samples consecutive.
    input_name
        The periodic input.
    band
        Lowest and highest frequency [Hz].
    period_samples
        Samples in a period; None: the longest period found in any input. (An input of even lines alone repeats itself
        after half a period: give the whole period.)
    dropped
        Periods left out at the beginning, at least 1: until the slowest mode's transient has decayed.

    Raises
    ------
    AbraceError
        If the input is not periodic, too few periods are left, or another input excites the same lines.
    """
    if dropped < 1:
        raise AbraceError(f"periodic response: {dropped} periods dropped, expected at least 1")
    names = (input_name, *(name for name in (signals.GROUND, *run.command_names) if name != input_name))
    inputs = np.column_stack([held_input(run, name) for name in names])
    period_samples, periods, last, repeating = _whole_periods(run.source, names, inputs, period_samples, dropped)
    recorded = np.hstack([inputs, run.outputs])[last - periods * period_samples : last]
    spectra = fft.fft(recorded, axis=0) * (np.sqrt(2) / len(recorded))

    frequency = np.arange(1, (period_samples + 1) // 2) / (period_samples * run.sample_period)
    lines = 1 + np.flatnonzero((frequency >= band[0]) & (frequency <= band[1]))
    if not len(lines):
        raise AbraceError(f"{run.source}: no line of the period between {band[0]:g} and {band[1]:g} Hz")
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
        raise AbraceError(f"{run.source}: {input_name} excites no line between {band[0]:g} and {band[1]:g} Hz")
    shared = np.argwhere(exciting[:, 1:] & excited[:, None])
    if len(shared):
        raise AbraceError(
            f"{run.source}: {input_name} and {names[1 + shared[0, 1]]} both excite the line at "
            f"{frequency[lines[shared[0, 0]] - 1]:.4g} Hz, expected inputs on different lines"
        )

    excitation, outputs = steady[excited, :1], steady[excited, count:]
    response = outputs / excitation
    # the error of a line is that of the outputs less the response to the error of the measured input
    errors = left_over[excited][:, :, count:] - response[:, None] * left_over[excited][:, :, :1]
    sigma = np.sqrt(np.mean(np.abs(errors) ** 2, axis=1)) * uncertainty / np.abs(excitation)
    unexcited = ~exciting.any(axis=1)
    method = f"multisine, {periods} periods of {period_samples} samples, {dropped} dropped"
    omega = 2 * np.pi * frequency[lines[excited] - 1]

    def level(which: NDArray[np.bool_], amplitudes: NDArray[np.float64]) -> NDArray[np.float64]:
        """(channels,) root mean square over the lines `which`, scaled to as many lines as are excited."""
        if not which.any():
            return np.full(amplitudes.shape[1] - count, np.nan)
        power = np.mean(amplitudes[which, count:] ** 2, axis=0) * np.count_nonzero(excited)
        return np.asarray(np.sqrt(power))

    beside = distortion_beside(lines, np.abs(steady[:, count:]), np.abs(excitation[:, 0]), excited, unexcited)
    return PeriodicResponse(
        FrequencyResponse(input_name, run.names, omega, response, sigma, run.sample_period, method, distortion=beside),
        periods,
        period_samples,
        level(excited, np.abs(steady)),
        level(excited, noise),
        level(unexcited & (lines % 2 == 0), np.abs(steady)),
        level(unexcited & (lines % 2 == 1), np.abs(steady)),
    )


def find_period(excitation: NDArray[np.float64]) -> int | None:
    """The samples after which a signal repeats itself, or None.

    It is the lag at which the correlation of the signal with itself, after it has first fallen below zero, is greatest.

    Parameters
    ----------
    excitation
        (samples,) of mean zero, rest before and after included.
    """
    length = fft.next_fast_len(2 * len(excitation), real=True)
    correlation = fft.irfft(np.abs(fft.rfft(excitation, length)) ** 2, length)[: len(excitation)]
    negative = np.flatnonzero(correlation < 0)
    if not len(negative):
        return None
    lag = int(negative[0] + np.argmax(correlation[negative[0] :]))
    return lag if _repeats(excitation, lag) else None


def same_realization(one: NDArray[np.float64], other: NDArray[np.float64]) -> bool:
    """Whether two tests' inputs are the same signal, begun at any time and of any level.

    Parameters
    ----------
    one, other
        (samples,) each.
    """
    length = fft.next_fast_len(len(one) + len(other), real=True)
    correlation = fft.irfft(fft.rfft(one, length) * fft.rfft(other, length).conj(), length)
    size = np.sqrt((one @ one) * (other @ other))
    shorter, longer = sorted((len(one), len(other)))
    return bool(np.abs(correlation).max() > SAME * size * np.sqrt(shorter / longer))


def _whole_periods(
    source: str, names: tuple[str, ...], inputs: NDArray[np.float64], period_samples: int | None, dropped: int
) -> tuple[int, int, int, list[bool]]:
    """Samples in a period, periods to use, the sample after them, and which inputs repeat themselves."""
    flattened = signal.detrend(inputs, axis=0)
    if period_samples is None:
        period_samples = max(find_period(excitation) or 0 for excitation in flattened.T)
    repeating = [_repeats(excitation, period_samples) for excitation in flattened.T]
    if not repeating[0]:
        found = f"after {period_samples} samples" if period_samples else "after any time"
        raise AbraceError(f"{source}: {names[0]} does not repeat itself {found}, expected a periodic input")
    first, last = _periodic_part(flattened[:, repeating], period_samples)
    periods = max(0, last - first + 2 * EDGE) // period_samples - dropped
    if periods < 2:
        raise AbraceError(
            f"{source}: {names[0]} lasts {max(0, last - first)} samples with a period of {period_samples}, "
            f"expected at least {2 + dropped} periods, of which {dropped} dropped"
        )
    return period_samples, periods, last, repeating


def _repeats(excitation: NDArray[np.float64], period: int) -> bool:
    """Whether a signal, rest before and after included, repeats itself for at least two periods."""
    if not 0 < period < len(excitation):
        return False
    before, after = excitation[:-period], excitation[period:]
    return bool(before @ after > LEAST_CORRELATION * np.sqrt((before @ before) * (after @ after)))


def _periodic_part(inputs: NDArray[np.float64], period: int) -> tuple[int, int]:
    """First sample, and the one after the last, of the part in which all inputs (samples, inputs) repeat themselves."""
    first, last = 0, len(inputs)
    for excitation in inputs.T:
        before, after = excitation[:-period], excitation[period:]
        difference = ndimage.uniform_filter1d((after - before) ** 2, EDGE, mode="nearest")
        parts, count = ndimage.label(difference < ALIKE * (before @ before) / len(before))
        if not count:
            return 0, 0
        # at rest an input repeats itself as well, but is zero
        moves = ndimage.sum_labels(before * after, parts, np.arange(1, count + 1))
        (part,) = ndimage.find_objects(parts)[int(np.argmax(moves))]
        first, last = max(first, part.start), min(last, part.stop + period)
    return first, last


def _without_transient(
    spectra: NDArray[np.complex128], lines: NDArray[np.int64], periods: int
) -> tuple[NDArray[np.complex128], NDArray[np.complex128], float]:
    """Steady spectra at lines of the period, residuals of the lines in between, and the factor from these to the error.

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
