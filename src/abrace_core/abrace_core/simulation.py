# SPDX-License-Identifier: Apache-2.0
"""Discrete models run over whole records: free, or with a controller whose commands saturate.

Samples are computed in blocks. All samples of a block follow from its first state and its inputs by one matrix,

    y(k+i) = C A^i x(k) + sum over j < i of C A^(i-1-j) B u(k+j) + D u(k+i),

so that all blocks are one matrix product once the states at their starts are known. Those obey a recursion of the same
form with A^length in place of A, one step a block. A free run solves it by cyclic reduction: pairs of blocks make a
recursion of half the length, and so on. A saturating run goes block by block in a compiled loop, where the one command
after the other is cut before it acts. Both are the plain recursion in another order of summation, exact to rounding.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace_core.block_maps import BLOCK, LARGEST, BlockMaps, in_series, steady_length
from abrace_core.compiled import compiled
from abrace_core.errors import AbraceError
from abrace_core.linear_model import LinearModel, takes_models

if TYPE_CHECKING:
    from numpy.typing import NDArray

FEW = 4
"""Steps up to which the plain recursion is faster than cyclic reduction."""


@takes_models
def simulate(
    model: LinearModel, inputs: NDArray[np.float64], initial: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Outputs of a discrete model driven by given inputs.

    Parameters
    ----------
    model
        Discrete model, stable or not.
    inputs
        (samples, inputs), finite.
    initial
        (states,) at the first sample; None: from rest.

    Returns
    -------
    NDArray
        (samples, outputs).

    Raises
    ------
    AbraceError
        If the model is continuous, or inputs or initial state do not fit it.
    """
    if not model.sample_period:
        raise AbraceError("simulate: expected a discrete model")
    inputs = np.asarray(inputs, dtype=np.float64)
    if inputs.ndim != 2 or inputs.shape[1] != len(model.inputs):
        raise AbraceError(f"simulate: inputs of shape {inputs.shape}, expected (samples, {len(model.inputs)})")
    state = np.zeros(model.order) if initial is None else np.asarray(initial, dtype=np.float64)
    if state.shape != (model.order,):
        raise AbraceError(f"simulate: initial state of shape {state.shape}, expected ({model.order},)")
    check_finite("simulate: inputs", inputs)
    if not model.order:
        return np.asarray(inputs @ model.d.T)
    maps = BlockMaps.of(model, min(BLOCK, len(inputs)))
    blocks = maps.blocks(inputs)
    driven = blocks[:, model.order :] @ maps.state_from_inputs.T
    blocks[:, : model.order] = _starts(maps.state_from_state, driven, state)
    return maps.samples(blocks @ maps.outputs.T, len(inputs))


