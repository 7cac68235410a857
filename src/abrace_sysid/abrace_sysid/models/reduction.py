# SPDX-License-Identifier: Apache-2.0
"""Balanced truncation (Moore 1981) of models with redundant states: Eq. (9) of the paper.

In SI units the Gramians of the table's motion are 1e9 times those of the command. So inputs and outputs are scaled
first: each input by its rms in the tests, each output by its rms under these inputs. A model may contain a building
pole several times, once for each input; copies that coincide are removed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from abrace_core import AbraceError
from abrace_core.model.linear_model import balanced, takes_models

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from abrace_core.model.linear_model import LinearModel

SIGNIFICANT = 0.01
"""Without a given order a state is kept if its Hankel singular value is at least this share of the greatest."""

NEGLIGIBLE = 1e-7
"""A state is uncontrollable or unobservable if its Hankel singular value is below this share of the greatest.

Rounding errors in the square root of a singular Gramian are of this size.
"""

LINES = 4000
"""Number of logarithmically spaced frequencies for integrals over a band."""


@dataclass(frozen=True)
class Scales:
    """The balancing unit of each signal: `inputs` (inputs,) and `outputs` (outputs,), in SI units."""

    inputs: NDArray[np.float64]
    outputs: NDArray[np.float64]


@dataclass(frozen=True)
class Reduction:
    """A reduced model, the model before reduction, and its Hankel singular values.

    Parameters
    ----------
    model
        The reduced model, in SI units, with the signal names and delays of the original.
    hankel_singular_values
        (states,) of the original model in balancing units, greatest first.
    """

    model: LinearModel
    whole: LinearModel
    hankel_singular_values: NDArray[np.float64]


@takes_models
def typical_scales(model: LinearModel, band: tuple[float, float], intensity: Mapping[str, float]) -> Scales:
    """Balancing units: the rms of each input, and the rms that the model predicts for each output under these inputs.

    The inputs are independent, with a white spectrum within the band; no controller acts.

    Parameters
    ----------
    intensity
    model
        Continuous model.
    band
        [Hz].
    """
    inputs = np.array([intensity[name] for name in model.inputs])
    omega, share = _white_noise(band)
    outputs = np.sqrt(np.einsum("fpm,f->p", np.abs(model.frequency_response(omega) * inputs) ** 2, share))
    silent = [name for name, rms in zip(model.outputs, outputs, strict=True) if rms == 0]
    if silent:
        raise AbraceError(f"balancing: output {', '.join(silent)} responds to no input")
    return Scales(inputs, outputs)


@takes_models
def balanced_truncation(model: LinearModel, states: int, scales: Scales) -> Reduction:
    """Reduce a continuous stable model by balanced truncation (square-root method).

    Parameters
    ----------
    model
        Continuous and stable. Uncontrollable or unobservable states are allowed; they are removed first.
    states
        Order of the reduced model; 0: the number of Hankel singular values of at least SIGNIFICANT times the greatest.
    scales
        The balancing units.

    Raises
    ------
    AbraceError
        If the model is discrete or unstable, has fewer controllable and observable states than `states`, or the
        reduced model is unstable.
    """
    if model.sample_period or not model.is_stable():
        raise AbraceError("balanced truncation: expected a continuous, stable model")
    whole = model
    model = balanced(model)  # rounding should affect only weak states
    b, c = model.b * scales.inputs, model.c / scales.outputs[:, None]
    controllability = _gramian_root(model.a, b)
    observability = _gramian_root(model.a.T, c.T)
    left, hankel, right = linalg.svd(observability.T @ controllability)
    significant = int(np.sum(hankel > NEGLIGIBLE * hankel[0]))
    states = states or int(np.sum(hankel >= SIGNIFICANT * hankel[0]))
    if not 1 <= states <= significant:
        raise AbraceError(
            f"balanced truncation to {states} states, expected 1 to {significant}: no more of them matter"
        )
    root = np.sqrt(hankel[:states])
    into = (left[:, :states] / root).T @ observability.T
    out_of = controllability @ (right[:states].T / root)
    reduced = replace(model, a=into @ model.a @ out_of, b=into @ model.b, c=model.c @ out_of)
    if not reduced.is_stable():
        raise AbraceError(
            f"balanced truncation to {states} states: the reduced model is unstable, expected another order"
        )
    return Reduction(reduced, whole, hankel)


def _white_noise(band: tuple[float, float]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Angular frequencies [rad/s] over a band [Hz] and the share of white noise's power in each."""
    omega = 2 * np.pi * np.geomspace(*band, LINES)
    return omega, np.gradient(omega) / (2 * np.pi * (band[1] - band[0]))


def _gramian_root(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """L with L L' = the Gramian of (A, B); unlike Cholesky's method it allows a singular Gramian."""
    gramian = linalg.solve_continuous_lyapunov(a, -b @ b.T)
    values, vectors = linalg.eigh((gramian + gramian.T) / 2)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
