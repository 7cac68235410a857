# SPDX-License-Identifier: Apache-2.0
"""White noise and multisines as accelerations of a shake table, which begin and end at rest in the table's middle.

Noise that is only faded in and out leaves a velocity, and that a drift of metres. Here the displacement is made first:
each line of the acceleration's spectrum is divided by minus the square of its frequency (by what the second difference
does to it, so that the result is exact at any rate), the displacement fades in and out, and its second difference is
the acceleration. The sum of a second difference is zero, and so is its first moment: the velocity and the displacement
of an acceleration that is linear between samples end where they began, at zero, to rounding errors.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy import fft

from abrace_core import AbraceError
from abrace_core.model.multisine import multisine
from abrace_core.model.noise import TAPER, noise_spectrum

if TYPE_CHECKING:
    from numpy.typing import NDArray


def table_noise(
    samples: int, sample_rate: float, band: tuple[float, float], rms: float, seed: int
) -> NDArray[np.float64]:
    """Gaussian acceleration with a flat spectrum in a band, from rest to rest, the same for the same seed.

    Parameters
    ----------
    samples
        Length, at least 2 s.
    sample_rate
        [Hz].
    band
        Lowest and highest frequency [Hz], 0 <= lowest < highest < sample_rate / 2. The displacement grows with
        1 / lowest^1.5.
    rms
        Root mean square over the whole length, fades included [m/s^2]; met exactly.
    seed
        Of the generator, >= 0.

    Returns
    -------
    NDArray
        (samples,) [m/s^2]. It fades in and out over one period of the lowest frequency, at least 1 s and at most a
        quarter of its length.

    Raises
    ------
    AbraceError
        As in `abrace_core.model.noise.banded_noise`.
    """
    spectrum, length = noise_spectrum(samples, sample_rate, band, rms, seed)
    displacement = _displacement(spectrum, length)[:samples]
    fade = min(_fade(max(band[0], sample_rate / samples), sample_rate), samples // 4)
    acceleration = _from_rest_to_rest(displacement, fade)
    return acceleration * (rms / np.sqrt(np.mean(acceleration**2)))


def table_multisine(
    duration: float,
    period: float,
    sample_rate: float,
    band: tuple[float, float],
    rms: float,
    seed: int,
    lines: str = "odd",
) -> NDArray[np.float64]:
    """As many whole periods of a multisine as fit in a test, with a fade before and after them, from rest to rest.

    Parameters
    ----------
    duration
        Longest, fades included [s].
    period
        [s], rounded to whole samples; at least two have to fit.
    sample_rate, band, rms, seed, lines
        As in `abrace_core.model.multisine.multisine`; the lowest frequency above 0, the rms [m/s^2] that of a period.

    Returns
    -------
    NDArray
        (samples,) [m/s^2]: every period the same bit for bit. It fades in and out over one period of the lowest
        frequency, at least 1 s.

    Raises
    ------
    AbraceError
        If fewer than two periods fit, or as in `multisine`.
    """
    if not band[0] > 0:
        expected = "a lowest frequency above 0: the table's stroke grows with 1 / frequency^2"
        raise AbraceError(f"multisine band {band[0]} to {band[1]} Hz on the table: expected {expected}")
    one = multisine(round(period * sample_rate), sample_rate, band, rms, seed, lines)
    fade = _fade(band[0], sample_rate)
    periods = (round(duration * sample_rate) - 2 * fade) // len(one)
    if periods < 2:
        needed = (2 * len(one) + 2 * fade) / sample_rate
        raise AbraceError(
            f"multisine of {duration:g} s with a period of {period:g} s: expected at least {needed:g} s, two periods "
            f"and {fade / sample_rate:g} s to fade in and out"
        )
    displacement = _displacement(fft.rfft(one), len(one))
    return _from_rest_to_rest(np.take(displacement, np.arange(-fade, periods * len(one) + fade), mode="wrap"), fade)


def _fade(lowest: float, sample_rate: float) -> int:
    """Samples of a fade: one period of the lowest frequency, at least 1 s."""
    return round(max(TAPER, 1 / lowest) * sample_rate)


def _displacement(spectrum: NDArray[np.complex128], length: int) -> NDArray[np.float64]:
    """(length,) the signal whose second difference, taken as periodic, has this spectrum, without a mean."""
    squares = 4 * np.sin(np.pi * np.arange(1, len(spectrum)) / length) ** 2
    return np.asarray(fft.irfft(np.concatenate([[0.0], -spectrum[1:] / squares]), length), dtype=np.float64)


def _from_rest_to_rest(displacement: NDArray[np.float64], fade: int) -> NDArray[np.float64]:
    """The second difference of a displacement that fades in and out: (samples,), of as many samples.

    The fade s - sin(2 pi s) / (2 pi) has no step in its second derivative, so neither has the acceleration.
    """
    share = np.arange(fade) / fade
    rise = share - np.sin(2 * np.pi * share) / (2 * np.pi)
    faded = displacement.copy()
    faded[:fade] *= rise
    faded[len(faded) - fade :] *= rise[::-1]
    return np.asarray(np.diff(faded, 2, prepend=0.0, append=0.0), dtype=np.float64)
