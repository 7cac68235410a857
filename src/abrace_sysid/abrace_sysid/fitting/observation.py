"""Frequency lines of a test as the likelihood of its poles sees them, from spectra or from transfer functions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.discretization import HOLDS
from abrace_core.errors import AbraceError
from abrace_sysid.fitting.pole_basis import Sampling

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_sysid.spectra.fourier import Spectra
    from abrace_sysid.spectra.frequency_response import FrequencyResponse


@dataclass(frozen=True)
class Observation:
    """One test as the likelihood sees it; made by `of_spectra` or `of_response`.

    Parameters
    ----------
    source
        For messages.
    inputs, outputs
        Names.
    z
        (lines,) exp(i w T).
    excitation
        (lines, inputs) transforms of the inputs, or ones where `measured` are transfer functions.
    measured
        (lines, channels) transforms of the outputs, or transfer functions.
    level
        (lines,) relative noise level of the lines.
    samplings
        How each input moves between samples.
    transient
        Whether the leakage of a finite record is in `measured`.
    poles
        Which of the common poles the test shows, as indices; None for all of them.
    """

    source: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    z: NDArray[np.complex128]
    excitation: NDArray[np.complex128]
    measured: NDArray[np.complex128]
    level: NDArray[np.float64]
    samplings: tuple[Sampling, ...]
    transient: bool
    poles: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.measured).all() and np.isfinite(self.excitation).all()):
            raise AbraceError(f"{self.source}: a line that is not finite")
        dead = [name for name, column in zip(self.outputs, self.measured.T, strict=True) if not np.any(column)]
        if dead:
            raise AbraceError(f"{self.source}: channel {', '.join(dead)} is zero throughout, expected a response")


def of_spectra(
    spectra: Spectra, source: str, delays: Mapping[str, float] | None = None, poles: Sequence[int] | None = None
) -> Observation:
    """A test's spectra, leakage and all, for `fit_poles`.

    Parameters
    ----------
    spectra
        Of the whole record.
    source
        For messages.
    delays
        Of inputs by name [s]; 0 by default, the servo's lag then being one of the real poles.
    poles
        Which of the common poles the test shows, as indices into those given to `fit_poles`; all by default.
    """
    z = np.exp(1j * spectra.omega * spectra.sample_period)
    return Observation(
        source,
        spectra.inputs,
        spectra.outputs,
        z,
        spectra.excitation,
        spectra.outputs_spectrum,
        np.ones(len(z)),
        _samplings(spectra.inputs, spectra.sample_period, delays),
        True,
        None if poles is None else tuple(poles),
    )


def of_response(
    measured: FrequencyResponse,
    source: str,
    delays: Mapping[str, float] | None = None,
    poles: Sequence[int] | None = None,
) -> Observation:
    """A measured transfer function for `fit_poles`: of a periodic test, or averaged.

    The lines must be independent, which neighbours of the local polynomial method are not: the poles are right
    nevertheless, their intervals too narrow.

    Parameters
    ----------
    measured
        Hold and delay included; its standard deviation says how the lines compare.
    source, delays, poles
        As in `of_spectra`.
    """
    relative = measured.sigma / np.maximum(np.median(measured.sigma, axis=0), np.finfo(float).tiny)
    level = np.sqrt(np.mean(relative**2, axis=1))
    known = level > 0
    level = np.where(known, level, level[known].min()) if known.any() else np.ones(len(level))
    z = np.exp(1j * measured.omega * measured.sample_period)
    return Observation(
        source,
        (measured.input,),
        measured.outputs,
        z,
        np.ones((len(z), 1), dtype=np.complex128),
        measured.response,
        level,
        _samplings((measured.input,), measured.sample_period, delays),
        False,
        None if poles is None else tuple(poles),
    )


def _samplings(
    inputs: tuple[str, ...], sample_period: float, delays: Mapping[str, float] | None
) -> tuple[Sampling, ...]:
    return tuple(Sampling(sample_period, HOLDS.get(name, "zero"), (delays or {}).get(name, 0.0)) for name in inputs)