@takes_models
def simulate_closed_loop(
    model: LinearModel,
    controller: LinearModel,
    ground_acceleration: NDArray[np.float64],
    capacity: NDArray[np.float64],
    correction: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Run a controller (Eq. 13) on a discrete model from rest, with the rig's timing and saturation.

    The command computed from sample k acts from sample k+1 on, as in the graph.

    Parameters
    ----------
    model
        Discrete model; its first input is the ground acceleration, the others are the controller's outputs.
    controller
        Discrete model from some of the outputs to the commands, at the same sample period.
    ground_acceleration
        (samples,) [m/s^2], finite.
    capacity
        (commands,) [N]; commands are cut to +-capacity.
    correction
        (controller's states, commands): added to its next state for each newton that saturation cuts off a command, so
        that its estimate follows the saturated command (`Controller.correction`); None: Eq. (13) as printed, which
        winds up.

    Returns
    -------
    outputs, commands
        (samples, outputs), and (samples, commands): the command in force until each sample, as in a Response.

    Raises
    ------
    AbraceError
        If model, controller, motion and capacity do not fit each other.
    """
    if model.inputs[1:] != controller.outputs or abs(model.sample_period - controller.sample_period) > 1e-12:
        raise AbraceError(
            f"closed loop: the controller gives {', '.join(controller.outputs)} every {controller.sample_period} s, "
            f"the model takes {', '.join(model.inputs[1:])} every {model.sample_period} s"
        )
    if not model.sample_period:
        raise AbraceError("closed loop: expected discrete models")
    ground_acceleration = np.asarray(ground_acceleration, dtype=np.float64)
    capacity = np.ascontiguousarray(capacity, dtype=np.float64)
    samples, commands = len(ground_acceleration), len(controller.outputs)
    if ground_acceleration.ndim != 1 or capacity.shape != (commands,):
        raise AbraceError(
            f"closed loop: ground acceleration of shape {ground_acceleration.shape} and capacities of shape "
            f"{capacity.shape}, expected (samples,) and ({commands},)"
        )
    check_finite("closed loop: ground acceleration", ground_acceleration)
    correction = np.zeros((controller.order, commands)) if correction is None else np.asarray(correction)
    if correction.shape != (controller.order, commands):
        raise AbraceError(
            f"closed loop: correction of shape {correction.shape}, expected ({controller.order}, {commands})"
        )
    series = in_series(model, controller, correction)
    maps = BlockMaps.of(series, min(steady_length(series), samples))
    inputs = np.zeros((samples, 1 + commands))
    inputs[:, 0] = ground_acceleration
    blocks = maps.blocks(inputs)
    # of a block's results the loop needs the next block's state and the commands
    states, wanted = series.order, maps.output_rows(slice(len(model.outputs), None))
    by_input = np.ascontiguousarray(np.vstack([maps.state_from_inputs, wanted[:, states:]]).T)
    by_state = np.ascontiguousarray(np.vstack([maps.state_from_state, wanted[:, :states]]).T)
    _cut_commands(blocks, blocks[:, states:] @ by_input, by_state, by_input, capacity)
    outputs = maps.samples(blocks @ maps.output_rows(slice(len(model.outputs))).T, samples)
    in_force = maps.samples(blocks[:, states:], samples)[:, 1:]
    return outputs, np.vstack([np.zeros((1, commands)), in_force[:-1]])[:samples]


def _starts(
    transition: NDArray[np.float64], driven: NDArray[np.float64], initial: NDArray[np.float64]
) -> NDArray[np.float64]:
    """x(0), x(1), ... (steps, states) of x(i+1) = transition x(i) + driven(i), by cyclic reduction."""
    starts = np.empty_like(driven)
    steps = len(driven)
    if steps <= FEW or not np.abs(transition).max() < LARGEST:
        starts[:1] = initial
        for i in range(1, steps):
            starts[i] = transition @ starts[i - 1] + driven[i - 1]
        return starts
    even, odd = driven[0 : steps - 1 : 2], driven[1::2]
    pairs = np.zeros((-(-steps // 2), len(transition)))
    pairs[: len(odd)] = even @ transition.T + odd
    starts[::2] = _starts(transition @ transition, pairs, initial)
    starts[1::2] = starts[0 : steps - 1 : 2] @ transition.T + even
    return starts


@compiled
def _cut_commands(
    blocks: NDArray[np.float64],
    driven: NDArray[np.float64],
    by_state: NDArray[np.float64],
    by_input: NDArray[np.float64],
    capacity: NDArray[np.float64],
) -> None:
    """Fill in the states at the blocks' starts and the commands in force, each cut to its capacity.

    `driven` (blocks, states + length * commands), which is overwritten, holds the contributions of the ground
    acceleration to the next block's state and to the block's commands; `by_state` and `by_input` those of each state
    and input.
    """
    states, commands = len(by_state), len(capacity)
    command = np.zeros(commands)
    for block in range(len(blocks)):
        row, result = blocks[block], driven[block]
        result += np.dot(row[:states], by_state)
        for first in range(0, len(by_input), 1 + commands):
            for j in range(commands):
                row[states + first + 1 + j] = command[j]
                for i in range(len(result)):  # an array expression would take twice the time
                    result[i] += by_input[first + 1 + j, i] * command[j]
            answers = states + first // (1 + commands) * commands
            for j in range(commands):
                command[j] = min(max(result[answers + j], -capacity[j]), capacity[j])
        if block + 1 < len(blocks):
            blocks[block + 1, :states] = result[:states]


def check_finite(what: str, values: NDArray[np.float64]) -> None:
    """An error that begins with `what` if one of the `values` is not finite: it would spread over its whole block."""
    if not np.isfinite(values).all():
        sample = int(np.argwhere(~np.isfinite(values))[0, 0])
        raise AbraceError(f"{what}: not finite at sample {sample}, expected finite values")
