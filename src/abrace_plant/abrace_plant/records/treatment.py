# SPDX-License-Identifier: Apache-2.0
"""Treatment of a record for the table: baseline, time scale, filters, resampling to the rig's rate, scaling to a PGA.

The paper plays El Centro for 100 s and Kobe for 60 s, both at 0.1 g. White noise for the table comes from
`abrace_core.model.table_signals`.
"""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_plant.records.measures import integrate
from abrace_plant.records.options import Treatment
from abrace_plant.records.record import check_record

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_plant.records.record import Record

PASSBAND = 0.8
"""End of the low-pass filter's pass band over the band limit, at which its stop band starts."""
STOPBAND = 100.0
"""Attenuation beyond the band limit [dB]; the ripple in the pass band is as small (1e-5)."""
RESAMPLING_STOPBAND = 105.0
"""The same where the limit is half the lower sample rate, at which images of the highest frequencies add up."""
FADE = 0.5
"""Seconds at the end of a motion that is cut, in which it comes to rest."""
MAX_RATIO = 5000
"""Greatest denominator of the ratio of the two sample rates."""
BASELINES = {"none": 0, "constant": 1, "linear": 2, "quadratic": 3}
"""Baselines that can be removed from an acceleration, and how many coefficients each has."""
LOW_CUT_ORDER = 4
"""Order of the Butterworth filter that the low cut amounts to, run forwards and backwards."""


def prepare(record: Record, sample_rate: float, treatment: Treatment | None = None) -> NDArray[np.float64]:
    """The table's acceleration sample by sample.

    Parameters
    ----------
    record
        The recorded motion.
    sample_rate
        Of the rig [Hz].
    treatment
        Treatment in addition to resampling; None: none.

    Returns
    -------
    NDArray
        (samples,) [m/s^2], the first at the record's first sample.

    Raises
    ------
    AbraceError
        If the treatment does not fit the record: a taper longer than half of it, a low cut beyond what is left, a peak
        asked of a record of zeros; or as in `check_record`.
    """
    asked = treatment or Treatment()
    check_record(record)
    where = f"ground motion {record.name}"
    if not (np.isfinite(sample_rate) and sample_rate > 0):
        raise AbraceError(f"{where}: sample_rate {sample_rate}, expected more than 0")
    if 0 < asked.duration * sample_rate < 1:
        raise AbraceError(f"{where}: duration {asked.duration} s, expected a sample or more")
    period = record.sample_period * asked.time_scale
    length = (len(record.acceleration) - 1) * period
    if asked.taper > length / 2:
        raise AbraceError(f"{where}: taper {asked.taper:g} s, expected at most half of the motion's {length:g} s")
    nyquist = min(1 / period, sample_rate) / 2
    limit = min(asked.band_limit or nyquist, nyquist)
    if asked.low_cut >= limit:
        raise AbraceError(
            f"{where}: low_cut {asked.low_cut:g} Hz, expected less than {limit:g} Hz, the band's upper end"
        )

    acceleration = without_baseline(record.acceleration, record.sample_period, asked.baseline)
    if asked.taper:
        time = period * np.arange(len(acceleration))
        acceleration = acceleration * np.minimum(np.minimum(time, time[::-1]) / asked.taper, 1)
    if asked.low_cut:
        acceleration = _cut_low(acceleration, period, asked.low_cut)
    recorded = int(length * sample_rate * (1 + 1e-9)) + 1
    samples = round(asked.duration * sample_rate) or recorded
    motion = _resample(where, acceleration, period, sample_rate, limit, max(samples, recorded))
    if asked.peak_acceleration:
        peak = np.abs(motion).max()
        if peak == 0:
            raise AbraceError(f"{where}: zero throughout, cannot be scaled to a peak")
        motion = motion / peak * asked.peak_acceleration
    return _cut(motion, samples, round(FADE * sample_rate)) if samples < recorded else motion


