# SPDX-License-Identifier: Apache-2.0
"""The linear model of a building of plane frames, from the ground's acceleration and forces between its levels."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from abrace_core.model import signals
from abrace_core.model.linear_model import LinearModel
from abrace_plant.rig.building import rayleigh_coefficients

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_studies.frames.file import FrameBuilding

STILL = 1e-9
"""Share of a mode's kinetic energy in the floors' horizontal motion, below which neither ground nor devices excite it:
the modes that a symmetric frame has only vertically."""


class ModalBuilding(NamedTuple):
    """The modes of one frame that ground and devices excite, slowest first."""

    frequencies: NDArray[np.float64]
    """(modes,) [rad/s]."""
    damping_ratios: NDArray[np.float64]
    """(modes,)."""
    ground: NDArray[np.float64]
    """(modes,) participation of the ground's acceleration."""
    levels: NDArray[np.float64]
    """(levels, modes) displacement of each level."""
    curvature: NDArray[np.float64]
    """(ends, modes) curvature over yield curvature at the members' ends, hinges left out."""


def modal_building(building: FrameBuilding, modes: int = 0) -> ModalBuilding:
    """The excited modes of one frame of a `building`; the slowest `modes` of them, 0: all."""
    structure = building.frame.structure()
    frequencies, shapes = structure.modes()
    of_mass, of_stiffness = _rayleigh(building, frequencies)
    nodes = structure.displacements @ shapes
    energy = building.frame.masses[:, 0] @ nodes.reshape(-1, 3, len(frequencies))[:, 0] ** 2
    picked = np.flatnonzero(energy > STILL)[: modes or None]
    frequencies, shapes, nodes = frequencies[picked], shapes[:, picked], nodes[:, picked]
    return ModalBuilding(
        frequencies,
        (of_mass / frequencies + of_stiffness * frequencies) / 2,
        shapes.T @ structure.ground_load,
        nodes[3 * np.array(building.levels)],
        _bending(building) @ nodes,
    )


def _bending(building: FrameBuilding) -> NDArray[np.float64]:
    """(ends, nodes' displacements) curvature over yield curvature at the members' ends, hinges left out."""
    strength = [
        (0.0 if hinged else 1 / (member.section.bending * member.section.yield_curvature))
        for member in building.frame.members
        for hinged in member.hinged
    ]
    ends = np.flatnonzero(strength)
    return np.asarray(building.frame.end_moments()[ends] * np.array(strength)[ends, None])


def _rayleigh(building: FrameBuilding, frequencies: NDArray[np.float64]) -> tuple[float, float]:
    """a0 [1/s] and a1 [s] of a `building`, whose frame has these `frequencies` (modes,) [rad/s]."""
    two = [float(frequencies[number - 1]) for number in building.damped_modes]
    return rayleigh_coefficients(two, (building.damping_ratio,) * 2)


def building_model(building: FrameBuilding, devices: Sequence[int] = (), modes: int = 0) -> LinearModel:
    """The continuous model of a building whose devices push its levels apart.

    Parameters
    ----------
    building
        The building.
    devices
        (storeys,) how many equal devices with one command each storey has, the lowest first; a storey without one has
        no command. They push the level above and the one below, each frame with its share; empty: none at all.
    modes
        Excited modes that count, the slowest; 0: all.

    Returns
    -------
    LinearModel
        From `w` and the commands `U1` ... (force of one device, [N]; one command alone is `U`) to `x1` ...
        displacements [m], `v1` ... velocities relative to the ground [m/s], `a1` ... absolute accelerations [m/s^2] of
        the levels, and `c1` ... curvature over yield curvature of the members' ends where it is known.
    """
    modal = modal_building(building, modes)
    count, levels = len(modal.frequencies), len(building.levels)
    x, v = slice(0, count), slice(count, 2 * count)
    forces = _modal_forces(building, modal, devices)
    commands = forces.shape[1] - 1
    a, b = np.zeros((2 * count, 2 * count)), np.zeros((2 * count, 1 + commands))
    a[x, v] = np.eye(count)
    a[v, x] = np.diag(-(modal.frequencies**2))
    a[v, v] = np.diag(-2 * modal.damping_ratios * modal.frequencies)
    b[v] = forces
    moves = np.zeros((levels, 2 * count))
    moves[:, x] = modal.levels
    accelerates = modal.levels @ a[v]
    through = modal.levels @ b[v]
    # what moves with the ground: all levels, exactly where all modes count
    through[:, 0] = 1.0 + through[:, 0]
    velocities = np.hstack([np.zeros((levels, count)), modal.levels])
    bends = np.hstack([modal.curvature, np.zeros((len(modal.curvature), count))])
    names = [f"{kind}{i + 1}" for kind in "xva" for i in range(levels)] + [f"c{i + 1}" for i in range(len(bends))]
    silent = np.zeros((levels, b.shape[1]))
    return LinearModel(
        a,
        b,
        np.vstack([moves, velocities, accelerates, bends]),
        np.vstack([silent, silent, through, np.zeros((len(bends), b.shape[1]))]),
        (signals.GROUND, *(signals.command_names(commands) if commands else ())),
        tuple(names),
        provenance={"frame": building.name, "modes": count},
    )


def _modal_forces(building: FrameBuilding, modal: ModalBuilding, devices: Sequence[int]) -> NDArray[np.float64]:
    """(modes, inputs) force on each mode for the ground's acceleration and for each command."""
    pushed = device_directions(devices, len(building.levels))
    return np.column_stack([-modal.ground, modal.levels.T @ pushed / building.frames])


def device_directions(devices: Sequence[int], levels: int) -> NDArray[np.float64]:
    """Force on each of so many `levels` for each newton of one device of each command, (levels, commands).

    `devices` as in `building_model`.
    """
    storeys = [storey for storey, count in enumerate(devices, 1) if count]
    found = np.zeros((levels, len(storeys)))
    for j, storey in enumerate(storeys):
        found[storey - 1, j] = devices[storey - 1]
        if storey > 1:
            found[storey - 2, j] = -devices[storey - 1]
    return found
