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
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from abrace_core.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_plant.rig.model import BraceGroup, Rig

SUBSTEPS = 8.0
"""How many substeps the fastest of what a limit drives takes: a servo's lag, a floor's radian against its stop."""


class RigMotion:
    """A rig that starts at rest.

    Parameters
    ----------
    rig
        The rig.
    refinement
        Times as many substeps as usual, to see what is left to gain.
    """

    def __init__(self, rig: Rig, refinement: int = 1) -> None:
        model, groups, floors = rig.model, rig.groups, rig.floors
        states, dofs = model.order, floors + len(rig.local_modes)
        actuators = [group.actuator for group in rig.braces]
        forces = slice(2 * dofs, 2 * dofs + groups)

        # the corrections' ways into the state: the rates of f, and the stops' forces, which act wherever f does
        ways = np.zeros((states, 2 * groups))
        ways[forces, :groups] = np.eye(groups)
        ways[:, groups:] = model.a[:, forces]
        period = 1 / rig.sample_rate
        longest = min([_shortest_time(rig, group) / SUBSTEPS for group in rig.braces], default=period)
        delay = np.array([actuator.command_delay / period for actuator in actuators])
        whole = np.floor(delay + 1e-9).astype(np.int64)
        part = np.where(delay - whole > 1e-9, delay - whole, 0.0)
        # the sample period in segments of constant commands, whose ages are counted in samples
        edges = np.unique([0.0, *part, 1.0])
        spans = np.diff(edges)
        counts = np.maximum(1, np.ceil(spans * period / longest - 1e-9)).astype(np.int64) * refinement
        ages = np.array([whole + (part > begin) for begin in edges[:-1]]).reshape(len(spans), groups)
        responses = np.array([_responses(model.a, model.b, ways, span) for span in (spans / counts * period).tolist()])
        # the force's rate is that by the valve, s = valve x + U / tau, less that by the motion, c / tau v
        moving = np.zeros((groups, states))
        moving[:, dofs : 2 * dofs] = -model.a[forces, dofs : 2 * dofs]
        rows = np.vstack([model.a[forces] + moving, moving, model.c[floors : floors + groups]])
        limits = [
            (group.connected / a.lag, 1 / a.lag, a.capacity, a.flow_limit, a.stroke_limit, a.stop_stiffness)
            for group, a in zip(rig.braces, actuators, strict=True)
        ]
        seen = np.hstack([model.c, model.d[:, :1]]).T
        self._rig = (
            np.array(limits, dtype=np.float64).reshape(groups, 6),
            rows,
            spans / counts,
            counts,
            ages,
            responses,
            np.ascontiguousarray(seen),
            2 * dofs,
        )
        self._outputs = len(model.outputs)
        self._state = np.zeros(states)
        self._ground = 0.0
        self._sent = np.zeros((int(whole.max(initial=0)) + 2, groups))
        # the rig stays at rest; what is compiled at its first call is compiled now and not between two samples
        self.outputs(0.0, np.zeros(groups))

    def outputs(self, ground_acceleration: float, command: NDArray[np.float64]) -> NDArray[np.float64]:
        """z at the next sample, whose ground acceleration is given; the command is sent at it.

        Parameters
        ----------
        ground_acceleration
            At this instant [m/s^2]; linear since the last one, before the first of which it was zero.
        command
            (groups,) [N], held until the next sample; cut to the capacity.

        Returns
        -------
        NDArray
            The outputs in the order of the rig's model.
        """
        found = np.empty(self._outputs)
        _next_sample(self._state, self._sent, found, self._ground, ground_acceleration, command, *self._rig)
        self._ground = ground_acceleration
        return found


def _shortest_time(rig: Rig, group: BraceGroup) -> float:
    """The lag of the group's servo, or the time of a radian of its lighter floor against the stops, if shorter [s]."""
    stiffness = group.count * group.cosine**2 * group.actuator.stop_stiffness
    lightest = min(rig.building.masses[max(group.floor - 2, 0) : group.floor])
    return float(min(group.actuator.lag, math.sqrt(lightest / stiffness) if stiffness else math.inf))


def _responses(
    a: NDArray[np.float64], b: NDArray[np.float64], ways: NDArray[np.float64], span: float
) -> NDArray[np.float64]:
    """What a substep adds to the state, a row for each cause: (rows, states).

    Rows: the state's own entries before it; the ground acceleration at its begin, and its change until its end; the
    commands; the corrections at its begin, and their change until its end (phi_1 and phi_2 of ETD2RK).
    """
    n, m = len(a), b.shape[1] + ways.shape[1]
    block = np.zeros((n + 2 * m, n + 2 * m))
    block[:n, :n] = a * span
    block[:n, n : n + m] = np.hstack([b, ways]) * span
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
    found: NDArray[np.float64],
    ground_before: float,
    ground_now: float,
    command: NDArray[np.float64],
    limits: NDArray[np.float64],
    rows: NDArray[np.float64],
    substeps: NDArray[np.float64],
    counts: NDArray[np.int64],
    ages: NDArray[np.int64],
    responses: NDArray[np.float64],
    seen: NDArray[np.float64],
    first_force: int,
) -> None:
    """Take `state` to the next sample, observe it in `found`, and put `command` in front of those that were `sent`."""
    states, groups = len(state), len(command)
    after, acting = np.empty(states), np.empty(groups)
    correction, change = np.zeros(2 * groups), np.zeros(2 * groups)
    held = np.zeros(groups, dtype=np.bool_)
    ground = ground_before
    for segment in range(len(counts)):
        response = responses[segment]
        ground_change = substeps[segment] * (ground_now - ground_before)
        for j in range(groups):
            acting[j] = sent[ages[segment, j], j]
        for _ in range(counts[segment]):
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
                    gain, valve_gain, capacity, flow_limit, stroke_limit, stop_stiffness = limits[j]
                    valve, motion, stroke = gain * acting[j], 0.0, 0.0
                    for i in range(states):
                        valve += rows[j, i] * point[i]
                        motion += rows[groups + j, i] * point[i]
                        stroke += rows[2 * groups + j, i] * point[i]
                    stop = -stop_stiffness * (stroke - min(max(stroke, -stroke_limit), stroke_limit))
                    valve -= valve_gain * stop
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
                force, capacity = after[first_force + j], limits[j, 2]
                if not held[j]:
                    state[first_force + j] = min(max(force, -capacity), capacity)
                after[first_force + j] = state[first_force + j]
            state[:] = after
            ground += ground_change

    for k in range(len(found)):
        found[k] = seen[states, k] * ground_now
    for j in range(states):
        for k in range(len(found)):
            found[k] += seen[j, k] * state[j]
    for j in range(groups):
        stroke_limit, stop_stiffness = limits[j, 4], limits[j, 5]
        stroke = 0.0
        for i in range(states):
            stroke += rows[2 * groups + j, i] * state[i]
        beyond = stroke - min(max(stroke, -stroke_limit), stroke_limit)
        if beyond != 0.0:
            for k in range(len(found)):
                found[k] -= seen[first_force + j, k] * stop_stiffness * beyond
    for age in range(len(sent) - 1, 0, -1):
        sent[age] = sent[age - 1]
    for j in range(groups):
        sent[0, j] = min(max(command[j], -limits[j, 2]), limits[j, 2])
