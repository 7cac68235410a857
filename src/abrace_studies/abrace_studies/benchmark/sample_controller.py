# SPDX-License-Identifier: Apache-2.0
"""The sample controller of the structural-control benchmarks, an LQG with acceleration feedback.

Its authors meant it as an illustration: it minimises the mean of 3e9 times the squares of all levels' accelerations and
1/16 of the squares of the devices' commands; the ground's acceleration drives the states and feeds through to the
sensors, 25 times as intense as their noise; the compensator is sampled with a zero-order hold. The benchmark's own
design model is not public. Ours is the building's balanced model, of as many states, and its estimator takes
the commands' feedthrough to the sensors into account as the Kalman filter does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace_core.model.controller_file import Controller
from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import LinearModel
from abrace_lqg.riccati import kalman, regulator

if TYPE_CHECKING:
    from collections.abc import Sequence

ACCELERATION_WEIGHT, FORCE_WEIGHT = 3.0e9, 0.0625
"""[s^4/m^2], [1/N^2]."""
GROUND_INTENSITY = 25.0
"""Over that of each sensor's noise."""
DESIGNED_FRAMES = 1
"""The benchmark's controller is designed as if one frame took all forces: twice the authority that it has."""


def sample_controller(
    model: LinearModel, measured: Sequence[str], sample_period: float, capacity: float, frames: int
) -> Controller:
    """The sample controller.

    Parameters
    ----------
    model
        The design model, continuous, from ground and commands to accelerations `a1` ... of all levels.
    measured
        Accelerations that it is given.
    sample_period
        [s].
    capacity
        Capacity of one device [N].
    frames
        Among which the building shares the devices' forces.

    Raises
    ------
    AbraceError
        If a Riccati equation has no solution.
    """
    share = frames / DESIGNED_FRAMES
    b, e = share * model.b[:, 1:], np.sqrt(GROUND_INTENSITY) * model.b[:, :1]
    weighed = model.select([name for name in model.outputs if name[0] == "a"])
    commands = len(model.inputs) - 1
    q, r = ACCELERATION_WEIGHT * np.eye(len(weighed.outputs)), FORCE_WEIGHT * np.eye(commands)
    gain = regulator(model.a, b, weighed.c, share * weighed.d[:, 1:], q, r)
    seen = model.select(measured)
    through, of_ground = share * seen.d[:, 1:], np.sqrt(GROUND_INTENSITY) * seen.d[:, :1]
    injection = kalman(model.a, e, seen.c, of_ground, np.eye(len(measured)))
    a = model.a - b @ gain - injection @ (seen.c - through @ gain)
    none = np.zeros((commands, len(measured)))
    held = discretize(LinearModel(a, injection, -gain, none, tuple(measured), model.inputs[1:]), sample_period, {})
    # held answers y(k) with its next state: the command that acts from sample k+1 on
    law = LinearModel(held.a, held.b, held.c @ held.a, held.c @ held.b, held.inputs, held.outputs, sample_period)
    return Controller(
        name="sample",
        law=law,
        correction=np.zeros((law.order, commands)),
        prediction=np.zeros((len(measured), law.order + commands)),
        force_limit=np.full(commands, capacity),
        model=f"balanced, {model.order} states",
        weights="the benchmark's sample controller",
        margins="",
    )
