# SPDX-License-Identifier: Apache-2.0
"""The spectra of a test's channels, their sensor noise, and each floor's displacement from all its sensors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy import fft

from abrace_core.model import signals

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_sysid.recorded.test import Test

QUIET = (1.3, 0.8)
"""The band that contains only sensor noise: from 1.3 times the highest excited frequency to 0.8 of half the sample
rate."""


BANDS = 5
"""Number of parts of this band; the noise is estimated in each."""

LEAST_NOISE = 1e-7
"""Least noise of a channel, as a share of its rms; for exact readings, which have only rounding errors."""


def noise_between(power: NDArray[np.float64], lines: Sequence[int]) -> NDArray[np.float64]:
    """(channels,) standard deviation of white noise, the greatest of those found in several bands.

    It follows from a band's median power, which hum and leakage do not affect.

    Parameters
    ----------
    power
        (lines, channels), as `hann_power` gives it.
    lines
        Numbers of the lines at which the bands begin, and the last one ends.
    """
    medians = [np.median(power[low:high], axis=0) for low, high in pairwise(lines) if high > low]
    # an exponential distribution's median is log(2) times its mean
    return np.asarray(np.sqrt(np.max(medians, axis=0) / np.log(2)))


def noise_level(test: Test, names: Sequence[str], highest: float) -> NDArray[np.float64]:
    """(len(names),) standard deviation of sensor noise in the excited band, from bands above it.

    The greatest value of these bands is used, since an anti-alias filter attenuates the higher ones.

    Parameters
    ----------
    test, names
        The test, trends removed, and the channels.
    highest
        Frequency [Hz] up to which the rig was excited.
    """
    frequency = fft.rfftfreq(len(test.outputs), test.sample_period)
    end = QUIET[1] * frequency[-1]
    edges = np.searchsorted(frequency, np.geomspace(min(QUIET[0] * highest, 0.9 * end), end, BANDS + 1))
    least = np.maximum(LEAST_NOISE * np.std(test.channels(names), axis=0), np.finfo(float).tiny)
    return np.asarray(np.maximum(noise_between(test.powers(names), edges.tolist()), least))


@dataclass(frozen=True)
class Motion:
    """The spectra of one test.

    Parameters
    ----------
    floors, groups
        Number of floors and of brace groups of the rig.
    braces
        (groups,) number of braces in each group.
    samples, sample_period
        Length of the record [samples], and seconds between samples.
    omega
        (lines,) [rad/s] all lines of the record, from 0 on.
    spectra
        (lines,) transform over the square root of the number of samples, of each channel that responds, of w and of the
        commands.
    noise
        Standard deviation of each channel's noise.
    """

    source: str
    floors: int
    groups: int
    braces: tuple[int, ...]
    samples: int
    sample_period: float
    omega: NDArray[np.float64]
    spectra: Mapping[str, NDArray[np.complex128]]
    noise: Mapping[str, float]

    @classmethod
    def of(cls, test: Test, highest: float) -> Motion:
        """The spectra of a test.

        Parameters
        ----------
        highest
            Frequency [Hz] up to which the rig was excited.
        """
        names = [*test.names, signals.GROUND]
        spectra = test.still.spectra((*names, *test.commands))
        noise = noise_level(test.still, names, highest).tolist()
        return cls(
            test.source,
            test.floors,
            test.groups,
            test.braces,
            len(test.outputs),
            test.sample_period,
            2 * np.pi * fft.rfftfreq(len(test.outputs), test.sample_period),
            dict(zip((*names, *test.commands), spectra.T, strict=True)),
            dict(zip(names, noise, strict=True)),
        )

    def with_channels(self, spectra: Mapping[str, NDArray[np.complex128]], noise: Mapping[str, float]) -> Motion:
        """The same test with the spectra and noise of some channels replaced."""
        return replace(self, spectra={**self.spectra, **spectra}, noise={**self.noise, **noise})

    def without(self, names: Collection[str]) -> Motion:
        """The same test without the channels of these `names`."""
        return replace(self, spectra={name: one for name, one in self.spectra.items() if name not in names})

    def driven(self, group: int) -> bool:
        """Whether the command of a brace group (from 1) is not zero throughout."""
        return bool(np.any(self.spectra[signals.command_names(self.groups)[group - 1]]))

    def within(self, band: tuple[float, float]) -> NDArray[np.int64]:
        """Numbers of the lines in a band [Hz]."""
        low, high = (2 * np.pi * edge for edge in band)
        return np.flatnonzero((self.omega >= low) & (self.omega <= high) & (self.omega > 0))

    def displacement(self, floor: int) -> NDArray[np.complex128] | None:
        """(lines,) displacement of a floor (1 is the lowest), from displacement sensor and accelerometer.

        The two are weighted by their noise; None if neither can be used. The accelerometer is used only if the table's
        acceleration is known as well.
        """
        x, a, w = (self.spectra.get(name) for name in (f"x{floor}", f"a{floor}", signals.GROUND))
        square = np.where(self.omega > 0, self.omega, 1.0) ** 2
        if a is None or w is None:
            return x
        of_acceleration = (w - a) / square
        if x is None:
            return of_acceleration
        precise = square**2 / (self.noise[f"a{floor}"] ** 2 + self.noise[signals.GROUND] ** 2)
        own = 1 / self.noise[f"x{floor}"] ** 2
        return np.asarray((own * x + precise * of_acceleration) / (own + precise))

    def series(self, spectrum: NDArray[np.complex128], band: tuple[float, float]) -> NDArray[np.float64]:
        """(samples,) time history of the part of a `spectrum` within a `band` [Hz]."""
        kept = np.zeros_like(spectrum)
        lines = self.within(band)
        kept[lines] = spectrum[lines]
        return np.asarray(fft.irfft(kept, self.samples) * np.sqrt(self.samples))

    def spectrum(self, series: NDArray[np.float64]) -> NDArray[np.complex128]:
        """(lines,) spectrum of a `series` (samples,), in the scale of `spectra`."""
        return np.asarray(fft.rfft(series) / np.sqrt(self.samples))
