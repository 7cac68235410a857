# SPDX-License-Identifier: Apache-2.0
"""Banded white noise: the excitation of table and braces in the identification tests (Figs. 3 to 5 of the paper).

The table's, which has to begin and end at rest, is made of it in `table_signals`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy import fft

from abrace_core import AbraceError

if TYPE_CHECKING:
    from numpy.typing import NDArray

LONGEST_SIGNAL = 3600.0
"""Seconds of the longest signal that a node plays: it is made in some seconds, and kept in memory."""
TAPER = 1.0
"""Seconds over which the noise rises from zero and falls to it."""


def banded_noise(
    samples: int, sample_rate: float, band: tuple[float, float], rms: float, seed: int
) -> NDArray[np.float64]:
    """Gaussian noise with a flat spectrum in a band and nothing outside, the same for the same seed.

    Parameters
    ----------
    samples
        Length, at least twice the taper of 1 s.
    sample_rate
        [Hz].
    band
        Lowest and highest frequency [Hz], 0 <= lowest < highest < sample_rate / 2. The mean is left out even where the
        lowest is 0.
    rms
        Root mean square over the whole length, tapers included, in the noise's unit; met exactly.
    seed
        Seed of the generator, >= 0.

    Returns
    -------
    NDArray
        (samples,), zero at both ends. The tapers spread the band's edges by about 1 / TAPER [Hz].

    Raises
    ------
    AbraceError
        If an argument is outside these limits, or the band lies between two lines of the spectrum.
    """
    spectrum, length = noise_spectrum(samples, sample_rate, band, rms, seed)
    taper = round(TAPER * sample_rate)
    noise = np.asarray(fft.irfft(spectrum, length), dtype=np.float64)[:samples]
    rise = (1 - np.cos(np.pi * np.arange(taper) / max(taper, 1))) / 2
    noise[:taper] *= rise
    noise[samples - taper :] *= rise[::-1]
    return noise * (rms / np.sqrt(np.mean(noise**2)))


def noise_spectrum(
    samples: int, sample_rate: float, band: tuple[float, float], rms: float, seed: int
) -> tuple[NDArray[np.complex128], int]:
    """The spectrum of Gaussian noise in a band, its amplitude any, and the samples (`samples` or more) that it is for.

    Parameters
    ----------
    samples, sample_rate, band, rms, seed
        As in `banded_noise`, which are checked here.

    Raises
    ------
    AbraceError
        As in `banded_noise`.
    """
    check_signal("noise", sample_rate, band, rms, seed)
    low, high = band
    if samples < max(2 * round(TAPER * sample_rate), 2):
        raise AbraceError(f"noise of {samples / sample_rate:g} s: expected at least {2 * TAPER:g} s (taper in and out)")

    from scipy.fft import next_fast_len  # a node that plays a record starts without SciPy

    length = next_fast_len(samples, real=True)
    frequencies = fft.rfftfreq(length, 1 / sample_rate)
    lines = np.flatnonzero((frequencies >= low) & (frequencies <= high) & (frequencies > 0))
    if not len(lines):
        raise AbraceError(f"noise band {low} to {high} Hz: expected one wider than {sample_rate / length:.3g} Hz")
    spectrum = np.zeros(len(frequencies), dtype=np.complex128)
    real, imaginary = np.random.default_rng(seed).standard_normal((2, len(lines)))
    spectrum[lines] = real + 1j * imaginary
    return spectrum, length


def check_signal(what: str, sample_rate: float, band: tuple[float, float], rms: float, seed: int) -> None:
    """Refuse a `sample_rate`, `band`, `rms` or `seed` that no signal has; an AbraceError begins with `what` it is."""
    low, high = band
    if not (np.isfinite(sample_rate) and sample_rate > 0):
        raise AbraceError(f"{what} sample_rate {sample_rate} Hz: expected more than 0")
    if not 0 <= low < high < sample_rate / 2:
        raise AbraceError(f"{what} band {low} to {high} Hz: expected 0 <= lowest < highest < {sample_rate / 2:g} Hz")
    if not (np.isfinite(rms) and rms > 0):
        raise AbraceError(f"{what} rms {rms}: expected more than 0")
    if seed < 0:
        raise AbraceError(f"{what} seed {seed}: expected 0 or more")
