# SPDX-License-Identifier: Apache-2.0
"""Discrete Fourier transforms of a whole recorded test, from which transfer functions and likelihood are computed.

At every line k the sampled rig obeys Y(k) = G(k) U(k) + T(k) + V(k). U are the inputs that act from each sample on. T
is the transient (leakage), caused by the difference of the states at the record's two ends. V is the noise (Pintelon
and Schoukens 2012, sec. 2.6).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_sysid.spectra.local_regression import least_half_width

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_sysid.recorded.test import Test

WIDEST = 20
"""Greatest half-width [lines] that is chosen for local rational fits: more lines improve little."""

DEGREE = 2
"""Degree of the numerator and transient polynomials in local rational fits: as accurate as higher ones, less noise."""


def automatic_half_width(seconds: float, inputs: int, bandwidth: float) -> int:
    """Half-width [lines] of the local rational method's windows, from the length of the record.

    More lines average more noise, but a single pole must describe the response in the whole window. The window reaches
    6 half-power bandwidths of the narrowest resonance to either side. Fewer than 4 lines for each input are too few.

    Parameters
    ----------
    seconds
    inputs
        Number of inputs that were excited.
    bandwidth
        Half-power bandwidth 2 zeta omega [rad/s] of the narrowest expected resonance.
    """
    reach = 6 * bandwidth * seconds / (2 * np.pi)
    return int(np.clip(round(reach), least_half_width(DEGREE, inputs) + 3, WIDEST))


def lines_within(test: Test, samples: int, band: tuple[float, float]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Numbers and angular frequencies [rad/s] of the lines of a transform within a band.

    Parameters
    ----------
    samples
    test
        The test; its sample period, and its name for the message, are used.
    band
        Lowest and highest frequency [Hz].

    Raises
    ------
    AbraceError
        If the band has no line.
    """
    frequency = np.arange(samples // 2) / (samples * test.sample_period)
    lines = np.flatnonzero((frequency >= band[0]) & (frequency <= band[1]) & (frequency > 0))
    if not len(lines):
        raise AbraceError(f"{test.source}: no frequency line between {band[0]:g} and {band[1]:g} Hz")
    return lines, 2 * np.pi * frequency[lines]
