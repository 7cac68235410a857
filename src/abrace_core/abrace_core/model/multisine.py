# SPDX-License-Identifier: Apache-2.0
"""Periodic multisines: an alternative to the paper's white noise, for transfer functions without leakage.

A multisine is a sum of cosines at multiples (lines) of one over its period. Its amplitudes are all the same, its phases
are free: random ones are improved by clipping the peaks and restoring the amplitudes, over and over (Van der Ouderaa,
Schoukens and Renneboog 1988), until the rms is much greater at the same peak. Inputs on different
lines are orthogonal over a period and can be played at once; lines left out at random show nonlinear distortion
(Pintelon and Schoukens 2012, sec. 4.3: random harmonic grid).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy import fft

from abrace_core import AbraceError
from abrace_core.model.noise import check_signal

if TYPE_CHECKING:
    from numpy.typing import NDArray

LINES = ("all", "odd", "even")
"""Which multiples of one over the period a multisine may have."""

LEFT_OUT = 4
"""One of so many neighbouring odd (or even) lines, chosen at random, is left out."""

CLIPPINGS = 400
"""Iterations of the clipping, after which the crest factor of a band of some hundred lines falls no further."""

CLIP_FIRST, CLIP_LAST = 0.65, 0.96
"""Clipping level as a share of the greatest value, in the first iteration and in the last."""


def multisine(
    samples: int,
    sample_rate: float,
    band: tuple[float, float],
    rms: float,
    seed: int,
    lines: str = "odd",
    share: tuple[int, int] = (0, 1),
) -> NDArray[np.float64]:
    """One period of a multisine with a low crest factor, the same for the same seed.

    Parameters
    ----------
    samples
        Samples in a period.
    sample_rate
        [Hz].
    band
        Lowest and highest frequency [Hz], 0 <= lowest < highest < sample_rate / 2; the mean is zero in any case.
    rms
        Root mean square, in the signal's unit; met exactly.
    seed
        Seed of the lines left out and of the phases, >= 0.
    lines
        "all" in the band; "odd" or "even" multiples of one over the period, of every four of which one is left out.
    share
        (number, count): for inputs of one kind, played at once with the same seed, every count-th line from this
        number on; number 0 is the first.

    Returns
    -------
    NDArray
        (samples,). It begins and ends where two neighbouring values are nearest zero.

    Raises
    ------
    AbraceError
        If an argument is outside these limits, or no line is in the band.
    """
    low, high = band
    number, count = share
    check_signal("multisine", sample_rate, band, rms, seed)
    if lines not in LINES:
        raise AbraceError(f"multisine lines {lines!r}: expected one of {', '.join(LINES)}")
    if not 0 <= number < count:
        raise AbraceError(f"multisine share {number} of {count}: expected 0 <= number < count")
    period = samples / sample_rate
    inside = np.arange(max(1, int(np.ceil(low * period - 1e-9))), int(np.floor(high * period + 1e-9)) + 1)
    if lines != "all":
        inside = inside[inside % 2 == (lines == "odd")]
        groups = np.arange(len(inside) // LEFT_OUT) * LEFT_OUT
        left_out = groups + np.random.default_rng(seed).integers(0, LEFT_OUT, len(groups))
        inside = np.delete(inside, left_out)
    inside = inside[number::count]
    if not len(inside):
        raise AbraceError(f"multisine of {period:g} s: no line ({lines}) between {low} and {high} Hz, expected one")

    amplitude = samples / 2 * rms / np.sqrt(len(inside) / 2)
    phases = np.random.default_rng((seed, number)).uniform(0, 2 * np.pi, len(inside))
    spectrum = np.zeros(samples // 2 + 1, dtype=np.complex128)
    spectrum[inside] = amplitude * np.exp(1j * phases)
    signal = best = np.asarray(fft.irfft(spectrum, samples), dtype=np.float64)
    for clip in np.linspace(CLIP_FIRST, CLIP_LAST, CLIPPINGS):
        most = clip * np.abs(signal).max()
        clipped = fft.rfft(np.clip(signal, -most, most))[inside]
        spectrum[inside] = amplitude * np.exp(1j * np.angle(clipped))
        signal = np.asarray(fft.irfft(spectrum, samples), dtype=np.float64)
        if np.abs(signal).max() < np.abs(best).max():
            best = signal
    quietest = int(np.argmin(np.abs(best) + np.abs(np.roll(best, 1))))
    return np.roll(best, -quietest)


def repeated_multisine(
    duration: float,
    period: float,
    sample_rate: float,
    band: tuple[float, float],
    rms: float,
    seed: int,
    lines: str = "odd",
    share: tuple[int, int] = (0, 1),
) -> NDArray[np.float64]:
    """As many whole periods of a `multisine` as fit in a test.

    Parameters
    ----------
    duration
        Longest [s].
    period
        [s], rounded to whole samples; at least two have to fit, the first of which the analysis drops.
    sample_rate, band, rms, seed, lines, share
        As in `multisine`.

    Returns
    -------
    NDArray
        (periods * samples in a period,), every period the same bit for bit.

    Raises
    ------
    AbraceError
        If fewer than two periods fit, or as in `multisine`.
    """
    samples = round(period * sample_rate)
    periods = int(round(duration * sample_rate) / samples) if samples > 0 else 0
    if periods < 2:
        raise AbraceError(f"multisine of {duration:g} s with a period of {period:g} s: expected at least two periods")
    return np.tile(multisine(samples, sample_rate, band, rms, seed, lines, share), periods)
