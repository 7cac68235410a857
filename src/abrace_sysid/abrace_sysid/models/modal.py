"""Fitted modes as a state-space model: each pole pair one real 2 x 2 block, each real pole one state."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import linalg

from abrace_core.linear_model import LinearModel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_sysid.fitting.pole_estimate import PoleEstimate


def modal_model(estimate: PoleEstimate, provenance: dict[str, Any]) -> LinearModel:
    """The continuous model that a fit by maximum likelihood is: minimal, its numerators those of the likelihood.

    Parameters
    ----------
    estimate
        Poles, what the inputs drive of them, and shapes.
    provenance
        Of the model.
    """
    blocks: list[NDArray[np.float64]] = []
    drives: list[NDArray[np.float64]] = []
    shapes: list[NDArray[np.float64]] = []
    for pole, drive, shape in zip(estimate.poles, estimate.drive, estimate.shapes.T, strict=True):
        # q' = p q + drive u and y = Re(shape q), with the states Re q and Im q
        if pole.imag > 0:
            blocks.append(np.array([[pole.real, -pole.imag], [pole.imag, pole.real]]))
            drives += [drive.real, drive.imag]
            shapes += [shape.real, -shape.imag]
        else:
            blocks.append(np.array([[pole.real]]))
            drives.append(drive.real)
            shapes.append(shape.real)
    # states of a size between those of the input and of the output; a pair's two alike, so that its block stays
    into, out_of, first = np.array(drives), np.column_stack(shapes), 0
    for block in blocks:
        own = slice(first, first + len(block))
        driven, seen = np.linalg.norm(into[own]), np.linalg.norm(out_of[:, own])
        if driven * seen > 0:
            size = np.sqrt(seen / driven)
            into[own], out_of[:, own] = into[own] * size, out_of[:, own] / size
        first = own.stop
    a = linalg.block_diag(*blocks)
    return LinearModel(a, into, out_of, estimate.direct, estimate.inputs, estimate.outputs, provenance=provenance)


def modal_covariance(estimate: PoleEstimate) -> NDArray[np.float64] | None:
    """The covariance of the parameters of `modal_model`, as `abrace_core.model_ensemble` has them; None: not known.

    Parameters
    ----------
    estimate
        Of which the covariance of all of it was asked for.
    """
    if estimate.joint is None:
        return None
    driven, seen = np.linalg.norm(estimate.drive, axis=1), np.linalg.norm(estimate.shapes, axis=0)
    size = np.ones(len(estimate.poles))
    known = driven * seen > 0
    size[known] = np.sqrt(seen[known] / driven[known])
    states = np.where(estimate.poles.imag > 0, 2, 1)
    sizes, signs = np.repeat(size, states), np.ones(states.sum())
    signs[np.cumsum(states)[states == 2] - 1] = -1  # the second state of a pair is seen by minus the imaginary part
    inputs, outputs = len(estimate.inputs), len(estimate.outputs)
    scale = np.concatenate(
        [np.ones(len(sizes)), np.repeat(sizes, inputs), np.tile(signs / sizes, outputs), np.ones(outputs * inputs)]
    )
    return np.asarray(estimate.joint * np.outer(scale, scale))
