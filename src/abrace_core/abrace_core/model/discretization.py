# SPDX-License-Identifier: Apache-2.0
"""The exact discrete equivalent of a continuous model: holds and input delays.

The command is held between samples (zero-order hold); the ground acceleration is assumed linear between samples
(first-order hold), which needs no half-sample shift when a recorded motion is compared with its response.
python-control's `sample_system` has one hold for all inputs and no delays, and takes too long to import for a rig.
"""

from __future__ import annotations

from numbers import Real
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy import linalg

from abrace_core import AbraceError
from abrace_core.model import signals
from abrace_core.model.linear_model import LinearModel, takes_models

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

Hold = Literal["zero", "first"]
"""How an input moves between samples: held at its value, or linearly to the next one."""

HOLDS: Mapping[str, Hold] = {signals.GROUND: "first"}
"""Holds of the rig's inputs; those not named are held."""


@takes_models
def holds_of(model: LinearModel) -> dict[str, Hold]:
    """`HOLDS` of the inputs of a `model` that have no delay, which a first-order hold cannot take."""
    return {
        name: HOLDS[name]
        for name, delay in zip(model.inputs, model.input_delay, strict=True)
        if name in HOLDS and not delay
    }


@takes_models
def discretize(model: LinearModel, sample_period: float, holds: Mapping[str, Hold] = HOLDS) -> LinearModel:
    """The exact discrete equivalent of a continuous model, input delays included.

    Parameters
    ----------
    model
        Continuous model; delays need not be multiples of the sample period.
    sample_period
        Seconds.
    holds
        Holds of the inputs by name; "zero" for those not named.

    Returns
    -------
    LinearModel
        Discrete model; a delayed input adds one state for each sample that its delay reaches back. It is driven by
        each input's value at sample k, held (or linear) from sample k to k+1.
    """
    if model.sample_period:
        raise AbraceError("discretize: expected a continuous model")
    if not (isinstance(sample_period, Real) and 0 < sample_period < np.inf):
        raise AbraceError(f"discretize: sample_period {sample_period!r}, expected more than 0 s")
    if wrong := sorted({str(hold) for hold in holds.values()} - {"zero", "first"}):
        raise AbraceError(f"discretize: hold {wrong[0]!r}, expected zero or first")
    n, m, period = model.order, len(model.inputs), float(sample_period)

    def held(span: float, column: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray]:
        """exp(A span) and the responses at `span` to a unit step and to a unit ramp (of slope 1/span) in one input."""
        block = np.zeros((n + 2, n + 2))
        block[:n, :n] = model.a * span
        block[:n, n] = column * span
        block[n, n + 1] = 1.0
        block = linalg.expm(block)
        return block[:n, :n], block[:n, n], block[:n, n + 1]

    transition = linalg.expm(model.a * period)
    a, b = transition, np.zeros((n, m))
    c, d = model.c, model.d.copy()
    blocks: list[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]] = []
    for j, name in enumerate(model.inputs):
        delay = model.input_delay[j]
        if holds.get(name) == "first":
            if delay:
                raise AbraceError(f"discretize: input {name} has a delay, which a first-order hold cannot take")
            _, step, ramp = held(period, model.b[:, j])
            # x(k+1) = A x(k) + (step - ramp) u(k) + ramp u(k+1), with the state x(k) - ramp u(k)
            b[:, j] = step - ramp + transition @ ramp
            d[:, j] += model.c @ ramp
            continue
        whole, late = divmod(delay / period, 1.0)
        if late > 1 - 1e-9:
            whole, late = whole + 1, 0.0
        samples = int(whole)
        rest_transition, recent, _ = held((1 - late) * period, model.b[:, j])
        early = np.zeros(n) if late < 1e-9 else rest_transition @ held(late * period, model.b[:, j])[1]
        memory = samples + (1 if late >= 1e-9 else 0)
        if memory == 0:
            b[:, j] = recent
            continue
        # memory states hold u(k-1), u(k-2), ...; `recent` acts with u(k - samples), `early` with the one before
        into_state, into_output = np.zeros((n, memory)), np.zeros((len(c), memory))
        if samples:
            into_state[:, samples - 1] += recent
        else:
            b[:, j] = recent
        if late >= 1e-9:
            into_state[:, samples] += early
        # at the instant of sample k the delayed input is the one of `memory` samples before
        into_output[:, memory - 1] = model.d[:, j]
        d[:, j] = 0.0
        first = np.zeros((memory, m))
        first[0, j] = 1.0
        blocks.append((into_state, into_output, first))
    for into_state, into_output, first in blocks:
        memory = len(first)
        states = len(a)
        grown = np.zeros((states + memory, states + memory))
        grown[:states, :states] = a
        grown[:n, states:] = into_state
        grown[states + 1 :, states:-1] = np.eye(memory - 1)
        a, b, c = grown, np.vstack([b, first]), np.hstack([c, into_output])
    return LinearModel(a, b, c, d, model.inputs, model.outputs, period, provenance=model.provenance, units=model.units)
