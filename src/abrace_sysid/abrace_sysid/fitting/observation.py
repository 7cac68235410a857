"""The frequency lines of one test in the likelihood of its poles, from spectra or from transfer functions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.discretization import HOLDS
from abrace_core.errors import AbraceError
from abrace_sysid.fitting.pole_basis import Sampling

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_sysid.spectra.fourier import Spectra
    from abrace_sysid.spectra.frequency_response import FrequencyResponse


@dataclass(frozen=True)
class Observation:
    """One test in the likelihood; made by `of_spectra` or `of_response`.

    Parameters
    ----------
    source
        For messages.
    outputs
        Names of the channels.
    z
        (lines,) exp(i w T).
    excitation
        (lines, inputs) transforms of the inputs, or ones where `measured` are transfer functions.
    measured
        (lines, channels) transforms of the outputs, or transfer functions.
    noise_level
        (lines,) standard deviation of the noise, relative from line to line.
    samplings
        How each input moves between samples.
    transient
        Whether the leakage of a finite record is in `measured`.
    poles
        The poles that are excited in this test, as indices into those of all tests; None for all of them.
    """

    source: str
    outputs: tuple[str, ...]
    z: NDArray[np.complex128]
    excitation: NDArray[np.complex128]
    measured: NDArray[np.complex128]
    noise_level: NDArray[np.float64]
    samplings: tuple[Sampling, ...]
    transient: bool
    poles: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.measured).all() and np.isfinite(self.excitation).all()):
            raise AbraceError(f"{self.source}: a line that is not finite")
        dead = [name for name, column in zip(self.outputs, self.measured.T, strict=True) if not np.any(column)]
        if dead:
            raise AbraceError(f"{self.source}: channel {', '.join(dead)} is zero throughout, expected a response")

    @classmethod
    def of_spectra(cls, spectra: Spectra, source: str) -> Observation:
        """A test's spectra, leakage included.

        Parameters
        ----------
        spectra
            Of the whole record.
        source
            For messages.
        """
        samplings = tuple(Sampling(spectra.sample_period, HOLDS.get(name, "zero")) for name in spectra.inputs)
        z = np.exp(1j * spectra.omega * spectra.sample_period)
        level = np.ones(len(z))
        return cls(source, spectra.outputs, z, spectra.excitation, spectra.outputs_spectrum, level, samplings, True)

    @classmethod
    def of_response(cls, measured: FrequencyResponse, source: str) -> Observation:
        """A measured transfer function: of a periodic test, or averaged.

        The lines must be independent, which neighbours of the local polynomial method are not: the poles are right
        nevertheless, their intervals too narrow.

        Parameters
        ----------
        measured
            Hold and delay included; from its standard deviation follows how the lines' noise compares.
        source
            For messages.
        """
        relative = measured.sigma / np.maximum(np.median(measured.sigma, axis=0), np.finfo(float).tiny)
        level = np.sqrt(np.mean(relative**2, axis=1))
        known = level > 0
        level = np.where(known, level, level[known].min()) if known.any() else np.ones(len(level))
        sampling = Sampling(measured.sample_period, HOLDS.get(measured.input, "zero"))
        z = np.exp(1j * measured.omega * measured.sample_period)
        ones = np.ones((len(z), 1), dtype=np.complex128)
        return cls(source, measured.outputs, z, ones, measured.response, level, (sampling,), False)
