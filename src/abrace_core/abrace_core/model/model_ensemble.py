# SPDX-License-Identifier: Apache-2.0
"""Random models drawn from the uncertainty of an identified one: the joint covariance of its parameters in its file.

The parameters of a model in modal form (a 2 x 2 block [[re, -im], [im, re]] for each pole pair, one state for each real
pole) are the poles' parts, state by state, then the entries of B, C and D, row by row, and the delay of each input.
Their errors are assumed to be normal; a delay that would be drawn below zero is zero.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_core.model.linear_model import takes_models

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.model.linear_model import LinearModel

MOST_TRIES = 100
"""Draws for each requested model; stable ones are kept."""


@takes_models
def draw_models(model: LinearModel, covariance: NDArray[np.float64], count: int, seed: int) -> list[LinearModel]:
    """Models drawn from the covariance of an identified one.

    Draws with an unstable pole are repeated, as a passive structure is stable.

    Parameters
    ----------
    model
        Continuous, in modal form.
    covariance
        (parameters, parameters), in the order above.
    count
        Number of models.
    seed
        Seed of the draws.

    Raises
    ------
    AbraceError
        If the covariance is not that of such a model, or hardly a draw is stable.
    """
    states = model.order
    size = states + model.b.size + model.c.size + model.d.size + len(model.inputs)
    if covariance.shape != (size, size) or not np.isfinite(covariance).all():
        raise AbraceError(f"covariance of a model: shape {covariance.shape}, expected {(size, size)}, finite")
    blocks = _blocks(model)
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0))
    unit = np.where(deviation > 0, deviation, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    factor = deviation[:, None] * vectors * np.sqrt(np.maximum(values, 0))
    generator = np.random.default_rng(seed)
    ends = states + np.cumsum([model.b.size, model.c.size, model.d.size])
    found: list[LinearModel] = []
    for _ in range(MOST_TRIES * count):
        if len(found) == count:
            break
        poles, *entries, delays = np.split(factor @ generator.standard_normal(size), [states, *ends])
        a = model.a.copy()
        for first, last in blocks:
            a[first, first] += poles[first]
            if last > first:
                a[last, last] += poles[first]
                a[last, first] += poles[last]
                a[first, last] -= poles[last]
        if (np.linalg.eigvals(a).real < 0).all():
            b, c, d = (
                matrix + change.reshape(matrix.shape)
                for matrix, change in zip((model.b, model.c, model.d), entries, strict=True)
            )
            later = tuple(np.maximum(np.add(model.input_delay, delays), 0.0).tolist())
            found.append(replace(model, a=a, b=b, c=c, d=d, input_delay=later))
    if len(found) < count:
        raise AbraceError(
            f"covariance of a model: {len(found)} of {MOST_TRIES * count} draws are stable, expected more"
        )
    return found


def _blocks(model: LinearModel) -> list[tuple[int, int]]:
    """First and last state of each block of A."""
    found, first, rest = [], 0, model.a.copy()
    while first < model.order:
        last = first + int(first + 1 < model.order and model.a[first, first + 1] != 0)
        own = slice(first, last + 1)
        rest[own, own] = 0
        found.append((first, last))
        first = last + 1
    if model.sample_period or rest.any():
        raise AbraceError("covariance of a model that is not continuous and in modal form, expected one of identify")
    return found
