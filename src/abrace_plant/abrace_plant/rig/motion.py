"""The rig moving sample by sample within its limits: capacity, valve flow, end stops, command delay.

Within a sample the rig obeys

    x' = A x + B u + P n(x, u)

with A and B of the rig's linear model and n the corrections of the limits, all zero while no limit is met:

    flow      s = (U - f_cell + omega_i g) / tau, the force's rate by the valve, is cut to +-flow_limit
    capacity  the oil's force f rises no further at +-capacity
    stops     f_cell = f - k (stroke beyond the limit): what the building, the load cell and the servo feel

It is solved in equal substeps by the exponential Runge-Kutta method ETD2RK (Cox and Matthews 2002): the linear part is
exact, the corrections are taken linear over a substep. So linear motion is exact whatever the substep, and the error of
limited motion falls with the square of the substep. At the capacity f is held where it is; a substep that overshoots it
ends there. A delayed command changes at the boundary of two substeps.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy import linalg

from abrace_core.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_plant.rig.model import BraceGroup, Rig

SUBSTEPS = 8.0
"""Substeps in the shortest time constant of limited motion: a servo's lag, or a radian of a floor against its stop."""


_GROUP = np.dtype(
    [(name, "f8") for name in ("valve_gain", "inverse_lag", "capacity", "flow_limit", "stroke_limit", "stop_stiffness")]
)
"""A brace group's connected / tau and 1 / tau [1/s], and the limits of its actuator."""
_SEGMENT = np.dtype([("substep", "f8"), ("count", "i8")])
"""Length of a substep [sample periods] and number of substeps."""
_VALVE, _MOTION, _STROKE = range(3)


class _Constants(NamedTuple):
    """What the motion of a rig is computed from.

    Command delays divide a sample period into segments in which the acting commands are constant.
    """

    groups: NDArray[np.void]
    """(groups,) of `_GROUP`."""
    rows: NDArray[np.float64]
    """(3, groups, states): of the state the force's rate by the valve, its rate by the motion c / tau v, the stroke."""
    outputs: NDArray[np.float64]
    """(states + 1, outputs): z of the state and, in the last row, of the ground acceleration."""
    segments: NDArray[np.void]
    """(segments,) of `_SEGMENT`."""
    ages: NDArray[np.int64]
    """(segments, groups) samples since the acting command was sent."""
    responses: NDArray[np.float64]
    """(segments, rows, states) as from `_responses`."""


class RigMotion:
    """A rig that starts at rest.

    Parameters
    ----------
    rig
        The rig.
    refinement
        Times as many substeps as usual, to measure the error of the usual ones.
    """

    def __init__(self, rig: Rig, refinement: int = 1) -> None:
        model, groups, floors = rig.model, rig.groups, rig.floors
        states, dofs = model.order, floors + len(rig.local_modes)
        actuators = [group.actuator for group in rig.braces]
        forces = slice(2 * dofs, 2 * dofs + groups)

        # how the corrections enter the state: the rates of f, and the stops' forces, which act wherever f does
        entries = np.zeros((states, 2 * groups))
        entries[forces, :groups] = np.eye(groups)
        entries[:, groups:] = model.a[:, forces]
        period = 1 / rig.sample_rate
        longest = min([_shortest_time(rig, group) / SUBSTEPS for group in rig.braces], default=period)
        delay = np.array([actuator.command_delay / period for actuator in actuators])
        whole = np.floor(delay + 1e-9).astype(np.int64)
        part = np.where(delay - whole > 1e-9, delay - whole, 0.0)
        edges = np.unique([0.0, *part, 1.0])
        spans = np.diff(edges)
        counts = np.maximum(1, np.ceil(spans * period / longest - 1e-9)).astype(np.int64) * refinement
        ages = np.array([whole + (part > begin) for begin in edges[:-1]]).reshape(len(spans), groups)
        substeps = spans / counts
        responses = np.array([_responses(model.a, model.b, entries, span) for span in (substeps * period).tolist()])
        motion = np.zeros((groups, states))
        motion[:, dofs : 2 * dofs] = -model.a[forces, dofs : 2 * dofs]
        limits = [
            (group.connected / a.lag, 1 / a.lag, a.capacity, a.flow_limit, a.stroke_limit, a.stop_stiffness)
            for group, a in zip(rig.braces, actuators, strict=True)
        ]
        # a plain tuple, whose type numba finds faster at each call than that of a named one
        self._constants = tuple(
            _Constants(
                groups=np.array(limits, dtype=_GROUP),
                rows=np.array([model.a[forces] + motion, motion, model.c[floors : floors + groups]]),
                outputs=np.ascontiguousarray(np.hstack([model.c, model.d[:, :1]]).T),
                segments=np.array(list(zip(substeps, counts, strict=True)), dtype=_SEGMENT),
                ages=ages,
                responses=responses,
            )
        )
        self._state = np.zeros(states)
        self._ground = 0.0
        self._sent = np.zeros((int(whole.max(initial=0)) + 2, groups))
        # the rig stays at rest; what is compiled at its first call is compiled now and not between two samples
        self.outputs(0.0, np.zeros(groups))

    def outputs(self, ground_acceleration: float, command: NDArray[np.float64]) -> NDArray[np.float64]:
        """z at the next sample, at which the ground has the given acceleration and the command is sent.

        Parameters
        ----------
        ground_acceleration
            At that sample [m/s^2]; linear between samples, and zero before the first.
        command
            (groups,) [N], held until the next sample; cut to the capacity.

        Returns
        -------
        NDArray
            The outputs in the order of the rig's model.
        """
        before, self._ground = self._ground, ground_acceleration
        return _next_sample(self._state, self._sent, before, ground_acceleration, command, self._constants)


