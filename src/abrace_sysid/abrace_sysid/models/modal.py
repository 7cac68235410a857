# SPDX-License-Identifier: Apache-2.0
"""Fitted modes as a state-space model: each pole pair one real 2 x 2 block, each real pole one state."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import linalg

from abrace_core.model.linear_model import LinearModel

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_sysid.fitting.pole_estimate import PoleEstimate


def servo_lags(estimate: PoleEstimate, highest: float) -> dict[str, float]:
    """Lag plus delay [s] of each servo, by the name of its command; only inputs that alone drive a fast real pole.

    Parameters
    ----------
    estimate
        Poles, with the part of each input that drives them.
    highest
        Highest frequency of the tests [rad/s]; real poles beyond it are fast.
    """
    found = {}
    delays = np.nan_to_num(estimate.delays)
    for name, column, delay in zip(estimate.inputs, estimate.drive.T, delays, strict=True):
        own = _fast(estimate, highest) & (column != 0)
        if own.any():
            found[name] = float(delay - np.sum(1 / estimate.poles[own].real))
    return found


def without_lags(estimate: PoleEstimate, highest: float) -> PoleEstimate:
    """The same modes, with each servo's lag replaced by a delay.

    The estimate has fewer states, and the same response far below the lag's corner frequency. Delaying an input by t
    multiplies its effect on a pole p by e^(-p t), so the input's drive of that pole is multiplied by e^(p t).

    Parameters
    ----------
    estimate, highest
        As of `servo_lags`.
    """
    fast = _fast(estimate, highest)
    lags, delays = servo_lags(estimate, highest), np.nan_to_num(estimate.delays)
    drive, direct = estimate.drive.copy(), estimate.direct.copy()
    for name, whole in lags.items():
        j = estimate.inputs.index(name)
        drive[:, j] *= np.exp(estimate.poles * (whole - delays[j]))
        own = fast & (estimate.drive[:, j] != 0)
        # far below the lag's corner frequency its state is proportional to the command: a direct term
        direct[:, j] += (estimate.shapes[:, own] @ (estimate.drive[own, j] / -estimate.poles[own])).real
        delays[j] = whole
    return replace(
        estimate,
        poles=estimate.poles[~fast],
        drive=drive[~fast],
        shapes=estimate.shapes[:, ~fast],
        direct=direct,
        delays=delays,
    )


def _fast(estimate: PoleEstimate, highest: float) -> NDArray[np.bool_]:
    """(poles,) which poles are real, faster than `highest` [rad/s] and driven by a single input."""
    alone = np.count_nonzero(estimate.drive, axis=1) == 1
    return np.asarray((estimate.poles.imag == 0) & (-estimate.poles.real > highest) & alone)


def modal_model(estimate: PoleEstimate, provenance: dict[str, Any]) -> LinearModel:
    """The continuous model of a fit by maximum likelihood: a minimal realisation with exactly the fitted response.

    Parameters
    ----------
    provenance
    estimate
        Poles, participation of the inputs (`drive`), and mode shapes.
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
    # scale the states so that the norms of B and C are equal; both states of a pair alike, so that its block stays
    into, out_of, first = np.array(drives), np.column_stack(shapes), 0
    for block in blocks:
        own = slice(first, first + len(block))
        driven, seen = np.linalg.norm(into[own]), np.linalg.norm(out_of[:, own])
        if driven * seen > 0:
            size = np.sqrt(seen / driven)
            into[own], out_of[:, own] = into[own] * size, out_of[:, own] / size
        first = own.stop
    a = linalg.block_diag(*blocks)
    return LinearModel(
        a,
        into,
        out_of,
        estimate.direct,
        estimate.inputs,
        estimate.outputs,
        input_delay=tuple(map(float, np.nan_to_num(estimate.delays))),
        provenance=provenance,
    )


def modal_covariance(estimate: PoleEstimate) -> NDArray[np.float64] | None:
    """Covariance of the parameters of `modal_model`, ordered as in `abrace_core.model.model_ensemble`; None: not known.

    Parameters
    ----------
    estimate
        The fit; its `joint` covariance is needed.
    """
    if estimate.joint is None:
        return None
    driven, seen = np.linalg.norm(estimate.drive, axis=1), np.linalg.norm(estimate.shapes, axis=0)
    size = np.ones(len(estimate.poles))
    known = driven * seen > 0
    size[known] = np.sqrt(seen[known] / driven[known])
    states = np.where(estimate.poles.imag > 0, 2, 1)
    sizes, signs = np.repeat(size, states), np.ones(states.sum())
    signs[np.cumsum(states)[states == 2] - 1] = -1  # C of a pair's second state is minus the shape's imaginary part
    inputs, outputs = len(estimate.inputs), len(estimate.outputs)
    unscaled = np.ones(outputs * inputs + inputs)  # direct terms and delays
    scale = np.concatenate([np.ones(len(sizes)), np.repeat(sizes, inputs), np.tile(signs / sizes, outputs), unscaled])
    return np.asarray(estimate.joint * np.outer(scale, scale))
