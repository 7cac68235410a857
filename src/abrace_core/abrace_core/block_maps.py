# SPDX-License-Identifier: Apache-2.0
"""Blocks of samples of a discrete model as one matrix, used by `simulation` and `loop_extremes`.

All samples of a block follow from the state at its start and its inputs,

    y(k+i) = C A^i x(k) + sum over j < i of C A^(i-1-j) B u(k+j) + D u(k+i).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError
from abrace_core.linear_model import LinearModel, takes_models

if TYPE_CHECKING:
    from numpy.typing import NDArray

BLOCK = 16
"""Samples a block. Longer ones mean fewer steps and larger matrices; 16 and 32 take the least time at 25 states."""

LARGEST = 1e100
"""Greatest entry of a matrix power that is squared: beyond it the square might overflow, though the result does not."""

LARGEST_GROWTH = 100.0
"""Greatest growth of an unstable motion of plant or controller alone within a block of a closed loop. In the sum it
cancels, at the cost of as many digits as this factor has."""


@dataclass(frozen=True)
class BlockMaps:
    """Matrices from the state at a block's start and its inputs to the next block's state and the block's outputs.

    `state_from_state` (states, states) and `state_from_inputs` (states, length * inputs) give the state at the next
    block's start; `outputs` (length * outputs, states + length * inputs) the block's outputs from both.
    """

    length: int
    state_from_state: NDArray[np.float64]
    state_from_inputs: NDArray[np.float64]
    outputs: NDArray[np.float64]

    @classmethod
    def of(cls, model: LinearModel, longest: int) -> BlockMaps:
        """Of a discrete model: a power of two of samples, up to `longest` unless a power of A is too large before."""
        power, from_inputs, from_state, length = model.a, model.b, model.c, 1
        while 2 * length <= longest and np.abs(power).max(initial=0.0) < LARGEST:
            from_state = np.vstack([from_state, from_state @ power])
            from_inputs = np.hstack([power @ from_inputs, from_inputs])
            power = power @ power
            length *= 2
        rows, columns = model.d.shape
        markov = np.concatenate([model.d[None], (from_state @ model.b).reshape(length, rows, columns)[:-1]])
        toeplitz = np.zeros((length, rows, length, columns))
        for i in range(length):
            toeplitz[i:, :, i] = markov[: length - i]
        outputs = np.hstack([from_state, toeplitz.reshape(length * rows, length * columns)])
        return cls(length, power, from_inputs, outputs)

    def blocks(self, inputs: NDArray[np.float64]) -> NDArray[np.float64]:
        """(blocks, states + length * inputs): room for the states at the starts, and the inputs, zero past the end."""
        states, (count, channels) = len(self.state_from_state), inputs.shape
        full, columns = count // self.length, self.length * channels
        blocks = np.zeros((-(-count // self.length), states + columns))
        blocks[:full, states:] = inputs[: full * self.length].reshape(full, columns)
        rest = inputs[full * self.length :].ravel()
        blocks[full:, states : states + len(rest)] = rest
        return blocks

    def output_rows(self, chosen: slice) -> NDArray[np.float64]:
        """The rows of `outputs` that belong to the `chosen` ones of the model's outputs."""
        rows, columns = self.outputs.shape
        by_sample = self.outputs.reshape(self.length, rows // self.length, columns)[:, chosen]
        return by_sample.reshape(self.length * by_sample.shape[1], columns)

    def samples(self, blocks: NDArray[np.float64], count: int) -> NDArray[np.float64]:
        """(count, channels) from (blocks, length * channels)."""
        return blocks.reshape(len(blocks) * self.length, blocks.shape[1] // self.length)[:count]


@takes_models
def in_series(model: LinearModel, controller: LinearModel, correction: NDArray[np.float64]) -> LinearModel:
    """From ground acceleration and commands in force to the model's outputs and the next commands, before saturation.

    The state of the controller is p(k) = q(k) - G U(k-1), with its own state q(k) and the `correction` G: U(k-1), once
    saturated, is the command in force at sample k, an input here.
    """
    missing = [name for name in controller.inputs if name not in model.outputs]
    if missing:
        raise AbraceError(
            f"closed loop: the controller measures {', '.join(missing)}, the model gives {', '.join(model.outputs)}"
        )
    measured = np.array([model.outputs.index(name) for name in controller.inputs], dtype=np.intp)
    c, d = model.c[measured], model.d[measured]
    a, b = controller.a - correction @ controller.c, controller.b - correction @ controller.d
    in_force = np.hstack([np.zeros((controller.order, 1)), correction])
    return LinearModel(
        np.block([[model.a, np.zeros((model.order, controller.order))], [b @ c, a]]),
        np.vstack([model.b, b @ d + a @ in_force]),
        np.block([[model.c, np.zeros((len(model.outputs), controller.order))], [controller.d @ c, controller.c]]),
        np.vstack([model.d, controller.d @ d + controller.c @ in_force]),
        model.inputs,
        (*model.outputs, *(f"next {name}" for name in controller.outputs)),
        model.sample_period,
    )


@takes_models
def steady_length(series: LinearModel) -> int:
    """Samples a block in which no motion of the `series` of model and controller grows by more than LARGEST_GROWTH."""
    growth = np.abs(np.linalg.eigvals(series.a)).max(initial=0.0)
    length = BLOCK
    while length > 1 and growth**length > LARGEST_GROWTH:
        length //= 2
    return length
