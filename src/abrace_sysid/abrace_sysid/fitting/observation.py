# SPDX-License-Identifier: Apache-2.0
"""The frequency lines of one test in the likelihood of its poles, from spectra or from transfer functions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_sysid.fitting.pole_basis import Sampling
from abrace_sysid.spectra.fourier import lines_within

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_sysid.recorded.test import Test
    from abrace_sysid.spectra.frequency_response import FrequencyResponse

ENDS = (0, 1, 2, -1, -2, -3)
"""Samples at the ends of a record that can be left free."""


@dataclass(frozen=True)
class Observation:
    """One test in the likelihood; made by `of_test` or `of_response`.

    Parameters
    ----------
    source
        Name of the test, for messages.
    outputs
        Names of the channels.
    omega
        (lines,) [rad/s], rising.
    excitation
        (lines, inputs) transforms of the inputs, or ones if `measured` are transfer functions.
    measured
        (lines, channels) transforms of the outputs, or transfer functions.
    noise_level
        (lines,) standard deviation of the noise, relative from line to line.
    samplings
        How each input moves between samples.
    transient
        Whether the leakage of a finite record is in `measured`.
    poles
        The poles that are excited in this test, as indices into those of all tests; None: all poles.
    free_ends
        Whether the first and last samples (`ENDS`) are left free: the transform of a finite record continues a
        band-limited input periodically, which is wrong there.
    weight
        Weight of the test among others: less than 1 if its channels' noise is correlated, because correlated channels
        contain less information than independent ones.
    """

    source: str
    outputs: tuple[str, ...]
    omega: NDArray[np.float64]
    excitation: NDArray[np.complex128]
    measured: NDArray[np.complex128]
    noise_level: NDArray[np.float64]
    inputs: tuple[str, ...]
    samplings: tuple[Sampling, ...]
    transient: bool
    poles: tuple[int, ...] | None = None
    free_ends: bool = False
    weight: float = 1.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.measured).all() and np.isfinite(self.excitation).all()):
            raise AbraceError(f"{self.source}: a frequency line has a value that is not finite")
        dead = [name for name, column in zip(self.outputs, self.measured.T, strict=True) if not np.any(column)]
        if dead:
            raise AbraceError(f"{self.source}: channel {', '.join(dead)} is zero throughout, expected a response")

    @cached_property
    def z(self) -> NDArray[np.complex128]:
        """(lines,) exp(i w T)."""
        return np.exp(1j * self.omega * self.samplings[0].sample_period)

    @property
    def seconds(self) -> float:
        """Length of the record, from the distance of its lines."""
        return 2 * np.pi / float(np.median(np.diff(self.omega)))

    def shown(self, poles: NDArray[np.complex128]) -> tuple[int, ...]:
        """The indices into `poles` of those that are excited in this test."""
        return tuple(range(len(poles))) if self.poles is None else self.poles

    def in_units(self, unit: Mapping[str, float]) -> Observation:
        """The same test with its inputs in other units; `unit` is the size of each by name."""
        return replace(self, excitation=self.excitation / np.array([unit[name] for name in self.inputs]))

    def thinned(self, lines: int) -> Observation:
        """The same test at every second, third ... line, so that about `lines` are left; the model is the same."""
        chosen = slice(None, None, max(1, len(self.omega) // lines))
        of_lines = {name: getattr(self, name)[chosen] for name in ("omega", "excitation", "measured", "noise_level")}
        return replace(self, **of_lines)

    def with_noise(self, level: NDArray[np.float64]) -> Observation:
        """The same test with another noise `level` (lines,)."""
        return replace(self, noise_level=level)

    @classmethod
    def of_test(
        cls, test: Test, inputs: Sequence[str], band: tuple[float, float], outputs: Sequence[str] | None = None
    ) -> Observation:
        """The observation of a whole test with noise, leakage included.

        Parameters
        ----------
        test, inputs
            The test, and all inputs that were excited.
        band
            Lowest and highest frequency [Hz]; the inputs must be excited throughout.
        outputs
            None: all of the test.

        Raises
        ------
        AbraceError
            If a name is unknown or the band has no line.
        """
        lines, omega = lines_within(test, len(test.outputs), band)
        names = tuple(test.names if outputs is None else outputs)
        excitation, measured = test.spectra(inputs)[lines], test.spectra(names)[lines]
        samplings = tuple(Sampling(test.sample_period, test.hold_of(name)) for name in inputs)
        return cls(test.source, names, omega, excitation, measured, np.ones(len(lines)), tuple(inputs), samplings, True)

    @classmethod
    def of_response(cls, measured: FrequencyResponse, source: str) -> Observation:
        """The observation of a test from a measured transfer function, of a periodic test or averaged.

        The lines should be independent. Neighbouring lines of the local polynomial method are not: the poles are still
        right, but their intervals are too narrow.

        Parameters
        ----------
        measured
            The transfer function, hold and delay included; its standard deviation gives the lines' relative noise.
        source
            Name of the test, for messages.
        """
        relative = measured.sigma / np.maximum(np.median(measured.sigma, axis=0), np.finfo(float).tiny)
        level = np.sqrt(np.mean(relative**2, axis=1))
        known = level > 0
        level = np.where(known, level, level[known].min()) if known.any() else np.ones(len(level))
        sampling = Sampling(measured.sample_period, measured.held)
        ones = np.ones((len(level), 1), dtype=np.complex128)
        return cls(
            source,
            measured.outputs,
            measured.omega,
            ones,
            measured.response,
            level,
            (measured.input,),
            (sampling,),
            False,
        )
