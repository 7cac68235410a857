# SPDX-License-Identifier: Apache-2.0
"""A sampled model seen by a controller that answers every n-th sample only, its command held in between.

From one of the controller's samples to the next such a loop is linear and time-invariant again: the model is lifted,
its n samples are the inputs and outputs of one step. The step begins where a command begins to act, a sample after the
one that it answers, so that one command acts in all of it, and ends with the next sample that is answered.
"""

from __future__ import annotations

import numpy as np

from abrace_core import AbraceError
from abrace_core.model.linear_model import LinearModel, takes_models


def divisor(sample_period: float, rig_period: float) -> int:
    """How many samples of a rig, one each `rig_period` [s], make one `sample_period` [s] of its controller.

    Raises
    ------
    AbraceError
        If it is not a whole number.
    """
    ratio = sample_period / rig_period
    if round(ratio) < 1 or abs(ratio / round(ratio) - 1) > 1e-9:
        raise AbraceError(
            f"sample period {sample_period:g} s, expected {rig_period:g} s, the rig's, or a whole multiple of it"
        )
    return round(ratio)


@takes_models
def lifted(model: LinearModel, commands: int, samples: int) -> LinearModel:
    """A discrete `model` over so many `samples`, in which its last inputs, the `commands`, keep their values.

    Its outputs come once for each sample; those of the last one, which the controller answers, have their own names and
    come last. Likewise the other inputs.
    """
    if samples == 1:
        return model
    free, order = len(model.inputs) - commands, model.order
    width = order + samples * free + commands
    state, outputs = np.eye(order, width), []
    for i in range(samples):
        given = np.zeros((len(model.inputs), width))
        given[:free, order + i * free : order + (i + 1) * free] = np.eye(free)
        given[free:, width - commands :] = np.eye(commands)
        outputs.append(model.c @ state + model.d @ given)
        state = model.a @ state + model.b @ given
    whole = np.vstack(outputs)

    def named(names: tuple[str, ...]) -> tuple[str, ...]:
        before = (f"{name}, {samples - 1 - i} before" for i in range(samples - 1) for name in names)
        return (*before, *names)

    return LinearModel(
        state[:, :order],
        state[:, order:],
        whole[:, :order],
        whole[:, order:],
        (*named(model.inputs[:free]), *model.inputs[free:]),
        named(model.outputs),
        model.sample_period * samples,
    )
