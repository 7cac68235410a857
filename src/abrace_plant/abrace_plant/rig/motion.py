# SPDX-License-Identifier: Apache-2.0
"""The rig's motion sample by sample: its linear model, and all nonlinear effects.

Within a sample the rig obeys

    x' = A x + B u + P n(x, u)

with A and B of the rig's linear model (on its table: `equations`) and n corrections. In a rig without nonlinear
effects they are zero while no limit is reached:

- valve: s = (U - f_cell + omega_i g) / tau, the demanded rate of the force, is reduced to the rate that the valve
  gives: minus its deadband, at most flow_limit, times the root of the pressure drop (`actuator`)
- capacity: the hydraulic force is limited to +-capacity
- stops: - k (stroke beyond the limit); added to the hydraulic force it is f_cell, which acts on building, load cell
  and servo
- backlash: within the clearance of its pins a brace carries no force (below)
- springs of storeys that yield, minus the linear springs that they replace (`hysteresis`)
- friction of storeys and seals (below)

It is solved in equal substeps by the exponential Runge-Kutta method ETD2RK (Cox and Matthews 2002): the linear part is
exact, the corrections are taken linear over a substep. So linear motion is exact whatever the substep, and the error of
limited motion falls with the square of the substep. At the capacity f is held where it is; a substep that overshoots it
ends there. A delayed command changes at the boundary of two substeps.

Backlash. A brace without mass is on one side of its pins' clearance b and pushes, on the other and pulls, or between,
where the valve's flow moves its rod freely. With k_o = c / tau of the oil column and gamma the rod's place in the
clearance, f + k_o gamma has the same rate in all three cases: it is the state f, and f_cell = f - clip(f, +-k_o b / 2).
The stroke is measured in the actuator and moves by gamma (Nordin and Gutman 2002).

Friction is Coulomb's, and sticks: in a substep it is the constant force, within its limit, that leaves the least
velocity at the substep's end (time stepping after Moreau 1988 and Jean 1999; several at once by Gauss and Seidel).
What slips loses limit times slip. Seals slip with the building, whatever the pins do; they are between oil and load
cell.

A table with dynamics is at rest on its supports until its first commanded acceleration: in a test without table motion
it is not held by its oil columns.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import linalg

from abrace_plant.rig.equations import equations
from abrace_plant.rig.sensor_dynamics import filter_responses
from abrace_plant.rig.step import GROUP, SEGMENT, Constants, next_sample

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_plant.rig.model import BraceGroup, Rig

SUBSTEPS = 8.0
"""Substeps in the shortest time constant of limited motion: a servo's lag, or a radian of a floor against its stop."""


class RigMotion:
    """A rig that starts at rest.

    Parameters
    ----------
    rig
        The rig.
    refinement
        Times as many substeps as usual, to measure the error of the usual ones.

    Attributes
    ----------
    ground_acceleration
        Of the table at the last sample, as its accelerometer's converter sees it [m/s^2].
    """

    def __init__(self, rig: Rig, refinement: int = 1) -> None:
        parked = replace(rig, table_dynamics=None)
        self._constants, self._elements = _constants(parked, refinement)
        self._released = _constants(rig, refinement)[0] if rig.table_dynamics else None
        _, _, _, rows, _, _, ages, _, filters = self._constants
        self._state = np.zeros(rows.shape[1])
        self._filtered = np.zeros((filters.shape[1], filters.shape[3]))
        self._ground = 0.0
        self._sent = np.zeros((ages.max(initial=0) + 1, rig.groups))
        # the rig stays at rest; this call compiles the step now, and not between two samples
        self.outputs(0.0, np.zeros(rig.groups))

    def outputs(self, ground_acceleration: float, command: NDArray[np.float64]) -> NDArray[np.float64]:
        """z at the next sample, at which the ground has the given acceleration and the command is sent.

        Parameters
        ----------
        ground_acceleration
            Commanded to the table at that sample [m/s^2]; linear between samples, and zero before the first.
        command
            (groups,) [N], held until the next sample; cut to the capacity.

        Returns
        -------
        NDArray
            The outputs in the order of the rig's model: after transducers and filters, where the rig has any.
        """
        if self._released is not None and ground_acceleration:
            self._state = np.append(self._state, [0.0, 0.0])
            self._constants, self._released = self._released, None
        before, self._ground = self._ground, ground_acceleration
        z, self.ground_acceleration = next_sample(
            self._state,
            self._elements,
            self._filtered,
            self._sent,
            before,
            ground_acceleration,
            command,
            self._constants,
        )
        return z


