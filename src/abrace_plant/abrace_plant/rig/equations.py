# SPDX-License-Identifier: Apache-2.0
"""The equations that `motion` steps: the linear model on its table, and where limits, springs and friction act."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from abrace_plant.rig.building import storey_direction
from abrace_plant.rig.sensor_dynamics import with_cross_axis
from abrace_plant.rig.step import ELEMENT, NO_SEAL

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_plant.rig.model import Rig


class Equations(NamedTuple):
    """x' = A x + B u + P n, and [z, w] of the state.

    The state is that of the rig's model; where the table has dynamics its following error and that error's rate come
    last. The corrections n are the rates of the forces and the forces at the load cells, one a brace group each, then
    the forces of the springs less those of the linear model, then the friction forces.
    """

    a: NDArray[np.float64]
    """(states, states)."""
    b: NDArray[np.float64]
    """(states, 1 + groups) of the acceleration commanded to the table, and of the commands."""
    entries: NDArray[np.float64]
    """(states, 2 groups + springs + frictions), P."""
    outputs: NDArray[np.float64]
    """(states + 1, channels): [z, w] of the state and, in the last row, of the acceleration commanded to the table."""
    elements: NDArray[np.void]
    """(springs + frictions,) of `step.ELEMENT`: springs, then the frictions of the storeys and seals that have any."""
    seals: NDArray[np.int64]
    """(groups,) which element the friction of a group's seals is, or `step.NO_SEAL`."""
    element_rows: NDArray[np.float64]
    """(springs + frictions, states) of a spring's drift, and of the velocity at a friction."""
    element_outputs: NDArray[np.float64]
    """(springs + frictions, channels): [z, w] of their forces."""


def equations(rig: Rig) -> Equations:
    """The equations of a `rig`."""
    rig = with_cross_axis(rig)
    model, groups, floors = rig.model, rig.groups, rig.floors
    states, dofs = model.order, floors + len(rig.local_modes)
    positions, velocities = slice(0, floors), slice(dofs, dofs + floors)
    springs = rig.building.hysteresis
    storeys = [(storey, limit) for storey, limit in enumerate(rig.building.friction, 1) if limit]
    sealed = [j for j, group in enumerate(rig.braces) if group.connected and group.actuator.friction]

    # a spring pulls back against its drift, a friction's force is along its velocity
    at_storeys = np.zeros((states, len(springs) + len(storeys)))
    rows = np.zeros((len(springs) + len(storeys) + len(sealed), states))
    for i, storey in enumerate([spring.storey for spring in springs] + [storey for storey, _ in storeys]):
        direction, yields = storey_direction(storey, floors), i < len(springs)
        at_storeys[velocities, i] = (-direction if yields else direction) / rig.building.masses
        rows[i, positions if yields else velocities] = direction
    for i, j in enumerate(sealed):
        rows[len(springs) + len(storeys) + i, dofs : 2 * dofs] = model.c[floors + j, :dofs]
    accelerations = slice(floors + groups, 2 * floors + groups)
    outputs = np.zeros((states + 1, model.c.shape[0] + 1))
    outputs[:states, :-1], outputs[states, :-1], outputs[states, -1] = model.c.T, model.d[:, 0], 1.0
    of_storeys = np.zeros((at_storeys.shape[1], outputs.shape[1]))
    of_storeys[:, accelerations] = at_storeys[velocities].T

    a, b = model.a, model.b
    if (table := rig.table_dynamics) is not None:
        floor_forces = rig.building.masses @ np.hstack([a[velocities], at_storeys[velocities]])
        own = [-(table.frequency**2), -2 * table.damping_ratio * table.frequency]
        row = np.concatenate([-floor_forces[:states] / table.mass, own])
        of_forces = -floor_forces[states:] / table.mass
        moved = np.append(b[:, 0], [0.0, 1.0])
        a = np.zeros((states + 2, states + 2))
        a[:states, :states], a[states, states + 1] = model.a, 1.0
        a += np.outer(moved, row)
        b = np.vstack([b, np.zeros((2, 1 + groups))])
        b[:, 0] = np.append(np.zeros(states + 1), -1.0)
        at_storeys = np.vstack([at_storeys, np.zeros((2, at_storeys.shape[1]))]) + np.outer(moved, of_forces)
        of_storeys += np.outer(of_forces, outputs[states])
        rows = np.hstack([rows, np.zeros((len(rows), 2))])
        outputs = np.vstack([outputs[:states], np.zeros((3, outputs.shape[1]))]) + np.outer(
            np.append(row, 0.0), outputs[states]
        )
    forces = slice(2 * dofs, 2 * dofs + groups)
    entries = np.zeros((len(a), 2 * groups))
    entries[forces, :groups] = np.eye(groups)
    entries[:, groups:] = a[:, forces]
    seals = np.full(groups, NO_SEAL)
    seals[sealed] = len(springs) + len(storeys) + np.arange(len(sealed))
    elements = np.zeros(len(rows), dtype=ELEMENT)
    for element, spring in zip(elements, springs, strict=False):
        for name in ("stiffness", "yield_drift", "exponent", "beta"):
            element[name] = getattr(spring, name)
    limits = [limit for _, limit in storeys] + [rig.braces[j].actuator.friction for j in sealed]
    elements["limit"][len(springs) :] = limits
    at_seals = 2 * dofs + np.array(sealed, dtype=np.int64)
    return Equations(
        a=a,
        b=b,
        entries=np.hstack([entries, at_storeys, a[:, at_seals]]),
        outputs=np.ascontiguousarray(outputs),
        elements=elements,
        seals=seals,
        element_rows=rows,
        element_outputs=np.vstack([of_storeys, outputs[at_seals]]),
    )
