# SPDX-License-Identifier: Apache-2.0
"""The compiled step of `motion`: the rig from one sample to the next."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from abrace_core.model.compiled import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

SWEEPS = 50
"""Of Gauss and Seidel over the frictions, at most; those that do not act on one another need two."""
NO_SEAL = -1
"""In place of the number of a friction: a group's seals have none."""

GROUP = np.dtype(
    [
        (name, "f8")
        for name in (
            *("valve_gain", "inverse_lag", "capacity", "flow_limit", "stroke_limit", "stop_stiffness"),
            *("deadband", "inverse_stall", "play", "play_compliance"),
        )
    ]
    + [("seal", "i8")]
)
"""A brace group's connected / tau and 1 / tau [1/s], and the limits of its actuator; its valve's deadband [N/s] and 1 /
stall_force [1/N]; half its pins' clearance times the oil column's stiffness [N] and 1 / that stiffness [m/N]; which
element the friction of its seals is."""
SEGMENT = np.dtype([("substep", "f8"), ("count", "i8")])
"""Length of a substep [sample periods] and number of substeps."""
ELEMENT = np.dtype(
    [
        (name, "f8")
        for name in (
            *("stiffness", "yield_drift", "exponent", "beta", "limit"),
            *("stretch", "drift", "force", "velocity", "force_before"),
        )
    ]
)
"""An element: a spring's constants or a friction's limit [N], and its state: a spring's z over its yield drift, the
drift at which it was so [m], the force [N]; what follows is for the step's own use."""


class Constants(NamedTuple):
    """What the motion of a rig is computed from.

    Command delays divide a sample period into segments in which the acting commands are constant. The elements are
    springs, then frictions.
    """

    first_force: int
    """Number of the state that is the first group's force."""
    springs: int
    """How many of the elements are springs."""
    groups: NDArray[np.void]
    """(groups,) of `GROUP`."""
    rows: NDArray[np.float64]
    """(3 groups + elements, states): of the state each force's rate by the valve, its rate by the motion c / tau v,
    each stroke; the drift of a spring, the velocity at a friction."""
    outputs: NDArray[np.float64]
    """(states + 1 + elements, channels): [z, w] of the state, the commanded ground acceleration, the elements'
    forces."""
    segments: NDArray[np.void]
    """(segments,) of `SEGMENT`."""
    ages: NDArray[np.int64]
    """(segments, groups) samples since the acting command was sent."""
    responses: NDArray[np.float64]
    """(segments, rows, states) increments of the state in a substep, a row for each cause: the state's own entries
    before it; the ground acceleration at its begin, and its change until its end; the commands; the corrections and
    frictions at its begin, and their change until its end (phi_1 and phi_2 of ETD2RK)."""
    filters: NDArray[np.float64]
    """(segments, order + 1, order + 2, channels) as from `filter_responses`; without filters of no channels."""