def _shortest_time(rig: Rig, group: BraceGroup) -> float:
    """The lag of the group's servo, or the time of a radian of its lighter floor against the stops, if shorter [s]."""
    stiffness = group.count * group.cosine**2 * group.actuator.stop_stiffness
    lightest = min(rig.building.masses[max(group.floor - 2, 0) : group.floor])
    return float(min(group.actuator.lag, math.sqrt(lightest / stiffness) if stiffness else math.inf))


def _responses(
    a: NDArray[np.float64], b: NDArray[np.float64], entries: NDArray[np.float64], span: float
) -> NDArray[np.float64]:
    """What a substep adds to the state, a row for each cause: (rows, states).

    Rows: the state's own entries before it; the ground acceleration at its begin, and its change until its end; the
    commands; the corrections at its begin, and their change until its end (phi_1 and phi_2 of ETD2RK).
    """
    n, m = len(a), b.shape[1] + entries.shape[1]
    block = np.zeros((n + 2 * m, n + 2 * m))
    block[:n, :n] = a * span
    block[:n, n : n + m] = np.hstack([b, entries]) * span
    block[n : n + m, n + m :] = np.eye(m)
    block = linalg.expm(block)[:n]
    steps, ramps = block[:, n : n + m], block[:, n + m :]
    inputs = b.shape[1]
    columns = [block[:, :n], steps[:, :1], ramps[:, :1], steps[:, 1:inputs], steps[:, inputs:], ramps[:, inputs:]]
    return np.ascontiguousarray(np.hstack(columns).T)


@compiled
def _next_sample(
    state: NDArray[np.float64],
    sent: NDArray[np.float64],
    ground_before: float,
    ground_now: float,
    command: NDArray[np.float64],
    constants: tuple,
) -> NDArray[np.float64]:
    """z at the next sample; advances `state` to it and puts `command` in front of those that were `sent` before."""
    rig, states, groups = _Constants(*constants), len(state), len(command)
    # the last states are the forces and the servos' integrals
    first_force = states - 2 * groups
    after, acting = np.empty(states), np.empty(groups)
    correction, change = np.zeros(2 * groups), np.zeros(2 * groups)
    held = np.zeros(groups, dtype=np.bool_)
    ground = ground_before
    for segment in range(len(rig.segments)):
        response = rig.responses[segment]
        ground_change = rig.segments[segment]["substep"] * (ground_now - ground_before)
        for j in range(groups):
            acting[j] = sent[rig.ages[segment, j], j]
        for _ in range(rig.segments[segment]["count"]):
            for i in range(states):
                after[i] = response[states, i] * ground + response[states + 1, i] * ground_change
            for j in range(states):
                for i in range(states):
                    after[i] += response[j, i] * state[j]
            for j in range(groups):
                for i in range(states):
                    after[i] += response[states + 2 + j, i] * acting[j]
            limited = False
            for stage in range(2):
                point = after if stage else state
                for j in range(groups):
                    group = rig.groups[j]
                    capacity, flow_limit, stroke_limit = group["capacity"], group["flow_limit"], group["stroke_limit"]
                    valve, motion, stroke = group["valve_gain"] * acting[j], 0.0, 0.0
                    for i in range(states):
                        valve += rig.rows[_VALVE, j, i] * point[i]
                        motion += rig.rows[_MOTION, j, i] * point[i]
                        stroke += rig.rows[_STROKE, j, i] * point[i]
                    stop = -group["stop_stiffness"] * (stroke - min(max(stroke, -stroke_limit), stroke_limit))
                    valve -= group["inverse_lag"] * stop
                    flow = min(max(valve, -flow_limit), flow_limit)
                    rate, force = flow - motion, point[first_force + j]
                    outward = rate > 0 if force > 0 else rate < 0
                    held[j] = outward and (held[j] if stage else abs(force) >= capacity)
                    kept = -rate if held[j] else 0.0
                    change[j] = flow - valve + kept - correction[j] * stage
                    change[groups + j] = stop - correction[groups + j] * stage
                    limited = limited or change[j] != 0.0 or stop != 0.0
                if limited:
                    row = states + 2 + (3 if stage else 1) * groups
                    for j in range(2 * groups):
                        for i in range(states):
                            after[i] += response[row + j, i] * change[j]
                correction[:] = change
            for j in range(groups):
                force, capacity = after[first_force + j], rig.groups[j]["capacity"]
                if not held[j]:
                    state[first_force + j] = min(max(force, -capacity), capacity)
                after[first_force + j] = state[first_force + j]
            state[:] = after
            ground += ground_change

    z = np.empty(rig.outputs.shape[1])
    for k in range(len(z)):
        z[k] = rig.outputs[states, k] * ground_now
    for j in range(states):
        for k in range(len(z)):
            z[k] += rig.outputs[j, k] * state[j]
    for j in range(groups):
        stroke_limit = rig.groups[j]["stroke_limit"]
        stroke = 0.0
        for i in range(states):
            stroke += rig.rows[_STROKE, j, i] * state[i]
        beyond = stroke - min(max(stroke, -stroke_limit), stroke_limit)
        if beyond != 0.0:
            for k in range(len(z)):
                z[k] -= rig.outputs[first_force + j, k] * rig.groups[j]["stop_stiffness"] * beyond
    for age in range(len(sent) - 1, 0, -1):
        sent[age] = sent[age - 1]
    for j in range(groups):
        sent[0, j] = min(max(command[j], -rig.groups[j]["capacity"]), rig.groups[j]["capacity"])
    return z
