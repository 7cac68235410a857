# SPDX-License-Identifier: Apache-2.0
"""Peak and rms of many closed loops of one model and one controller, without their time histories.

The samples are those of `simulation`, to rounding. A loop is run through in stretches of CHUNK blocks of samples, whose
matrices stay in the processor's cache, and of which nothing is kept but the greatest and the sum of squares. Each
loop is computed in the same way, whichever others are computed with it: results do not depend on how loops are grouped.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.block_maps import BLOCK, BlockMaps, in_series, steady_length
from abrace_core.compiled import compiled
from abrace_core.errors import AbraceError
from abrace_core.linear_model import LinearModel, takes_models
from abrace_core.simulation import check_finite

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

CHUNK = 128
"""Blocks that are multiplied at a time."""


@dataclass(frozen=True)
class Motions:
    """Ground motions of one sampling, in one array.

    Parameters
    ----------
    ground
        (motions, samples of the longest) [m/s^2], zero past the end of a shorter one.
    samples
        (motions,) of each.
    """

    ground: NDArray[np.float64]
    samples: NDArray[np.int64]

    @classmethod
    def of(cls, grounds: Iterable[NDArray[np.float64]]) -> Motions:
        """Of `grounds`, accelerations (samples,) [m/s^2] of any lengths; not finite or empty ones are refused."""
        grounds = list(grounds)
        samples = np.array([len(ground) for ground in grounds], dtype=np.int64)
        if not samples.min(initial=1):
            raise AbraceError("closed loops: a motion without samples, expected one or more")
        together = np.zeros((len(samples), samples.max(initial=0)))
        for row, ground in zip(together, grounds, strict=True):
            check_finite("closed loops: ground acceleration", ground)
            row[: len(ground)] = ground
        return cls(together, samples)


@dataclass(frozen=True)
class Extremes:
    """Peak and rms of the outputs and commands of several loops.

    Parameters
    ----------
    names
        Of the model's outputs, then of its commands.
    peak, rms
        (loops, names), SI units; infinite where an unstable loop has no finite ones.
    saturated
        (loops,) samples at which a command was at its limit.
    """

    names: tuple[str, ...]
    peak: NDArray[np.float64]
    rms: NDArray[np.float64]
    saturated: NDArray[np.int64]


@takes_models
def loop_extremes(
    model: LinearModel,
    controller: LinearModel | None,
    motions: Motions,
    capacity: NDArray[np.float64] | None = None,
    correction: NDArray[np.float64] | None = None,
    *,
    chosen: NDArray[np.int64] | None = None,
    scale: NDArray[np.float64] | None = None,
) -> Extremes:
    """Peak and rms of what `simulate_closed_loop` gives, for several ground motions.

    Parameters
    ----------
    model
        Discrete; its first input is the ground acceleration, the others are the commands.
    controller
        Discrete, from some of the outputs to the commands, at the same sample period; None: the commands are zero.
    motions
        Ground motions.
    capacity
        (commands,) [N], to which commands are cut; None: they are not, and every result is proportional to the motion.
    correction
        As in `simulate_closed_loop`.
    chosen
        (loops,) which motion each loop has; None: one loop for each motion.
    scale
        (loops,) factor of its motion; None: 1.

    Raises
    ------
    AbraceError
        If model, controller, capacity and records do not fit each other.
    """
    count, commands = len(model.outputs), len(model.inputs) - 1
    names = (*model.outputs, *model.inputs[1:])
    chosen = np.arange(len(motions.samples)) if chosen is None else np.asarray(chosen, dtype=np.int64)
    scale = np.ones(len(chosen)) if scale is None else np.asarray(scale, dtype=np.float64)
    cut = np.zeros(0)
    if controller is None:
        whole = model.select(inputs=model.inputs[:1])
    else:
        _check(model, controller, capacity)
        correction = np.zeros((controller.order, commands)) if correction is None else np.asarray(correction)
        whole = in_series(model, controller, correction)
        if capacity is None:
            whole = _closed(whole, commands)
        else:
            cut = np.ascontiguousarray(capacity, dtype=np.float64)
    length = steady_length(whole) if len(cut) else BLOCK
    maps = BlockMaps.of(whole, min(length, max(1, motions.ground.shape[1])))
    wanted = count if len(cut) or controller is None else count + commands
    uncounted = np.where(np.arange(wanted) < count, 0, 1)  # the last command acts on no sample
    loops = len(chosen)
    by_state, by_ground, by_command, to_outputs = _arrays(maps, wanted, len(cut))
    peak, square = np.zeros((2, loops, wanted))
    cut_peak, cut_square = np.zeros((2, loops, len(cut)))
    saturated = np.zeros(loops, dtype=np.int64)
    ground = motions.ground.view()
    ground.flags.writeable = False  # as in an array from another process: one type, compiled once
    _run(
        ground,
        motions.samples,
        chosen,
        scale,
        by_state,
        by_ground,
        by_command,
        to_outputs,
        cut,
        uncounted,
        peak,
        square,
        cut_peak,
        cut_square,
        saturated,
    )
    silent = np.zeros((loops, count + commands - wanted - len(cut)))
    peak, square = np.hstack([peak, cut_peak, silent]), np.hstack([square, cut_square, silent])
    bounded = np.isfinite(square)
    rms = np.sqrt(np.where(bounded, square, np.inf) / motions.samples[chosen, None])
    return Extremes(names, np.where(bounded, peak, np.inf), rms, saturated)


def _check(model: LinearModel, controller: LinearModel, capacity: NDArray[np.float64] | None) -> None:
    same = model.sample_period > 0 and abs(model.sample_period - controller.sample_period) <= 1e-12
    if model.inputs[1:] != controller.outputs or not same:
        raise AbraceError(
            f"closed loops: the controller gives {', '.join(controller.outputs)} every {controller.sample_period} s, "
            f"the model takes {', '.join(model.inputs[1:])} every {model.sample_period} s"
        )
    if capacity is not None and np.shape(capacity) != (len(controller.outputs),):
        raise AbraceError(f"closed loops: capacities {capacity}, expected one for each of {len(controller.outputs)}")


def _closed(series: LinearModel, commands: int) -> LinearModel:
    """The series of model and controller, closed: from the ground to the outputs and the commands in force."""
    states, outputs = series.order, len(series.outputs) - commands
    a = np.block([[series.a, series.b[:, 1:]], [series.c[outputs:], series.d[outputs:, 1:]]])
    b = np.vstack([series.b[:, :1], series.d[outputs:, :1]])
    c = np.block([[series.c[:outputs], series.d[:outputs, 1:]], [np.eye(commands, states + commands, states)]])
    d = np.vstack([series.d[:outputs, :1], np.zeros((commands, 1))])
    return LinearModel(a, b, c, d, series.inputs[:1], series.outputs, series.sample_period)


def _arrays(maps: BlockMaps, wanted: int, commands: int) -> tuple[NDArray[np.float64], ...]:
    """What `_run` multiplies by: see there. Inputs of a block stand sample by sample in `maps`, by kind here."""
    states, length = len(maps.state_from_state), maps.length
    inputs = states + np.arange(length * (1 + commands)).reshape(length, 1 + commands)
    ground, command = inputs[:, 0], inputs[:, 1:].ravel()
    whole = np.hstack([maps.state_from_state, maps.state_from_inputs])
    if commands:
        whole = np.vstack([whole, maps.output_rows(slice(wanted, None))])
    outputs = maps.output_rows(slice(wanted))
    order = np.concatenate([np.arange(states), ground, command])
    parts = (whole[:, :states], whole[:, ground], whole[:, command], outputs[:, order])
    return tuple(np.ascontiguousarray(part.T) for part in parts)


@compiled
def _run(
    ground: NDArray[np.float64],
    samples: NDArray[np.int64],
    chosen: NDArray[np.int64],
    scale: NDArray[np.float64],
    by_state: NDArray[np.float64],
    by_ground: NDArray[np.float64],
    by_command: NDArray[np.float64],
    to_outputs: NDArray[np.float64],
    capacity: NDArray[np.float64],
    uncounted: NDArray[np.int64],
    peak: NDArray[np.float64],
    square: NDArray[np.float64],
    cut_peak: NDArray[np.float64],
    cut_square: NDArray[np.float64],
    saturated: NDArray[np.int64],
) -> None:
    """Run every loop, and fill in peaks, sums of squares and counts of samples.

    `by_state`, `by_ground` and `by_command` give the next block's state and the block's commands before they are cut,
    (states + length * commands) columns; `to_outputs` the block's outputs from [state, ground, commands].
    `uncounted` is how many of the last samples do not count, of each output.
    """
    states, length, commands = len(by_state), len(by_ground), len(capacity)
    width, outputs = by_state.shape[1], len(uncounted)
    known = np.zeros((CHUNK, states + length + length * commands))
    shaken = np.zeros((CHUNK, length))
    driven = np.zeros((CHUNK, width))
    found = np.zeros((CHUNK, length * outputs))
    most, sums = np.zeros(length * outputs), np.zeros(length * outputs)
    state, command = np.zeros(states), np.zeros(commands)
    for loop in range(len(chosen)):
        motion, factor = ground[chosen[loop]], scale[loop]
        state[:], command[:], most[:], sums[:] = 0.0, 0.0, 0.0, 0.0
        last = samples[chosen[loop]]
        blocks = (last + length - 1) // length
        for first in range(0, blocks, CHUNK):
            rows = min(CHUNK, blocks - first)
            for row in range(rows):
                for i in range(length):
                    sample = (first + row) * length + i
                    value = factor * motion[sample] if sample < last else 0.0
                    shaken[row, i] = value
                    known[row, states + i] = value
            np.dot(shaken, by_ground, driven)
            for row in range(rows):
                result = driven[row]
                for j in range(states):
                    value = state[j]
                    known[row, j] = value
                    for i in range(width):
                        result[i] += by_state[j, i] * value
                if commands:
                    for i in range(length):
                        sample = (first + row) * length + i
                        limited = False
                        for j in range(commands):
                            value = command[j]
                            known[row, states + length + i * commands + j] = value
                            for q in range(width):
                                result[q] += by_command[i * commands + j, q] * value
                            if sample < last - 1:
                                size = abs(value)
                                cut_peak[loop, j] = max(cut_peak[loop, j], size)
                                cut_square[loop, j] += size * size
                                limited = limited or size >= capacity[j]
                        saturated[loop] += limited
                        for j in range(commands):
                            wanted = result[states + i * commands + j]
                            command[j] = min(max(wanted, -capacity[j]), capacity[j])
                state[:] = result[:states]
            np.dot(known, to_outputs, found)
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
