# SPDX-License-Identifier: Apache-2.0
"""A loop run sample by sample, with the converters that a benchmark prescribes.

The command computed from sample k acts from sample k+1 on, as in abrace's graph.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from abrace_core import AbraceError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.model.controller_file import Controller
    from abrace_core.model.linear_model import LinearModel


class Converter(NamedTuple):
    """A converter that rounds to so many bits of its whole span and clips at its range to either side.

    0 bits: values pass as they are.
    """

    range: float
    bits: int

    def convert(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """The `values` as converted."""
        if not self.bits:
            return values
        quantum = 2 * self.range / 2**self.bits
        return np.clip(np.round(values / quantum) * quantum, -self.range, self.range)


def run_loops(
    plant: LinearModel,
    controller: Controller,
    ground: NDArray[np.float64],
    sensors: Converter,
    devices: Converter,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Several runs side by side, from rest.

    Parameters
    ----------
    plant
        Discrete; its first input is the ground's acceleration, the others are the controller's commands.
    controller
        With the plant's sample period; it measures some of the plant's outputs.
    ground
        (samples, runs) [m/s^2].
    sensors, devices
        Converters of measured quantities and of commands.

    Returns
    -------
    states, inputs
        (runs, samples, states) of the plant, and (runs, samples, inputs): the ground's acceleration and the commands
        in force from each sample on.

    Raises
    ------
    AbraceError
        If plant and controller do not fit each other.
    """
    law = controller.law
    if law.outputs != plant.inputs[1:] or abs(law.sample_period / plant.sample_period - 1) > 1e-9:
        raise AbraceError(
            f"controller {controller.name}: gives {', '.join(law.outputs)} every {law.sample_period:g} s, "
            f"expected {', '.join(plant.inputs[1:])} every {plant.sample_period:g} s"
        )
    seen = plant.select(law.inputs)
    samples, runs = ground.shape
    commands = len(law.outputs)
    states = np.zeros((samples, plant.order, runs))
    inputs = np.zeros((samples, 1 + commands, runs))
    inputs[:, 0] = ground
    state, estimate = np.zeros((plant.order, runs)), np.zeros((law.order, runs))
    for k in range(samples):
        states[k] = state
        measured = sensors.convert(seen.c @ state + seen.d @ inputs[k])
        wanted = law.c @ estimate + law.d @ measured
        acted = devices.convert(wanted)
        estimate = law.a @ estimate + law.b @ measured + controller.correction @ (acted - wanted)
        state = plant.a @ state + plant.b @ inputs[k]
        if k + 1 < samples:
            inputs[k + 1, 1:] = acted
    return np.moveaxis(states, 2, 0), np.moveaxis(inputs, 2, 0)
