# SPDX-License-Identifier: Apache-2.0
"""The one loop that steps discrete models through records, for `simulation` and `loop_extremes`.

It goes by blocks of samples. All samples of a block follow from the state at its start and its inputs,

    y(k+i) = C A^i x(k) + sum over j < i of C A^(i-1-j) B u(k+j) + D u(k+i),

so all outputs of many blocks are one matrix product once the states at their starts and the commands are known; the
compiled loop computes these block by block, and limits one command after the other before it acts. This is the
recursion x(k+1) = A x(k) + B u(k) in another order of summation, equal to it except for rounding, and for the rig's 25
states some five times as fast: `abrace fragility` computes 100 000 loops of 50 000 steps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from abrace_core import AbraceError
from abrace_core.model.compiled import compiled
from abrace_core.model.linear_model import LinearModel, takes_models
from abrace_core.model.si_units import in_si_units

if TYPE_CHECKING:
    from numpy.typing import NDArray

BLOCK = 16
"""Samples a block. Longer ones mean fewer steps and larger matrices; 16 and 32 take the least time at 25 states."""

CHUNK = 128
"""Blocks whose outputs are one matrix product: what they need stays in the processor's cache."""

LARGEST = 1e100
"""Greatest entry of a matrix power that is squared: beyond it the square might overflow, though the result does not."""

LARGEST_GROWTH = 100.0
"""Greatest growth of an unstable motion of plant or controller alone within a block of a closed loop. In the sum it
cancels, at the cost of as many digits as this factor has."""


@takes_models
def connect(
    model: LinearModel,
    controller: LinearModel,
    capacity: NDArray[np.float64] | None = None,
    correction: NDArray[np.float64] | None = None,
    disturbances: int = 1,
) -> LinearModel:
    """Model and controller in series: from the disturbance and commands in force to outputs and next commands.

    The next commands are those before they are limited. The controller's state is p(k) = q(k) - G U(k-1), with its own
    state q(k) and the `correction` G: U(k-1), once limited, is the command in force at sample k, an input here.

    Parameters
    ----------
    model, controller, capacity, correction
        As in `simulation.simulate_closed_loop`; a `capacity` of None is not checked. Signals are converted to SI units.
    disturbances
        Inputs of the model before its commands.

    Raises
    ------
    AbraceError
        If they do not fit each other, or as in `si_units.in_si_units`.
    """
    model = in_si_units(model)
    controller = in_si_units(controller)
    acting = model.inputs[disturbances:]
    if acting != controller.outputs or abs(model.sample_period - controller.sample_period) > 1e-12:
        raise AbraceError(
            f"closed loop: the controller gives {', '.join(controller.outputs)} every {controller.sample_period} s, "
            f"the model takes {', '.join(acting)} every {model.sample_period} s"
        )
    if not model.sample_period:
        raise AbraceError("closed loop: expected discrete models")
    missing = [name for name in controller.inputs if name not in model.outputs]
    if missing:
        raise AbraceError(
            f"closed loop: the controller measures {', '.join(missing)}, the model gives {', '.join(model.outputs)}"
        )
    commands = len(controller.outputs)
    if capacity is not None and np.shape(capacity) != (commands,):
        raise AbraceError(f"closed loop: capacities of shape {np.shape(capacity)}, expected ({commands},)")
    correction = np.zeros((controller.order, commands)) if correction is None else np.asarray(correction)
    if correction.shape != (controller.order, commands):
        expected = (controller.order, commands)
        raise AbraceError(f"closed loop: correction of shape {correction.shape}, expected {expected}")
    measured = [model.outputs.index(name) for name in controller.inputs]
    c, d = model.c[measured], model.d[measured]
    a, b = controller.a - correction @ controller.c, controller.b - correction @ controller.d
    in_force = np.hstack([np.zeros((controller.order, disturbances)), correction])
    return LinearModel(
        np.block([[model.a, np.zeros((model.order, controller.order))], [b @ c, a]]),
        np.vstack([model.b, b @ d + a @ in_force]),
        np.block([[model.c, np.zeros((len(model.outputs), controller.order))], [controller.d @ c, controller.c]]),
        np.vstack([model.d, controller.d @ d + controller.c @ in_force]),
        model.inputs,
        (*model.outputs, *(f"next {name}" for name in controller.outputs)),
        model.sample_period,
    )


def check_finite(what: str, values: NDArray[np.float64]) -> None:
    """An error that begins with `what` if one of the `values` is not finite: it would spread over its whole block."""
    if not np.isfinite(values).all():
        sample = int(np.argwhere(~np.isfinite(values))[0, 0])
        raise AbraceError(f"{what}: not finite at sample {sample}, expected finite values")


