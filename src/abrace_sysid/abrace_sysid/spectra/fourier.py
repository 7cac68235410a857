# SPDX-License-Identifier: Apache-2.0
"""Discrete Fourier transforms of a whole recorded test, from which transfer functions and likelihood are computed.

At every line k the sampled rig obeys Y(k) = G(k) U(k) + T(k) + V(k). U are the inputs that act from each sample on. T
is the transient (leakage), caused by the difference of the states at the record's two ends. V is the noise (Pintelon
and Schoukens 2012, sec. 2.6).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from scipy import fft

from abrace_core.errors import AbraceError
from abrace_core.run import Run
from abrace_sysid.measured_data import MeasuredData
from abrace_sysid.spectra.holds import hold_of
from abrace_sysid.spectra.local_regression import least_half_width

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.spectra.holds import InputHold

Test = TypeVar("Test", Run, MeasuredData)
"""A test of a rig, or measured data."""

ORDER = 2
"""Order of the numerator and transient polynomials in local rational fits: as accurate as higher orders, less noise."""


@dataclass(frozen=True)
class Spectra:
    """Transforms of one test's inputs and outputs within a band.

    Parameters
    ----------
    inputs, outputs
        Names of the signals.
    omega
        (lines,) [rad/s], consecutive lines of the whole record, rising.
    excitation
        (lines, inputs) complex transforms of the inputs, over the square root of the number of samples.
    outputs_spectrum
        (lines, channels) complex transforms of the outputs, in the same scale.
    sample_period
        Seconds.
    holds
        How each input moves between samples.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    omega: NDArray[np.float64]
    excitation: NDArray[np.complex128]
    outputs_spectrum: NDArray[np.complex128]
    sample_period: float
    holds: tuple[InputHold, ...]

    def select(self, outputs: Sequence[str]) -> Spectra:
        """The same spectra with only these outputs, in this order."""
        columns = [self.outputs.index(name) for name in outputs]
        return replace(self, outputs=tuple(outputs), outputs_spectrum=self.outputs_spectrum[:, columns])


def spectra_of(run: Run | MeasuredData, inputs: Sequence[str], band: tuple[float, float]) -> Spectra:
    """The spectra of a whole test.

    Parameters
    ----------
    run
        The test.
    inputs
        Names of all inputs that were excited.
    band
        Lowest and highest frequency [Hz]; the inputs must be excited throughout.

    Raises
    ------
    AbraceError
        If a name is unknown or the band has no line.
    """
    lines, omega = lines_within(run, len(run.outputs), band)
    excitation = transform(np.column_stack([held_input(run, name) for name in inputs]))[lines]
    holds = tuple(hold_of(run, name) for name in inputs)
    return Spectra(tuple(inputs), run.names, omega, excitation, transform(run.outputs)[lines], run.sample_period, holds)


def automatic_half_width(seconds: float, inputs: int, bandwidth: float) -> int:
    """Half-width [lines] of the local rational method's windows, from the length of the record.

    More lines average more noise, but a single pole must describe the response in the whole window. The window reaches
    6 half-power bandwidths of the narrowest resonance to either side. More than 20 lines improve little, and fewer than
    4 for each input are too few.

    Parameters
    ----------
    seconds
        Length of the record.
    inputs
        Number of inputs that were excited.
    bandwidth
        Half-power bandwidth 2 zeta omega [rad/s] of the narrowest expected resonance.
    """
    reach = 6 * bandwidth * seconds / (2 * np.pi)
    return int(np.clip(round(reach), least_half_width(ORDER, inputs) + 3, 20))


def runs_of_one_rig(run: Test | Sequence[Test]) -> tuple[Test, ...]:
    """The test or tests `run` as a tuple.

    Raises
    ------
    AbraceError
        If there is no test, or channels or sample periods differ.
    """
    runs = (run,) if isinstance(run, Run | MeasuredData) else tuple(run)
    if not runs:
        raise AbraceError("transfer functions: no test, expected at least one")
    for other in runs[1:]:
        for what, one, two in (
            ("channels", runs[0].names, other.names),
            ("sample period", runs[0].sample_period, other.sample_period),
        ):
            if one != two:
                raise AbraceError(f"{other.source}: {what} {two}, but {one} in {runs[0].source}: expected the same rig")
    return runs


def held_input(run: Run | MeasuredData, name: str) -> NDArray[np.float64]:
    """(samples,) the input `name` of `run`: ground acceleration at each sample, or the command that acts from it on."""
    if isinstance(run, Run) and name in run.command_names:
        return run.command_from_here[:, run.command_names.index(name)]
    return run.channels([name])[:, 0]


def lines_within(
    run: Run | MeasuredData, samples: int, band: tuple[float, float]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Numbers and angular frequencies [rad/s] of the lines of a transform within a band.

    Parameters
    ----------
    run
        The test; its sample period, and its name for the message, are used.
    samples
        Number of samples transformed.
    band
        Lowest and highest frequency [Hz].

    Raises
    ------
    AbraceError
        If the band has no line.
    """
    frequency = np.arange(samples // 2) / (samples * run.sample_period)
    lines = np.flatnonzero((frequency >= band[0]) & (frequency <= band[1]) & (frequency > 0))
    if not len(lines):
        raise AbraceError(f"{run.source}: no frequency line between {band[0]:g} and {band[1]:g} Hz")
    return lines, 2 * np.pi * frequency[lines]


def transform(series: NDArray[np.float64]) -> NDArray[np.complex128]:
    """(lines, columns) transform of `series` (samples, columns), means removed, over the square root of the length."""
    transformed: NDArray[np.complex128] = fft.rfft(series - series.mean(axis=0), axis=0)
    return transformed / np.sqrt(len(series))
