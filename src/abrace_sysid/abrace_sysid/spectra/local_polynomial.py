"""Transfer functions by the local polynomial and the local rational method, of one test or of repeated ones.

Lightly damped modes make leakage, not noise, the error that matters in the transfer functions of Figs. 3 to 5; these
methods model it away. Where a test is so short that a mode is hardly wider than a line, only the rational one does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy.ndimage import uniform_filter1d

from abrace_core.errors import AbraceError
from abrace_sysid.spectra.fourier import (
    ORDER,
    all_of,
    automatic_half_width,
    held_input,
    lines_within,
    transform,
)
from abrace_sysid.spectra.local_regression import fit_locally
from abrace_sysid.spectra.transfer_function import FrequencyResponse

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_core.run import Run
    from abrace_sysid.spectra.local_regression import LocalFit


def local_polynomial(
    run: Run | Sequence[Run], input_name: str, band: tuple[float, float], order: int = 4, half_width: int = 6
) -> FrequencyResponse:
    """Transfer functions by the local polynomial method (Schoukens et al. 2009; Pintelon and Schoukens 2012, sec. 7.2).

    Parameters
    ----------
    run
        The test, or repeated ones.
    input_name
        The only input that was excited.
    band
        Lowest and highest frequency [Hz]; the input must be excited throughout.
    order
        Of the polynomials of the response and of the transient.
    half_width
        Lines on either side; 2 half_width + 1 of them carry 2 (order + 1) unknowns.

    Raises
    ------
    AbraceError
        If the window has too few lines, or the band has fewer lines than the window.
    """
    return local_responses(run, (input_name,), band, order, half_width, poles=0)[0]


def local_rational(
    run: Run | Sequence[Run],
    input_name: str,
    band: tuple[float, float],
    order: int = ORDER,
    half_width: int | None = None,
) -> FrequencyResponse:
    """Transfer functions by the local rational method (McKelvey and Guerin 2012), one pole shared by all channels.

    Parameters
    ----------
    run
        The test, or repeated ones.
    input_name
        The only input that was excited.
    band
        Lowest and highest frequency [Hz]; the input must be excited throughout.
    order
        Of the numerators' and the transients' polynomials.
    half_width
        Lines on either side; by default what `automatic_half_width` chooses.

    Raises
    ------
    AbraceError
        If the window has too few lines, or the band has fewer lines than the window.
    """
    return local_responses(run, (input_name,), band, order, half_width)[0]


def local_responses(
    run: Run | Sequence[Run],
    inputs: Sequence[str],
    band: tuple[float, float],
    order: int = ORDER,
    half_width: int | None = None,
    poles: Literal[0, 1] = 1,
) -> tuple[FrequencyResponse, ...]:
    """One transfer function for each of the inputs that were excited together.

    Repeated tests share the response and the noise, each has a transient of its own. Tests of different length are cut
    into pieces as long as the shortest; what remains at a test's end is not used.

    Parameters
    ----------
    run
        The test, or repeated ones.
    inputs
        Names of all inputs that were excited; where there are several, they must not be proportional.
    band
        Lowest and highest frequency [Hz]; the inputs must be excited throughout.
    order
        Of the polynomials.
    half_width
        Lines on either side; by default what `automatic_half_width` chooses.
    poles
        0: local polynomial method; 1: local rational method.

    Raises
    ------
    AbraceError
        If a window has too few lines, the band has fewer lines than a window, or an input is not excited.
    """
    runs = all_of(run)
    samples = min(len(each.outputs) for each in runs)
    lines, omega = lines_within(runs[0], samples, band)
    seconds = samples * runs[0].sample_period
    half_width = automatic_half_width(seconds, len(inputs)) if half_width is None else half_width
    if len(lines) < 2 * half_width + 1 and half_width > 0:
        expected = (2 * half_width + 1) / (band[1] - band[0])
        raise AbraceError(f"{runs[0].source}: {seconds:g} s, expected at least {expected:.0f} s")
    excitation, outputs = [], []
    for each in runs:
        driven = np.column_stack([held_input(each, name) for name in inputs])
        for first in range(0, len(driven) - samples + 1, samples):
            excitation.append(transform(driven[first : first + samples])[lines])
            outputs.append(transform(each.outputs[first : first + samples])[lines])
    driven_lines = np.array(excitation)
    fit = fit_locally(driven_lines, np.array(outputs), order, half_width, poles)
    name = "local rational method" if poles else "local polynomial method"
    method = f"{name}, order {order}, half-width {half_width}"
    if len(excitation) > 1:
        method += f", {len(excitation)} records"
    return _named(fit, driven_lines, inputs, runs[0], omega, method)


def _named(
    fit: LocalFit,
    excitation: NDArray[np.complex128],
    inputs: Sequence[str],
    run: Run,
    omega: NDArray[np.float64],
    method: str,
) -> tuple[FrequencyResponse, ...]:
    """The fit's transfer functions with names and coherence; `excitation` is (records, lines, inputs)."""
    noise = fit.noise
    power = uniform_filter1d(np.mean(np.abs(excitation) ** 2, axis=0), 2 * fit.half_width + 1, axis=0)
    explained = np.abs(fit.response) ** 2 * power[:, None, :]
    total = (explained.sum(axis=2) + noise)[:, :, None]
    coherence = np.divide(explained, total, out=np.zeros_like(explained), where=total > 0)
    return tuple(
        FrequencyResponse(
            name,
            run.names,
            omega,
            np.ascontiguousarray(fit.response[:, :, i]),
            np.ascontiguousarray(fit.sigma[:, :, i]),
            run.sample_period,
            method,
            np.ascontiguousarray(coherence[:, :, i]),
        )
        for i, name in enumerate(inputs)
    )
