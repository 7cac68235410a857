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

from abrace_core.errors import AbraceError
from abrace_core.linear_model import takes_models

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel

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
    """A reduced model and the Hankel singular values of the model before reduction.

    Parameters
    ----------
    model
        The reduced model, in SI units, with the signal names and delays of the original.
    hankel_singular_values
        (states,) of the original model in balancing units, greatest first.
    """

    model: LinearModel
    hankel_singular_values: NDArray[np.float64]

    @property
    def error_bound(self) -> float:
        """Upper bound of the frequency response's error, in balancing units: twice the sum of the values left out."""
        return float(2 * self.hankel_singular_values[self.model.order :].sum())


@takes_models
def typical_scales(model: LinearModel, band: tuple[float, float], intensity: Mapping[str, float]) -> Scales:
    """Balancing units: the rms of each input, and the rms that the model predicts for each output under these inputs.

    The inputs are independent, with a white spectrum within the band; no controller acts.

    Parameters
    ----------
    model
        Continuous model.
    band
        [Hz].
    intensity
        Rms of each input by name.
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
    # balance A: states in different units differ by many powers of ten, and rounding should affect only weak states
    _, (size, _) = linalg.matrix_balance(model.a, permute=False, separate=True)
    model = replace(model, a=model.a * size / size[:, None], b=model.b / size[:, None], c=model.c * size)
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
    return Reduction(reduced, hankel)


@dataclass(frozen=True)
class OrderErrors:
    """Errors of the reduced models of each order.

    Parameters
    ----------
    orders
        (n,) numbers of states of the reduced models.
    achieved
        (n, outputs, inputs) relative error of each channel, as `relative_errors` gives it; NaN where that order has no
        stable reduced model.
    """

    orders: NDArray[np.int64]
    achieved: NDArray[np.float64]


@takes_models
def relative_errors(model: LinearModel, reduced: LinearModel, band: tuple[float, float]) -> NDArray[np.float64]:
    """Rms error of each output over its rms, under each input alone as white noise within a band (relative H2 norm).

    Parameters
    ----------
    model, reduced
        Continuous, with the same inputs and outputs.
    band
        [Hz].

    Returns
    -------
    NDArray
        (outputs, inputs); NaN where `model` gives no response at all.
    """
    omega, share = _white_noise(band)
    whole = model.frequency_response(omega)
    difference = reduced.frequency_response(omega) - whole
    error, size = (np.einsum("fpm,f->pm", np.abs(response) ** 2, share) for response in (difference, whole))
    return np.sqrt(np.divide(error, size, out=np.full_like(size, np.nan), where=size > 0))


@takes_models
def errors_by_order(model: LinearModel, scales: Scales, band: tuple[float, float]) -> OrderErrors:
    """Errors of the reduced models of every possible order.

    Parameters
    ----------
    model
        The model to be reduced, as in `balanced_truncation`.
    scales
        The balancing units.
    band
        Band [Hz] of the white noise under which the errors are computed.
    """
    hankel = balanced_truncation(model, 1, scales).hankel_singular_values
    orders = np.arange(1, int(np.sum(hankel > NEGLIGIBLE * hankel[0])) + 1)
    achieved = np.full((len(orders), len(model.outputs), len(model.inputs)), np.nan)
    for i, states in enumerate(orders):
        try:
            reduced = balanced_truncation(model, int(states), scales).model
        except AbraceError:
            continue  # unstable by rounding: the last value kept and the first left out are equal
        achieved[i] = relative_errors(model, reduced, band)
    return OrderErrors(orders, achieved)


def _white_noise(band: tuple[float, float]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Angular frequencies [rad/s] over a band [Hz] and the share of white noise's power in each."""
    omega = 2 * np.pi * np.geomspace(*band, LINES)
    return omega, np.gradient(omega) / (2 * np.pi * (band[1] - band[0]))


def _gramian_root(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """L with L L' = the Gramian of (A, B); unlike Cholesky's method it allows a singular Gramian."""
    gramian = linalg.solve_continuous_lyapunov(a, -b @ b.T)
    values, vectors = linalg.eigh((gramian + gramian.T) / 2)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