@takes_models
def histories(
    model: LinearModel, inputs: NDArray[np.float64], capacity: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Histories from rest of a discrete model, whose last inputs and outputs may be limited commands (`connect`).

    Parameters
    ----------
    model
        Without commands, or from inputs and commands in force to outputs and next commands.
    inputs
        (samples, inputs) without the commands.
    capacity
        (commands,) to which commands are limited.

    Returns
    -------
    outputs, commands
        (samples, outputs), and (samples, commands) in force from each sample on.
    """
    samples, commands = len(inputs), len(capacity)
    outputs = len(model.outputs) - commands
    blocks = _Blocks.of(model, samples, commands)
    count = -(-samples // blocks.length)
    history, in_force = np.empty((count, blocks.length * outputs)), np.empty((count, blocks.length * commands))
    record = np.ascontiguousarray(inputs).reshape(1, samples * inputs.shape[1])
    first = np.zeros(1, dtype=np.int64)
    driving = (record, np.array([samples]), first, np.ones(1), capacity)
    _run(blocks, _read_only(driving), (history, in_force), _extremes(1, np.zeros(outputs, dtype=np.int64), commands))
    shape = count * blocks.length
    return history.reshape(shape, outputs)[:samples], in_force.reshape(shape, commands)[:samples]


@takes_models
def extremes(
    model: LinearModel,
    records: NDArray[np.float64],
    samples: NDArray[np.int64],
    chosen: NDArray[np.int64],
    scale: NDArray[np.float64],
    capacity: NDArray[np.float64],
    uncounted: NDArray[np.int64],
) -> tuple[NDArray[Any], ...]:
    """Peaks and sums of squares of many runs from rest of a discrete `model` of one input, as of `histories`.

    Parameters
    ----------
    model, capacity
        As in `histories`.
    records, samples
        (records, samples) of the input, and (records,) how many samples each has.
    chosen, scale
        (runs,) the record that drives each run, and its factor.
    uncounted
        (outputs,) how many of the last samples do not count.

    Returns
    -------
    peak, square, command_peak, command_square, limited
        (runs, outputs), (runs, commands) twice, and (runs,) samples at which a command is at its limit.
    """
    commands = len(capacity)
    blocks = _Blocks.of(model, records.shape[1], commands)
    found = _extremes(len(chosen), uncounted, commands)
    driving = (records, samples, chosen, scale, capacity)
    _run(blocks, _read_only(driving), (np.empty((0, 0)), np.empty((0, 0))), found)
    return found[1:]


def _extremes(runs: int, uncounted: NDArray[np.int64], commands: int) -> tuple[NDArray[Any], ...]:
    """Room for what `extremes` gives, all zero, behind what is `uncounted`."""
    outputs = np.zeros((2, runs, len(uncounted)))
    in_force = np.zeros((2, runs, commands))
    return uncounted, outputs[0], outputs[1], in_force[0], in_force[1], np.zeros(runs, dtype=np.int64)


def _read_only(arrays: tuple[NDArray[Any], ...]) -> tuple[NDArray[Any], ...]:
    """Views that cannot be written to, as those from another process: one type, compiled once."""
    views = tuple(array.view() for array in arrays)
    for view in views:
        view.flags.writeable = False
    return views


class _Blocks(NamedTuple):
    """The matrices by which `_run` multiplies what a block begins with and is driven by, from the right.

    Parameters
    ----------
    length
        Samples of a block.
    by_state, by_input, by_command
        (states, results), (length * inputs, results), (length * commands, results): from the state at the block's start
        and the block's inputs and commands in force to the results: the state at the next block's start, and the
        block's next commands before they are limited.
    to_outputs
        (states + length * inputs + length * commands, length * outputs).
    """

    length: int
    by_state: NDArray[np.float64]
    by_input: NDArray[np.float64]
    by_command: NDArray[np.float64]
    to_outputs: NDArray[np.float64]

    @classmethod
    def of(cls, model: LinearModel, samples: int, commands: int = 0) -> _Blocks:
        """Of a discrete `model` whose last inputs are `commands` in force, and last outputs the next ones.

        A block has a power of two of samples: up to BLOCK and to `samples`, fewer if a motion grows too much within it.
        """
        longest = min(BLOCK, max(1, samples))
        growth = np.abs(np.linalg.eigvals(model.a)).max(initial=0.0) if commands else 0.0
        while longest > 1 and growth**longest > LARGEST_GROWTH:
            longest //= 2
        power, from_inputs, from_state, length = model.a, model.b, model.c, 1
        while 2 * length <= longest and np.abs(power).max(initial=0.0) < LARGEST:
            from_state = np.vstack([from_state, from_state @ power])
            from_inputs = np.hstack([power @ from_inputs, from_inputs])
            power = power @ power
            length *= 2
        states, (rows, columns) = model.order, model.d.shape
        markov = np.concatenate([model.d[None], (from_state @ model.b).reshape(length, rows, columns)[:-1]])
        driven = np.zeros((length, rows, length, columns))
        for i in range(length):
            driven[i:, :, i] = markov[: length - i]
        width = states + length * columns
        outputs = np.concatenate(
            [from_state.reshape(length, rows, states), driven.reshape(length, rows, length * columns)], axis=2
        )
        following = outputs[:, rows - commands :].reshape(length * commands, width)
        results = np.vstack([np.hstack([power, from_inputs]), following])
        # inputs and outputs stand sample by sample here, inputs by kind below
        places = states + np.arange(length * columns).reshape(length, columns)
        given, acting = places[:, : columns - commands].ravel(), places[:, columns - commands :].ravel()
        order = np.concatenate([np.arange(states), given, acting])
        outputs = outputs[:, : rows - commands, order].reshape(length * (rows - commands), width)
        parts = (results[:, :states], results[:, given], results[:, acting], outputs)
        return cls(length, *(np.ascontiguousarray(part.T) for part in parts))


@compiled
def _run(
    blocks: tuple[Any, ...],
    driving: tuple[NDArray[Any], ...],
    recorded: tuple[NDArray[np.float64], ...],
    extreme: tuple[NDArray[Any], ...],
) -> None:
    """Step every run, and fill in either its time histories or its peaks and sums of squares.

    Parameters
    ----------
    blocks
        `_Blocks`.
    driving
        Records of all inputs, sample after sample, and how many samples each has; the record of each run, and its
        factor; the capacities.
    recorded
        (blocks, length * outputs) outputs and (blocks, length * commands) commands in force, of one run; no blocks:
        extremes are wanted.
    extreme
        `_extremes`.
    """
    length, by_state, by_input, by_command, to_outputs = blocks
    records, samples, chosen, scale, capacity = driving
    history, in_force = recorded
    uncounted, peak, square, command_peak, command_square, limited = extreme
    states, inputs, commands = len(by_state), len(by_input), len(capacity)
    results, outputs, channels = by_state.shape[1], len(uncounted), inputs // length
    known = np.zeros((CHUNK, states + inputs + length * commands))
    given = np.zeros((CHUNK, inputs))
    driven = np.zeros((CHUNK, results))
    found = np.zeros((CHUNK, length * outputs))
    most, sums = np.zeros(length * outputs), np.zeros(length * outputs)
    state, command = np.zeros(states), np.zeros(commands)
    for loop in range(len(chosen)):
        record, factor, last = records[chosen[loop]], scale[loop], samples[chosen[loop]]
        state[:], command[:], most[:], sums[:] = 0.0, 0.0, 0.0, 0.0
        count = (last + length - 1) // length
        for first in range(0, count, CHUNK):
            rows = min(CHUNK, count - first)
            for row in range(rows):
                start = (first + row) * inputs
                for i in range(inputs):
                    value = factor * record[start + i] if start + i < last * channels else 0.0
                    given[row, i] = value
                    known[row, states + i] = value
            np.dot(given, by_input, driven)
            for row in range(rows):
                result = driven[row]
                for j in range(states):
                    value = state[j]
                    known[row, j] = value
                    for i in range(results):
                        result[i] += by_state[j, i] * value
                if commands:
                    for i in range(length):
                        sample = (first + row) * length + i
                        at_limit = False
                        for j in range(commands):
                            value = command[j]
                            known[row, states + inputs + i * commands + j] = value
                            for q in range(results):  # an array expression would take twice the time
                                result[q] += by_command[i * commands + j, q] * value
                            if sample < last - 1:  # the last command acts on no sample
                                size = abs(value)
                                command_peak[loop, j] = max(command_peak[loop, j], size)
                                command_square[loop, j] += size * size
                                at_limit = at_limit or size >= capacity[j]
                        limited[loop] += at_limit
                        for j in range(commands):
                            wanted = result[states + i * commands + j]
                            command[j] = min(max(wanted, -capacity[j]), capacity[j])
                state[:] = result[:states]
            np.dot(known, to_outputs, found)
            if len(history):
                history[first : first + rows] = found[:rows]
                in_force[first : first + rows] = known[:rows, states + inputs :]
                continue
            for row in range(rows):
                values = found[row]
                left = last - (first + row) * length
                if left > length:
                    for q in range(length * outputs):
                        size = abs(values[q])
                        sums[q] += size * size
                        most[q] = size if size > most[q] else most[q]
                else:
                    for q in range(length * outputs):
                        if q // outputs < left - uncounted[q % outputs]:
                            size = abs(values[q])
                            sums[q] += size * size
                            most[q] = size if size > most[q] else most[q]
        for q in range(length * outputs):
            peak[loop, q % outputs] = max(peak[loop, q % outputs], most[q])
            square[loop, q % outputs] += sums[q]