@compiled
def next_sample(
    state: NDArray[np.float64],
    elements: NDArray[np.void],
    filtered: NDArray[np.float64],
    sent: NDArray[np.float64],
    ground_before: float,
    ground_now: float,
    command: NDArray[np.float64],
    constants: tuple,
) -> tuple[NDArray[np.float64], float]:
    """z and w at the next sample, to which everything is advanced.

    Parameters
    ----------
    state
        (states,).
    elements
        (elements,) of `ELEMENT`.
    filtered
        (1 + order, channels): the signal at the last substep's end, and the states of its filter.
    sent
        (ages, groups) commands sent before, the last first; `command` is put in front.
    ground_before, ground_now
        Acceleration commanded to the ground at the last sample and at the next [m/s^2].
    command
        (groups,) [N].
    constants
        `Constants` as a plain tuple, whose type numba finds faster at each call than that of a named one.
    """
    rig, states, groups = Constants(*constants), len(state), len(command)
    first_force, springs, channels = rig.first_force, rig.springs, rig.outputs.shape[1]
    frictions, filters, order = len(elements) - springs, rig.filters.shape[3], rig.filters.shape[1] - 1
    corrections, first_stroke = 2 * groups + springs, (channels - 1) // 2 - groups
    first_step = states + 2 + groups
    after, acting, signals = np.empty(states), np.empty(groups), np.empty(channels)
    correction, change = np.zeros(corrections), np.zeros(corrections)
    gains, filtering = np.zeros((frictions, frictions)), np.empty((order, channels))
    held = np.zeros(groups, dtype=np.bool_)
    ground = ground_before
    for segment in range(len(rig.segments)):
        response, count = rig.responses[segment], rig.segments[segment]["count"]
        of_friction = response[first_step + corrections : first_step + corrections + frictions]
        ground_change = rig.segments[segment]["substep"] * (ground_now - ground_before)
        for j in range(groups):
            acting[j] = sent[rig.ages[segment, j], j]
        for k in range(frictions):
            for m in range(frictions):
                gains[k, m] = 0.0
                for i in range(states):
                    gains[k, m] += rig.rows[3 * groups + springs + k, i] * of_friction[m, i]
        for substep in range(count):
            # the linear model, with friction as it was
            for i in range(states):
                after[i] = response[states, i] * ground + response[states + 1, i] * ground_change
            for j in range(states):
                for i in range(states):
                    after[i] += response[j, i] * state[j]
            for j in range(groups):
                for i in range(states):
                    after[i] += response[states + 2 + j, i] * acting[j]
            for k in range(frictions):
                for i in range(states):
                    after[i] += of_friction[k, i] * elements[springs + k]["force"]

            # the corrections at the begin, then their change until the end
            limited = springs > 0
            for stage in range(2):
                point = after if stage else state
                for j in range(groups):
                    group = rig.groups[j]
                    flow_limit, stroke_limit, play_limit = group["flow_limit"], group["stroke_limit"], group["play"]
                    valve, motion, stroke = group["valve_gain"] * acting[j], 0.0, 0.0
                    for i in range(states):
                        valve += rig.rows[j, i] * point[i]
                        motion += rig.rows[groups + j, i] * point[i]
                        stroke += rig.rows[2 * groups + j, i] * point[i]
                    seal = elements[group["seal"]]["force"] if group["seal"] != NO_SEAL else 0.0
                    force = point[first_force + j]
                    play = min(max(force + seal, -play_limit), play_limit)
                    extra = -group["stop_stiffness"] * (stroke - min(max(stroke, -stroke_limit), stroke_limit)) - play
                    valve -= group["inverse_lag"] * (extra + seal)
                    asked = valve - min(max(valve, -group["deadband"]), group["deadband"])
                    oil = force - play if asked > 0 else play - force
                    flow = min(max(asked, -flow_limit), flow_limit)
                    if group["inverse_stall"] > 0.0:
                        flow *= math.sqrt(max(0.0, 1.0 - group["inverse_stall"] * oil))
                    rate = flow - motion
                    outward = rate > 0 if force > 0 else rate < 0
                    held[j] = outward and (held[j] if stage else abs(force) >= group["capacity"] + play_limit)
                    kept = -rate if held[j] else 0.0
                    change[j] = flow - valve + kept - correction[j] * stage
                    change[groups + j] = extra - correction[groups + j] * stage
                    limited = limited or change[j] != 0.0 or extra != 0.0
                for k in range(springs):
                    spring, drift = elements[k], 0.0
                    for i in range(states):
                        drift += rig.rows[3 * groups + k, i] * point[i]
                    path, z = (drift - spring["drift"]) / spring["yield_drift"], spring["stretch"]
                    for share in (0.5, 1.0):
                        turn = spring["beta"] if path * z > 0 else -spring["beta"]
                        slope = 1.0 - abs(z) ** spring["exponent"] * (1.0 - spring["beta"] + turn)
                        z = spring["stretch"] + share * path * slope
                    if not stage:
                        spring["stretch"], spring["drift"] = z, drift
                    spring["force"] = spring["stiffness"] * (spring["yield_drift"] * z - drift)
                    change[2 * groups + k] = spring["force"] - correction[2 * groups + k] * stage
                if limited:
                    row = first_step + stage * (corrections + frictions)
                    for j in range(corrections):
                        for i in range(states):
                            after[i] += response[row + j, i] * change[j]
                correction[:] = change

            # the friction that leaves the least velocity at the end
            for k in range(frictions):
                friction = elements[springs + k]
                friction["force_before"], friction["velocity"] = friction["force"], 0.0
                for i in range(states):
                    friction["velocity"] += rig.rows[3 * groups + springs + k, i] * after[i]
            unsettled = frictions > 0
            for _ in range(SWEEPS):
                if not unsettled:
                    break
                unsettled = False
                for k in range(frictions):
                    friction = elements[springs + k]
                    limit, force = friction["limit"], friction["force"]
                    more = min(max(force - friction["velocity"] / gains[k, k], -limit), limit) - force
                    unsettled = unsettled or abs(more) > 1e-12 * limit
                    friction["force"] += more
                    for m in range(frictions):
                        elements[springs + m]["velocity"] += gains[m, k] * more
            for k in range(frictions):
                more = elements[springs + k]["force"] - elements[springs + k]["force_before"]
                for i in range(states):
                    after[i] += of_friction[k, i] * more
            for j in range(groups):
                force, reach = after[first_force + j], rig.groups[j]["capacity"] + rig.groups[j]["play"]
                if not held[j]:
                    state[first_force + j] = min(max(force, -reach), reach)
                after[first_force + j] = state[first_force + j]
            state[:] = after
            ground += ground_change

            # the signals, and the filters that they pass
            last = segment == len(rig.segments) - 1 and substep == count - 1
            if not (last or filters):
                continue
            for k in range(channels):
                signals[k] = rig.outputs[states, k] * (ground_now if last else ground)
            for j in range(states):
                for k in range(channels):
                    signals[k] += rig.outputs[j, k] * state[j]
            for j in range(groups):
                group, stroke = rig.groups[j], 0.0
                for i in range(states):
                    stroke += rig.rows[2 * groups + j, i] * state[i]
                beyond = stroke - min(max(stroke, -group["stroke_limit"]), group["stroke_limit"])
                if beyond != 0.0:
                    for k in range(channels):
                        signals[k] -= rig.outputs[first_force + j, k] * group["stop_stiffness"] * beyond
                if group["play"] > 0.0:
                    seal = elements[group["seal"]]["force"] if group["seal"] != NO_SEAL else 0.0
                    play = min(max(state[first_force + j] + seal, -group["play"]), group["play"])
                    for k in range(channels):
                        signals[k] -= rig.outputs[first_force + j, k] * play
                    signals[first_stroke + j] += play * group["play_compliance"]
            for j in range(springs + frictions):
                for k in range(channels):
                    signals[k] += rig.outputs[states + 1 + j, k] * elements[j]["force"]
            if not filters:
                continue
            response_of = rig.filters[segment]
            for i in range(order):
                for k in range(channels):
                    before = filtered[0, k]
                    value = response_of[i, order, k] * before + response_of[i, order + 1, k] * (signals[k] - before)
                    for j in range(order):
                        value += response_of[i, j, k] * filtered[1 + j, k]
                    filtering[i, k] = value
            for k in range(channels):
                filtered[0, k] = signals[k]
                signals[k] *= response_of[order, order + 1, k]
                for j in range(order):
                    filtered[1 + j, k] = filtering[j, k]
                    signals[k] += response_of[order, j, k] * filtering[j, k]

    for age in range(len(sent) - 1, 0, -1):
        sent[age] = sent[age - 1]
    for j in range(groups):
        sent[0, j] = min(max(command[j], -rig.groups[j]["capacity"]), rig.groups[j]["capacity"])
    return signals[:-1], signals[-1]
