"""A record made ready for the table: resampled to the rig's rate without distortion, scaled to a PGA, padded or cut.

The paper plays El Centro for 100 s and Kobe for 60 s, both at 0.1 g. White noise for the table comes from
`abrace_core.noise.banded_noise`.
"""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
from scipy import signal

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_plant.record_files import Record

UNCHANGED = 0.8
"""Share of the band limit below which the motion passes unchanged; from there to the limit it fades out."""
STOPBAND = 100.0
"""dB by which everything beyond the band limit is suppressed; the motion below is changed by as little (1e-5)."""
TAPER = 0.5
"""Seconds over which a motion that is cut fades to zero."""
FINEST = 5000
"""Greatest denominator of the ratio of the two sample rates."""


def prepare(
    record: Record,
    sample_rate: float,
    peak_acceleration: float = 0.0,
    duration: float = 0.0,
    band_limit: float = 0.0,
) -> NDArray[np.float64]:
    """The table's acceleration sample by sample.

    Parameters
    ----------
    record
        The recorded motion.
    sample_rate
        Of the rig [Hz].
    peak_acceleration
        Greatest absolute value of the whole resampled motion [m/s^2], met exactly, before a longer motion is cut;
        0: as recorded.
    duration
        [s]; a shorter motion is followed by zeros, a longer one is cut and fades out over its last 0.5 s. 0: the
        whole record.
    band_limit
        Frequency beyond which nothing is left [Hz]; below 0.8 times it the motion is unchanged within 1e-5. 0, or more
        than half of the record's or of the rig's sample rate: that half, and no filter where the two rates are equal.

    Returns
    -------
    NDArray
        (samples,) [m/s^2], the first at the record's first sample.

    Raises
    ------
    AbraceError
        If an argument is negative or not finite, or a peak is asked of a record of zeros.
    """
    asked = {
        "sample_rate": sample_rate,
        "peak_acceleration": peak_acceleration,
        "duration": duration,
        "band_limit": band_limit,
    }
    for key, value in asked.items():
        if not (np.isfinite(value) and value >= 0) or (key == "sample_rate" and value == 0):
            least = "more than 0" if key == "sample_rate" else "0 or more"
            raise AbraceError(f"ground motion {record.name}: {key} {value}, expected {least}")
    if 0 < duration * sample_rate < 1:
        raise AbraceError(f"ground motion {record.name}: duration {duration} s, expected a sample or more")
    recorded = int((len(record.acceleration) - 1) * record.sample_period * sample_rate * (1 + 1e-9)) + 1
    samples = round(duration * sample_rate) or recorded
    motion = _resample(record, sample_rate, band_limit, max(samples, recorded))
    if peak_acceleration:
        peak = np.abs(motion).max()
        if peak == 0:
            raise AbraceError(f"ground motion {record.name}: zero throughout, cannot be scaled to a peak")
        motion = motion / peak * peak_acceleration
    if samples < recorded:
        motion = motion[:samples]
        fall = min(round(TAPER * sample_rate), samples)
        motion[samples - fall :] *= (1 + np.cos(np.pi * np.arange(1, fall + 1) / max(fall, 1))) / 2
    return motion


def _resample(record: Record, sample_rate: float, band_limit: float, samples: int) -> NDArray[np.float64]:
    """The record at the sample rate, (samples,), with zeros before and after it: nothing wraps round.

    A Kaiser-windowed low-pass filter, applied in its polyphase form (Oppenheim and Schafer, sec. 4.7): its pass band
    ends at 0.8 of the limit, its stop band starts at the limit.
    """
    ratio = Fraction(sample_rate * record.sample_period).limit_denominator(FINEST)
    if ratio == 0:
        raise AbraceError(
            f"ground motion {record.name}: sample rate {1 / record.sample_period:g} Hz, "
            f"expected less than {FINEST} times the rig's {sample_rate:g} Hz"
        )
    up, down = ratio.numerator, ratio.denominator
    held = min(1 / record.sample_period, sample_rate) / 2
    limit = min(band_limit or held, held)
    needed = -(-samples * down // up) + 1
    padded = np.zeros(max(needed, len(record.acceleration)))
    padded[: len(record.acceleration)] = record.acceleration
    if up == down == 1 and limit == held:
        return padded[:samples]
    rate = up / record.sample_period
    length, beta = signal.kaiserord(STOPBAND, (1 - UNCHANGED) * limit / (rate / 2))
    # half the kernel is a whole number of output samples, which are then dropped: no delay is left
    delay = -(-(length // 2) // down)
    kernel = signal.firwin(2 * delay * down + 1, (1 + UNCHANGED) / 2 * limit, window=("kaiser", beta), fs=rate)
    motion = signal.upfirdn(up * kernel, padded, up, down)
    return np.asarray(motion[delay : delay + samples], dtype=np.float64)
