"""Exact stepping of linear models at a sample period: holds, delays, closed loops, saturation.

The command is held between samples (zero-order hold); the ground acceleration is taken to be linear between samples
(first-order hold), which needs no half-sample shift when a recorded motion is compared with its response.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy import linalg

from abrace_core.errors import AbraceError
from abrace_core.linear_model import LinearModel

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

Hold = Literal["zero", "first"]


def discretize(model: LinearModel, sample_period: float, holds: Mapping[str, Hold] | None = None) -> LinearModel:
    """The exact discrete equivalent of a continuous model, input delays included.

    Parameters
    ----------
    model
        Continuous model; delays need not be multiples of the sample period.
    sample_period
        Seconds.
    holds
        How each input moves between samples: "zero" (held, the default) or "first" (linear).

    Returns
    -------
    LinearModel
        Discrete model; a delayed input adds one state for each sample that its delay reaches back. It is driven by
        each input's value at sample k, held (or linear) from sample k to k+1.
    """
    if model.sample_period:
        raise AbraceError("discretize: a continuous model was expected")
    n, m, period = model.order, len(model.inputs), float(sample_period)
    holds = {name: (holds or {}).get(name, "zero") for name in model.inputs}

    def held(span: float, column: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray]:
        """exp(A span) and the responses at `span` to a unit step and to a unit ramp (of slope 1/span) in one input."""
        block = np.zeros((n + 2, n + 2))
        block[:n, :n] = model.a * span
        block[:n, n] = column * span
        block[n, n + 1] = 1.0
        block = linalg.expm(block)
        return block[:n, :n], block[:n, n], block[:n, n + 1]

    transition = linalg.expm(model.a * period)
    a, b = transition, np.zeros((n, m))
    c, d = model.c, model.d.copy()
    blocks: list[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]] = []
    for j, name in enumerate(model.inputs):
        delay = model.input_delay[j]
        if holds[name] == "first":
            if delay:
                raise AbraceError(f"discretize: input {name} has a delay, which a first-order hold cannot take")
            _, step, ramp = held(period, model.b[:, j])
            # x(k+1) = A x(k) + (step - ramp) u(k) + ramp u(k+1), with the state x(k) - ramp u(k)
            b[:, j] = step - ramp + transition @ ramp
            d[:, j] += model.c @ ramp
            continue
        whole, late = divmod(delay / period, 1.0)
        if late > 1 - 1e-9:
            whole, late = whole + 1, 0.0
        samples = int(whole)
        rest_transition, recent, _ = held((1 - late) * period, model.b[:, j])
        early = np.zeros(n) if late < 1e-9 else rest_transition @ held(late * period, model.b[:, j])[1]
        memory = samples + (1 if late >= 1e-9 else 0)
        if memory == 0:
            b[:, j] = recent
            continue
        # memory states hold u(k-1), u(k-2), ...; `recent` acts with u(k - samples), `early` with the one before
        into_state, into_output = np.zeros((n, memory)), np.zeros((len(c), memory))
        if samples:
            into_state[:, samples - 1] += recent
        else:
            b[:, j] = recent
        if late >= 1e-9:
            into_state[:, samples] += early
        # at the instant of sample k the delayed input is the one of `memory` samples before
        into_output[:, memory - 1] = model.d[:, j]
        d[:, j] = 0.0
        first = np.zeros((memory, m))
        first[0, j] = 1.0
        blocks.append((into_state, into_output, first))
    for into_state, into_output, first in blocks:
        memory = len(first)
        states = len(a)
        grown = np.zeros((states + memory, states + memory))
        grown[:states, :states] = a
        grown[:n, states:] = into_state
        grown[states + 1 :, states:-1] = np.eye(memory - 1)
        a, b, c = grown, np.vstack([b, first]), np.hstack([c, into_output])
    return LinearModel(a, b, c, d, model.inputs, model.outputs, period, provenance=model.provenance)


def simulate(
    model: LinearModel, inputs: NDArray[np.float64], initial: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Outputs (samples, outputs) of a discrete `model` driven by `inputs` (samples, inputs).

    It starts from rest, or from the state `initial` (states,).
    """
    if not model.sample_period:
        raise AbraceError("simulate: a discrete model was expected")
    if inputs.ndim != 2 or inputs.shape[1] != len(model.inputs):
        raise AbraceError(f"simulate: inputs of shape {inputs.shape}, expected (samples, {len(model.inputs)})")
    forcing = inputs @ model.b.T
    states = np.empty((len(inputs), model.order))
    state = np.zeros(model.order) if initial is None else np.asarray(initial, dtype=np.float64)
    a = model.a
    for k, force in enumerate(forcing):
        states[k] = state
        state = a @ state + force
    return states @ model.c.T + inputs @ model.d.T


def simulate_closed_loop(
    model: LinearModel,
    controller: LinearModel,
    ground_acceleration: NDArray[np.float64],
    capacity: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Run a controller (Eq. 13) on a discrete model, with the rig's timing and saturation.

    The command computed from sample k acts from sample k+1 on, as in the graph.

    Parameters
    ----------
    model
        Discrete model; its first input is the ground acceleration, the others are the controller's outputs.
    controller
        Discrete model from some of the outputs to the commands, at the same sample period.
    ground_acceleration
        (samples,) [m/s^2].
    capacity
        (commands,) [N]; commands are cut to +-capacity.

    Returns
    -------
    outputs, commands
        (samples, outputs), and (samples, commands): the command in force until each sample, as in a Response.
    """
    if model.inputs[1:] != controller.outputs or abs(model.sample_period - controller.sample_period) > 1e-12:
        raise AbraceError(
            f"closed loop: the controller gives {', '.join(controller.outputs)} every {controller.sample_period} s, "
            f"the model takes {', '.join(model.inputs[1:])} every {model.sample_period} s"
        )
    measured = [model.outputs.index(name) for name in controller.inputs]
    samples, commands = len(ground_acceleration), len(capacity)
    c_measured, d_measured = model.c[measured], model.d[measured]
    inputs = np.zeros((samples, 1 + commands))
    inputs[:, 0] = ground_acceleration
    states = np.empty((samples, model.order))
    state, q = np.zeros(model.order), np.zeros(controller.order)
    command = np.zeros(commands)
    for k in range(samples):
        states[k] = state
        drive = inputs[k]
        drive[1:] = command
        y = c_measured @ state + d_measured @ drive
        # Eq. (13): U(n) from q(n) and y(n), then q(n+1)
        command = np.clip(controller.c @ q + controller.d @ y, -capacity, capacity)
        q = controller.a @ q + controller.b @ y
        state = model.a @ state + model.b @ drive
    outputs = states @ model.c.T + inputs @ model.d.T
    in_force_until = np.vstack([np.zeros((1, commands)), inputs[:-1, 1:]])
    return outputs, in_force_until
