# SPDX-License-Identifier: Apache-2.0
"""A frame under ambient excitation: white forces on its floors, which are not measured, and accelerometers."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import LinearModel, pole_table
from abrace_core.model.simulation import simulate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_plant.rig.model import Rig

RATE = 100.0
BAND = (0.5, 12.0)
FORCE = 20.0
"""Rms of the force on each floor, from sample to sample [N]."""
NOISE = 3.4e-4
"""Standard deviation of an accelerometer's noise [m/s^2]."""


def weakened(rig: Rig, storey: int, share: float) -> Rig:
    """The rig with the stiffness of a `storey` reduced by a `share`."""
    stiffness = rig.building.stiffness.copy()
    floors = len(stiffness)
    direction = np.zeros(floors)
    direction[storey - 1] = 1.0
    if storey > 1:
        direction[storey - 2] = -1.0
    own = abs(stiffness[storey - 1, storey - 2]) if storey > 1 else float(stiffness[0].sum())
    return replace(
        rig, building=replace(rig.building, stiffness=stiffness - share * own * np.outer(direction, direction))
    )


class AmbientStructure:
    """The bare frame of a rig.

    Parameters
    ----------
    rig
        The rig with the frame.
    """

    def __init__(self, rig: Rig) -> None:
        model, floors = rig.bare_frame().model, rig.floors
        forces = np.diag(1 / rig.building.masses)
        wanted = [i for i, name in enumerate(model.outputs) if name[0] == "a"]
        self.channels = tuple(model.outputs[i] for i in wanted)
        inputs = tuple(f"p{i + 1}" for i in range(floors))
        on_state = np.vstack([np.zeros((floors, floors)), forces])
        # in absolute acceleration the force acts at once
        continuous = LinearModel(model.a, on_state, model.c[wanted], forces, inputs, self.channels)
        self.model = discretize(continuous, 1 / RATE)
        self.poles = [pair for pair in pole_table(model.poles) if pair[1] < 1]

    def record(self, seconds: float, seed: int) -> NDArray[np.float64]:
        """(samples, floors) accelerations [m/s^2]."""
        random = np.random.default_rng(seed)
        forces = FORCE * random.standard_normal((round(seconds * RATE), len(self.channels)))
        response = simulate(self.model, forces)
        return response + NOISE * random.standard_normal(response.shape)