def _constants(rig: Rig, refinement: int) -> tuple[tuple[Any, ...], NDArray[np.void]]:
    """`Constants` of a `rig`, as a plain tuple, and its elements at rest."""
    model, exact = rig.model, equations(rig)
    groups, floors, dofs = rig.groups, rig.floors, rig.floors + len(rig.local_modes)
    forces = slice(2 * dofs, 2 * dofs + groups)
    period = 1 / rig.sample_rate
    without_braces = period / SUBSTEPS if len(exact.elements) else period
    longest = min([_shortest_time(rig, group) / SUBSTEPS for group in rig.braces], default=without_braces)
    delay = np.array([group.actuator.command_delay / period for group in rig.braces])
    whole = np.floor(delay + 1e-9).astype(np.int64)
    part = np.where(delay - whole > 1e-9, delay - whole, 0.0)
    edges = np.unique([0.0, *part, 1.0])
    spans = np.diff(edges)
    counts = np.maximum(1, np.ceil(spans * period / longest - 1e-9)).astype(np.int64) * refinement
    substeps = spans / counts
    lengths = (substeps * period).tolist()
    motion, stroke = np.zeros((2, groups, len(exact.a)))
    motion[:, dofs : 2 * dofs] = -model.a[forces, dofs : 2 * dofs]
    stroke[:, : model.order] = model.c[floors : floors + groups]
    constants = Constants(
        first_force=2 * dofs,
        springs=len(rig.building.hysteresis),
        groups=np.array([_of_group(*one) for one in zip(rig.braces, exact.seals, strict=True)], dtype=GROUP),
        rows=np.vstack([exact.a[forces] + motion, motion, stroke, exact.element_rows]),
        outputs=np.vstack([exact.outputs, exact.element_outputs]),
        segments=np.array(list(zip(substeps, counts, strict=True)), dtype=SEGMENT),
        ages=np.array([whole + (part > begin) for begin in edges[:-1]]).reshape(len(spans), groups),
        responses=np.array([_responses(exact.a, exact.b, exact.entries, length) for length in lengths]),
        filters=np.array([filter_responses(rig, length) for length in lengths]),
    )
    return tuple(constants), exact.elements


def _of_group(group: BraceGroup, seal: int) -> tuple[float, ...]:
    """A brace `group` as a `_GROUP`, with the number of its `seal`'s friction."""
    a = group.actuator
    oil = a.velocity_feedback / a.lag
    return (
        group.connected / a.lag,
        1 / a.lag,
        a.capacity,
        a.flow_limit,
        a.stroke_limit,
        a.stop_stiffness,
        a.deadband / a.lag,
        1 / a.stall_force,
        oil * group.backlash / 2,
        1 / oil if group.backlash else 0.0,
        seal,
    )


def _shortest_time(rig: Rig, group: BraceGroup) -> float:
    """The lag of the group's servo, or the time of a radian of its lighter floor against the stops, if shorter [s]."""
    stiffness = group.count * group.cosine**2 * group.actuator.stop_stiffness
    lightest = min(rig.building.masses[max(group.floor - 2, 0) : group.floor])
    return float(min(group.actuator.lag, math.sqrt(lightest / stiffness) if stiffness else math.inf))


def _responses(
    a: NDArray[np.float64], b: NDArray[np.float64], entries: NDArray[np.float64], span: float
) -> NDArray[np.float64]:
    """Those of a substep of `span` [s], as in `Constants`: (rows, states)."""
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
