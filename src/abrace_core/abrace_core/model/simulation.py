# SPDX-License-Identifier: Apache-2.0
"""Discrete models run over whole records: free, or with a controller whose commands are limited."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_core.model.lifting import divisor, lifted
from abrace_core.model.linear_model import LinearModel, takes_models
from abrace_core.model.si_units import in_si_units
from abrace_core.model.stepping import check_finite, connect, histories

if TYPE_CHECKING:
    from numpy.typing import NDArray


@takes_models
def simulate(model: LinearModel, inputs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Outputs of a discrete model driven by given inputs, from rest.

    Parameters
    ----------
    model
        Discrete model, stable or not.
    inputs
        (samples, inputs), finite.

    Returns
    -------
    NDArray
        (samples, outputs).

    Raises
    ------
    AbraceError
        If the model is continuous, or the inputs do not fit it.
    """
    if not model.sample_period:
        raise AbraceError("simulate: expected a discrete model")
    inputs = np.asarray(inputs, dtype=np.float64)
    if inputs.ndim != 2 or inputs.shape[1] != len(model.inputs):
        raise AbraceError(f"simulate: inputs of shape {inputs.shape}, expected (samples, {len(model.inputs)})")
    check_finite("simulate: inputs", inputs)
    return histories(model, inputs, np.zeros(0))[0]


@takes_models
def simulate_closed_loop(
    model: LinearModel,
    controller: LinearModel,
    disturbance: NDArray[np.float64],
    capacity: NDArray[np.float64],
    correction: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Run a controller (Eq. 13) on a discrete model from rest, with the rig's timing and saturation.

    The command computed from sample k acts from sample k+1 on, as in the graph. A controller whose sample period is n
    of the model's answers samples 0, n, 2n, ...; its command is held in between.

    Parameters
    ----------
    model
        Discrete model; its first input disturbs (the ground acceleration of a rig), the others are the controller's
        outputs.
    controller
        Discrete model from some of the outputs to the commands; its sample period is the model's or a whole multiple.
    disturbance
        (samples,) of the model's first input [SI units], finite.
    capacity
        (commands,) [N]; commands are limited to +-capacity.
    correction
        (controller's states, commands): added to its next state for each newton that saturation takes from a command,
        so that its estimate follows the limited command (`Controller.correction`); None: Eq. (13) as printed, which
        winds up.

    Returns
    -------
    outputs, commands
        (samples, outputs), and (samples, commands): the command in force until each sample, as in a Response.

    Raises
    ------
    AbraceError
        If model, controller, motion and capacity do not fit each other.
    """
    driving = np.asarray(disturbance, dtype=np.float64)
    if driving.ndim != 1:
        raise AbraceError(f"closed loop: {model.inputs[0]} of shape {driving.shape}, expected (samples,)")
    check_finite(f"closed loop: {model.inputs[0]}", driving)
    fits = bool(model.sample_period) and model.inputs[1:] == controller.outputs
    held = divisor(controller.sample_period, model.sample_period) if fits else 1
    model, samples = lifted(in_si_units(model), len(controller.outputs), held), len(driving)
    series = connect(model, controller, capacity, correction, held)
    limit = np.array(capacity, dtype=np.float64)
    # sample 0 is the last one of its step
    padded = np.concatenate([np.zeros(held - 1), driving, np.zeros(-(samples - 1) % held)])
    outputs, in_force = histories(series, padded.reshape(-1, held), limit)
    outputs = outputs.reshape(len(padded), outputs.shape[1] // held)[held - 1 :][:samples]
    in_force = np.repeat(in_force, held, axis=0)[held - 1 :][:samples]
    return outputs, np.vstack([np.zeros((1, len(limit))), in_force[:-1]])[:samples]
