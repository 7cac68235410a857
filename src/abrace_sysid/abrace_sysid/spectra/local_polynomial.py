# SPDX-License-Identifier: Apache-2.0
"""Transfer functions by the local polynomial and the local rational method, of one test or of repeated ones.

With lightly damped modes leakage, not noise, dominates the error of the transfer functions in Figs. 3 to 5. These
methods estimate the leakage and remove it. If a test is so short that a mode is hardly wider than a line, only the
rational method succeeds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from abrace_core.errors import AbraceError
from abrace_sysid.spectra.fourier import held_input, lines_within, transform
from abrace_sysid.spectra.frequency_response import FrequencyResponse
from abrace_sysid.spectra.holds import hold_of
from abrace_sysid.spectra.local_regression import fit_locally

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_core.run import Run
    from abrace_sysid.measured_data import MeasuredData


def local_responses(
    runs: Sequence[Run] | Sequence[MeasuredData],
    inputs: Sequence[str],
    band: tuple[float, float],
    order: int,
    half_width: int,
    poles: Literal[0, 1],
) -> tuple[FrequencyResponse, ...]:
    """One transfer function for each of the inputs that were excited at once.

    Repeated tests share response and noise level; each has its own transient. Tests of different length are cut into
    pieces as long as the shortest; the remainder at the end of a test is not used.

    Parameters
    ----------
    runs
        The test, or repeated ones of the same rig.
    inputs
        Names of all inputs that were excited; where there are several, they must not be proportional.
    band
        Lowest and highest frequency [Hz]; the inputs must be excited throughout.
    order
        Order of the polynomials of the response (in the rational method of its numerator) and of the transient.
    half_width
        Lines on either side of the centre line; the unknowns are estimated from 2 half_width + 1 lines.
    poles
        0: local polynomial method (Schoukens et al. 2009; Pintelon and Schoukens 2012, sec. 7.2); 1: local rational
        method (McKelvey and Guerin 2012), one pole shared by all channels.

    Raises
    ------
    AbraceError
        If a window has too few lines, the band has fewer lines than a window, or an input is not excited.
    """
    samples = min(len(run.outputs) for run in runs)
    lines, omega = lines_within(runs[0], samples, band)
    if len(lines) < 2 * half_width + 1 and half_width > 0:
        seconds, expected = samples * runs[0].sample_period, (2 * half_width + 1) / (band[1] - band[0])
        raise AbraceError(f"{runs[0].source}: {seconds:g} s, expected at least {expected:.0f} s")
    excitation, outputs = [], []
    for run in runs:
        driven = np.column_stack([held_input(run, name) for name in inputs])
        for first in range(0, len(driven) - samples + 1, samples):
            excitation.append(transform(driven[first : first + samples])[lines])
            outputs.append(transform(run.outputs[first : first + samples])[lines])
    response, sigma = fit_locally(np.array(excitation), np.array(outputs), order, half_width, poles)
    method = f"local {'rational' if poles else 'polynomial'} method, order {order}, half-width {half_width}"
    if len(excitation) > 1:
        method += f", {len(excitation)} records"
    return tuple(
        FrequencyResponse(
            name,
            runs[0].names,
            omega,
            np.ascontiguousarray(response[:, :, i]),
            np.ascontiguousarray(sigma[:, :, i]),
            runs[0].sample_period,
            method,
            hold_of(runs[0], name),
        )
        for i, name in enumerate(inputs)
    )