def _cut(motion: NDArray[np.float64], samples: int, fade: int) -> NDArray[np.float64]:
    """The first `samples` of a motion, faded out over `fade` samples so that it ends at rest, within its old peak."""
    peak, fall = np.abs(motion).max(), min(fade, samples)
    motion = motion[:samples].copy()
    motion[samples - fall :] *= (1 + np.cos(np.pi * np.arange(1, fall + 1) / max(fall, 1))) / 2
    # the velocity left by the fade is removed over the same time, or a longer one if that needs too much acceleration
    span, corrected = max(fall, 1), motion
    while True:
        bump = 1 - np.cos(2 * np.pi * np.arange(1, span + 1) / span)
        corrected = motion.copy()
        corrected[samples - span :] -= motion.sum() / max(bump.sum(), 1.0) * bump
        highest = np.abs(corrected).max()
        if highest <= peak or span == samples:
            # also clipped: rounding in the scaling may exceed the peak
            return np.clip(corrected * (peak / highest), -peak, peak) if highest > peak else corrected
        span = min(2 * span, samples)


def without_baseline(acceleration: NDArray[np.float64], sample_period: float, baseline: str) -> NDArray[np.float64]:
    """An acceleration less the polynomial whose removal leaves the least mean square velocity.

    Parameters
    ----------
    acceleration
        (samples,) [m/s^2].
    sample_period
        [s].
    baseline
        A key of `BASELINES`.

    Returns
    -------
    NDArray
        (samples,) [m/s^2].
    """
    coefficients = BASELINES[baseline]
    if coefficients == 0:
        return acceleration
    # orthogonal polynomials over the record: the fit stays well conditioned
    along = np.linspace(-1, 1, len(acceleration))
    powers = np.asarray(np.polynomial.legendre.legvander(along, coefficients - 1), dtype=np.float64)
    velocities, _ = integrate(powers, sample_period)
    velocity, _ = integrate(acceleration, sample_period)
    fitted = np.linalg.lstsq(velocities, velocity, rcond=None)[0]
    return np.asarray(acceleration - powers @ fitted, dtype=np.float64)


def _cut_low(acceleration: NDArray[np.float64], period: float, low_cut: float) -> NDArray[np.float64]:
    """The acceleration without what is slower than the low cut, by its cosine transform.

    A cosine transform continues the acceleration evenly beyond its ends, so the velocity oddly: its zeros at both ends
    stay zeros, and no filter transient beyond them is needed to avoid drift of velocity and displacement (unlike with
    zero padding: Boore and Bommer, 2005).
    """
    from scipy import fft  # here, as in `_resample`: white noise needs none of it

    spectrum = fft.dct(acceleration, type=1)
    frequency = np.arange(1, len(spectrum)) / (2 * (len(spectrum) - 1) * period)
    spectrum[0] = 0
    spectrum[1:] /= 1 + (low_cut / frequency) ** (2 * LOW_CUT_ORDER)
    return np.asarray(fft.idct(spectrum, type=1), dtype=np.float64)


def _resample(
    where: str, acceleration: NDArray[np.float64], period: float, sample_rate: float, limit: float, samples: int
) -> NDArray[np.float64]:
    """The acceleration at the sample rate, (samples,), with zeros before and after it: nothing wraps round.

    A Kaiser-windowed low-pass filter, applied in its polyphase form (Oppenheim and Schafer 2010, ch. 4): its pass band
    ends at 0.8 of the limit, its stop band starts at the limit.
    """
    ratio = Fraction(float(sample_rate * period)).limit_denominator(MAX_RATIO)
    if ratio == 0:
        raise AbraceError(
            f"{where}: sample rate {1 / period:g} Hz, expected less than {MAX_RATIO} times the rig's {sample_rate:g} Hz"
        )
    up, down = ratio.numerator, ratio.denominator
    needed = -(-samples * down // up) + 1
    padded = np.zeros(max(needed, len(acceleration)))
    padded[: len(acceleration)] = acceleration
    only_resampled = limit == min(1 / period, sample_rate) / 2
    if up == down == 1 and only_resampled:
        return padded[:samples]
    from scipy import signal  # imports for half a second; white noise, say, needs none of it

    rate = up / period
    stopband = RESAMPLING_STOPBAND if only_resampled else STOPBAND
    length, beta = signal.kaiserord(stopband, (1 - PASSBAND) * limit / (rate / 2))
    # half the kernel is a whole number of output samples, which are then dropped: no delay is left
    delay = -(-(length // 2) // down)
    kernel = signal.firwin(2 * delay * down + 1, (1 + PASSBAND) / 2 * limit, window=("kaiser", beta), fs=rate)
    motion = signal.upfirdn(up * kernel, padded, up, down)
    return np.asarray(motion[delay : delay + samples], dtype=np.float64)
