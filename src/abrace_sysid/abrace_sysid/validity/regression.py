# SPDX-License-Identifier: Apache-2.0
"""Linear regression over frequency lines, with standard deviations that are valid for coloured noise."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg
from scipy.ndimage import uniform_filter1d

from abrace_sysid.fitting.curve_fit import triangular_factor

if TYPE_CHECKING:
    from numpy.typing import NDArray

SMOOTHED = 101
"""Lines over which the residual's power is averaged, for the weights."""

REWEIGHTINGS = 3


def regression(
    measured: NDArray[np.complex128], columns: NDArray[np.complex128]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Real coefficients of complex `columns` in `measured`, weighted by the inverse of the residual's smoothed power.

    Parameters
    ----------
    measured
        (lines,).
    columns
        (lines, regressors), independent.

    Returns
    -------
    coefficients, deviations
        (regressors,) coefficients and standard deviations; these follow from each line's residual (White 1980).
    """
    lines = len(measured)
    both, values = np.vstack([columns.real, columns.imag]), np.concatenate([measured.real, measured.imag])
    weight = np.ones(2 * lines)
    for _ in range(REWEIGHTINGS):
        weighted = both * weight[:, None]
        scale = np.linalg.norm(weighted, axis=0)
        # with the measured values as the last column Q, the dearest part, is not needed
        triangle = triangular_factor(np.column_stack([weighted / scale, values * weight]))
        r = triangle[:-1, :-1]
        coefficients = linalg.solve_triangular(r, triangle[:-1, -1]) / scale
        residual = values - both @ coefficients
        power = uniform_filter1d(residual[:lines] ** 2 + residual[lines:] ** 2, min(SMOOTHED, lines), mode="reflect")
        level = np.sqrt(np.maximum(power, np.finfo(float).tiny) / 2)
        used, weight = weight, 1 / np.concatenate([level, level])
    score = (both * used[:, None] / scale) * (residual * used)[:, None]
    clusters = score[:lines] + score[lines:]
    inverse = linalg.solve_triangular(r, np.eye(len(r)))
    spread = inverse @ (inverse.T @ clusters.T)
    return coefficients, np.linalg.norm(spread, axis=1) / scale


def leakage(omega: NDArray[np.float64]) -> NDArray[np.complex128]:
    """(lines, 4) regressors at `omega` of the leakage in derivatives of a record with unequal ends: a + b i w.

    a and b are complex.
    """
    return np.column_stack([np.ones(len(omega)), 1j * np.ones(len(omega)), 1j * omega, omega]).astype(np.complex128)
