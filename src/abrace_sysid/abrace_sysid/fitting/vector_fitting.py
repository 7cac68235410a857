# SPDX-License-Identifier: Apache-2.0
"""Vector fitting: poles common to all channels of a measured transfer function (Gustavsen and Semlyen 1999).

The relaxed form (Gustavsen 2006), each channel condensed by its own orthogonal factorisation (Deschrijver et al. 2008),
so that the computing time is proportional to lines and channels. The measured response is that of the sampled rig, a
ratio of polynomials in z = exp(i w T), not in s: the fractions are 1 / (z - a) with a = exp(p T), and the hold needs no
compensation. The servo's lag is a fast real pole.

Poles outside the unit circle are mirrored into it before the next iteration. The poles of the last iteration are not:
`vector_fitting` refuses an unstable pole within the band, `fit_common_poles` returns it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from abrace_core import AbraceError
from abrace_sysid.fitting.curve_fit import (
    least_squares,
    require_stable,
    stacked,
    triangular_factor,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_sysid.spectra.frequency_response import FrequencyResponse

ITERATIONS = 30

CONVERGED = 1e-6
"""Relative movement of every pole that ends the iterations."""

START_DAMPING = 0.01

HEAVY_DAMPING = 0.3
"""Pairs with more damping are not modes of a building: they compensate for errors of the model."""


@dataclass(frozen=True)
class VectorFit:
    """Poles and residues of a fit.

    Parameters
    ----------
    poles
        [rad/s]: of each pair the one above the real axis, then real ones, each slowest first. May be unstable.
    shapes
        (poles, channels) complex: residues of the fractions 1 / (z - a), the mode shapes of the channels.
    strength
        (poles,) greatest peak |residue| / (1 - |a|) in any channel, as a share of that channel's rms response.
    misfit
        Mean weighted square error.
    """

    poles: NDArray[np.complex128]
    shapes: NDArray[np.complex128]
    strength: NDArray[np.float64]
    misfit: float


def vector_fitting(measured: FrequencyResponse, order: int) -> VectorFit:
    """Common poles of all channels.

    Parameters
    ----------
    order
    measured
        The response, hold and delays included; channels are weighted by their mean variance, all lines equally.

    Raises
    ------
    AbraceError
        If there are too few lines, or a pole that is not above the band is unstable.
    """
    fit = fit_common_poles(measured, order, _channel_weights(measured))
    # faster ones are no modes of the rig but stand for noise and misfit, and are not used
    require_stable(fit.poles[fit.poles.imag <= measured.omega[-1]], f"vector fitting of order {order}")
    return fit


def fit_common_poles(
    measured: FrequencyResponse,
    order: int,
    weights: NDArray[np.float64],
    iterations: int = ITERATIONS,
    converged: float = CONVERGED,
) -> VectorFit:
    """As `vector_fitting`, unstable poles included.

    Parameters
    ----------
    measured, order
        As for `vector_fitting`.
    weights
        (lines, channels) weights of the squared errors.
    iterations
        Greatest number of iterations.
    converged
        Relative movement of every pole that ends them.

    Raises
    ------
    AbraceError
        If there are too few lines, or a value is not finite.
    """
    lines = len(measured.omega)
    if order < 1 or 2 * lines <= 2 * order + 2:
        raise AbraceError(f"vector fitting: order {order} and {lines} frequency lines, expected order < lines - 1")
    if not np.isfinite(measured.response).all():
        raise AbraceError("vector fitting: the transfer function has a value that is not finite")
    period = measured.sample_period
    z = np.exp(1j * measured.omega * period)
    root = np.sqrt(weights)
    frequencies = np.linspace(measured.omega[0], measured.omega[-1], order // 2 + 2)[1:-1]
    pairs = frequencies * complex(-START_DAMPING, 1.0)
    reals = np.full(order % 2, -frequencies.mean() if len(frequencies) else -measured.omega.mean())
    a = np.exp(np.concatenate([pairs, reals]) * period)
    for _ in range(iterations):
        inside = np.where(np.abs(a) > 1, 1 / a.conj(), a)
        relocated = _relocated(z, measured.response, root, inside)
        same = len(relocated) == len(a) and np.abs(relocated - a).max() <= converged * np.abs(a - 1).min()
        a = relocated
        if same:
            break
    basis = np.column_stack([_fractions(z, a), np.ones(lines)])
    residues, squares = np.empty((len(a), measured.response.shape[1]), dtype=np.complex128), 0.0
    for channel, (g, weight) in enumerate(zip(measured.response.T, root.T, strict=True)):
        coefficients = least_squares(basis * weight[:, None], (g * weight)[:, None])[:, 0]
        residues[:, channel] = _complex_residues(a, coefficients[:-1])
        squares += float(np.sum(np.abs(weight * (basis @ coefficients - g)) ** 2))
    size = np.sqrt(np.mean(np.abs(measured.response) ** 2, axis=0))
    peak = np.abs(residues) / np.maximum(np.abs(1 - np.abs(a)), np.finfo(float).eps)[:, None]
    # a negative real a, which no rig has, shows as a pole that oscillates at half the sample rate
    poles = np.asarray(np.log(a) / period).astype(np.complex128)
    strength = np.max(peak / np.where(size > 0, size, 1.0), axis=1)
    return VectorFit(poles, residues, strength, squares / measured.response.size)


def modes_of(fit: VectorFit, measured: FrequencyResponse) -> NDArray[np.complex128]:
    """The poles of a `fit` that are modes: stable, oscillating within the band `measured`; the strongest first."""
    within = (fit.poles.imag > measured.omega[0]) & (fit.poles.imag < measured.omega[-1])
    modes = np.flatnonzero(within & (fit.poles.real < 0) & (-fit.poles.real < HEAVY_DAMPING * np.abs(fit.poles)))
    return np.asarray(fit.poles[modes[np.argsort(-fit.strength[modes], kind="stable")]])


def _fractions(z: NDArray[np.complex128], a: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """(lines, order) the real combinations of 1 / (z - a) and its conjugate of each pair, 1 / (z - a) of a real a."""
    columns: list[NDArray[np.complex128]] = []
    for pole in a:
        if pole.imag > 0:
            above, below = 1 / (z - pole), 1 / (z - pole.conjugate())
            columns += [above + below, 1j * (above - below)]
        else:
            columns.append(1 / (z - pole.real))
    return np.column_stack(columns)


def _channel_weights(measured: FrequencyResponse) -> NDArray[np.float64]:
    """(lines, channels) 1 / mean variance of a channel; for exact responses, of a billionth of its rms.

    Weights by each line's own uncertainty would be small at a resonance, where errors are large, but the pole shows.
    """
    size = np.sqrt(np.mean(np.abs(measured.response) ** 2, axis=0))
    noise = np.maximum(np.sqrt(np.mean(measured.sigma**2, axis=0)), 1e-9 * size)
    weight = np.divide(1.0, noise**2, out=np.zeros_like(noise), where=noise > 0)
    return np.broadcast_to(weight, measured.response.shape)


def _relocated(
    z: NDArray[np.complex128], response: NDArray[np.complex128], root: NDArray[np.float64], a: NDArray[np.complex128]
) -> NDArray[np.complex128]:
    """The new poles: zeros of sigma(z) = d + sum c / (z - a), where sigma times the response has the poles a."""
    fractions = np.column_stack([_fractions(z, a), np.ones(len(z))])
    order = fractions.shape[1] - 1
    scale = np.linalg.norm(fractions, axis=0)
    fractions = np.asfortranarray(fractions / scale)
    condensed: list[NDArray[np.float64]] = []
    for g, weight in zip(response.T, root.T, strict=True):
        weighted = fractions * weight[:, None]
        columns = np.hstack([weighted, -weighted * g[:, None]])
        condensed.append(triangular_factor(stacked(columns))[order + 1 :, order + 1 :])
    rows = np.vstack(condensed)
    # the relaxed condition: sigma is 1 on average over the lines, with the same weight as the other equations
    importance = np.linalg.norm(root * response) / len(z)
    condition = importance * fractions.real.sum(axis=0)
    right = np.concatenate([np.zeros(len(rows)), [importance * len(z)]])
    solution = np.linalg.lstsq(np.vstack([rows, condition]), right, rcond=None)[0] / scale
    c, d = solution[:-1], solution[-1]
    d = np.copysign(max(abs(d), 1e-8), d)
    blocks, drive = [], []
    for pole in a:
        if pole.imag > 0:
            blocks.append(np.array([[pole.real, pole.imag], [-pole.imag, pole.real]]))
            drive += [2.0, 0.0]
        else:
            blocks.append(np.array([[pole.real]]))
            drive.append(1.0)
    state_matrix = linalg.block_diag(*blocks) - np.outer(drive, c) / d
    zeros = np.asarray(linalg.eigvals(state_matrix), dtype=np.complex128)
    upper, real = zeros[zeros.imag > 0], zeros[zeros.imag == 0]
    return np.concatenate([upper[np.argsort(np.abs(np.log(upper)))], real[np.argsort(-np.abs(real))]])


def _complex_residues(a: NDArray[np.complex128], coefficients: NDArray[np.float64]) -> NDArray[np.complex128]:
    residues, column = np.empty(len(a), dtype=np.complex128), 0
    for i, pole in enumerate(a):
        if pole.imag > 0:
            residues[i] = coefficients[column] + 1j * coefficients[column + 1]
            column += 2
        else:
            residues[i] = coefficients[column]
            column += 1
    return residues
