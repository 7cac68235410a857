# SPDX-License-Identifier: Apache-2.0
"""Simulation of the identified model with its nonlinear elements, sample by sample.

Each element except joints opposes its motion with a force or impulse that is constant over a sample. Within its limit
it is the one that leaves the least motion at the sample's end (time stepping after Moreau 1988). Several elements are
solved together by Gauss-Seidel iteration.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.compiled import compiled
from abrace_core.discretization import discretize
from abrace_core.linear_model import takes_models
from abrace_sysid.nonlinear.elements import IMPULSES, with_elements

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel
    from abrace_sysid.nonlinear.elements import Nonlinearity

SWEEPS = 50
"""Greatest number of Gauss-Seidel iterations in a sample."""


@dataclass(frozen=True)
class Motion:
    """A simulated test.

    Parameters
    ----------
    outputs
        (samples, outputs) of the model.
    commands
        (samples, commands) [N], the commands that act up to each sample.
    motions, held
        (samples, elements) motion r of each element, and the force or impulse with which it opposes the motion; of
        joints their slip [m].
    """

    outputs: NDArray[np.float64]
    commands: NDArray[np.float64]
    motions: NDArray[np.float64]
    held: NDArray[np.float64]


@takes_models
def simulate_nonlinear(
    model: LinearModel,
    found: Nonlinearity,
    sample_period: float,
    ground_acceleration: NDArray[np.float64],
    commands: NDArray[np.float64],
    controller: LinearModel | None = None,
    capacity: NDArray[np.float64] | None = None,
    correction: NDArray[np.float64] | None = None,
) -> Motion:
    """Simulate the `model` with its elements from rest, under given commands or in closed loop with a controller.

    Parameters
    ----------
    model
        Continuous, with the ground acceleration first among its inputs, then the commands.
    found
        Nonlinear elements of the model.
    sample_period
        Seconds.
    ground_acceleration
        (samples,) [m/s^2].
    commands
        (samples, commands) [N], each acts from its sample on; not used with a controller.
    controller, capacity, correction
        As in `abrace_core.simulation.simulate_closed_loop`. Without a controller the `commands` act; without capacity
        there is no limit.
    """
    sampled, groups = discretize(with_elements(model, found), sample_period), commands.shape[1]
    limit = np.full(groups, np.inf) if capacity is None else np.asarray(capacity, dtype=np.float64)
    if controller is None:
        law = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((groups, 0)), np.zeros((groups, 1)), np.zeros((0, groups))
        measured = np.zeros(1, dtype=np.int64)
    else:
        zero = np.zeros((controller.order, groups))
        law = controller.a, controller.b, controller.c, controller.d, zero if correction is None else correction
        measured = np.array([model.outputs.index(name) for name in controller.inputs], dtype=np.int64)
    elements = [(one.limit, one.slope, float(one.kind in IMPULSES), one.yield_drift) for one in found.elements]
    outputs, until, held = _moved(
        tuple(np.ascontiguousarray(one, dtype=np.float64) for one in (sampled.a, sampled.b, sampled.c, sampled.d)),
        tuple(np.ascontiguousarray(one, dtype=np.float64) for one in law),
        measured,
        limit,
        np.ascontiguousarray(ground_acceleration, dtype=np.float64),
        np.ascontiguousarray(commands if controller is None else commands[:0], dtype=np.float64),
        np.array(elements).reshape(-1, 4),
        sample_period,
    )
    count = len(model.outputs)
    return Motion(outputs[:, :count], until, outputs[:, count:], held)


@compiled
def _moved(
    matrices: tuple[NDArray[np.float64], ...],
    law: tuple[NDArray[np.float64], ...],
    measured: NDArray[np.int64],
    capacity: NDArray[np.float64],
    ground: NDArray[np.float64],
    given: NDArray[np.float64],
    elements: NDArray[np.float64],
    period: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Outputs followed by motions, commands that act up to each sample, and the elements' forces, impulses or slips.

    The columns of `elements` (elements, 4) are limit, slope, 1 for an impulse, and yield drift. If `given` is empty,
    (0, commands), the controller gives the commands.
    """
    a, b, c, d = matrices
    law_a, law_b, law_c, law_d, correction = law
    samples, states, groups, count = len(ground), len(a), len(capacity), len(elements)
    first, channels = 1 + groups, len(c) - count
    limits, slopes, impulse, joint = elements[:, 0], elements[:, 1], elements[:, 2] > 0.0, elements[:, 3] > 0.0
    moved, passed = c[channels:].copy(), d[channels:].copy()
    pushed = b[:, first:].copy()
    scale = np.where(impulse, 1.0 / period, 1.0)
    gains = (moved @ pushed + passed[:, first:].copy()) * scale
    outputs, commands, held = np.zeros((samples, len(c))), np.zeros((samples, groups)), np.zeros((samples, count))
    state, memory, drive = np.zeros(states), np.zeros(len(law_a)), np.zeros(first + count)
    p, was, stretch, before, motion = np.zeros((5, count))
    force, command = np.zeros(count), np.zeros(groups)
    for k in range(samples):
        commands[k] = drive[1:first]
        drive[0] = ground[k]
        drive[1:first] = given[k] if len(given) else command
        drive[first:] = force
        outputs[k] = c @ state + d @ drive
        if not len(given):
            seen = outputs[k][measured]
            wanted = law_c @ memory + law_d @ seen
            command = np.minimum(np.maximum(wanted, -capacity), capacity)
            memory = law_a @ memory + law_b @ seen + correction @ (command - wanted)
        # the elements' mean effect, which the linear model contains, is subtracted; the force of joints is added
        for j in range(count):
            now = outputs[k, channels + j]
            path = now - before[j]
            force[j] = slopes[j] * (path / period if impulse[j] else now)
            held[k, j] = p[j]
            if joint[j]:
                stretch[j] += path * (1.0 - abs(stretch[j]) / elements[j, 3] if path * stretch[j] > 0 else 1.0)
                held[k, j] = now - stretch[j]
                force[j] += limits[j] * held[k, j]
            before[j] = now
        drive[first:] = force
        state = a @ state + b @ drive
        drive[0] = ground[min(k + 1, samples - 1)]
        motion[:] = moved @ state + passed @ drive
        was[:] = p
        for j in range(count):
            if not (impulse[j] or joint[j]):
                motion -= gains[:, j] * p[j]
        unsettled = True
        for _ in range(SWEEPS):
            if not unsettled:
                break
            unsettled = False
            for j in range(count):
                if joint[j]:
                    continue
                more = min(max(p[j] + motion[j] / gains[j, j], -limits[j]), limits[j]) - p[j]
                unsettled = unsettled or abs(more) > 1e-9 * limits[j]
                p[j] += more
                motion -= gains[:, j] * more
        for j in range(count):
            if not joint[j]:
                against = -(p[j] - was[j]) / period if impulse[j] else -p[j]
                force[j] += against
                state += pushed[:, j] * against
    return outputs, commands, held
