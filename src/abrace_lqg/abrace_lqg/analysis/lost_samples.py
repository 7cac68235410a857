# SPDX-License-Identifier: Apache-2.0
"""The effect of lost samples on the loop while the run-time law bridges them.

Over a lost sample the command in force holds, and the estimate is advanced with the values measured last and the
command that holds (`abrace_lqg.control_law.ControlLaw.bridge`). A loop that loses samples periodically is stable if the
product of its transition matrices over one period has all eigenvalues inside the unit circle (Floquet). A single loss
makes the loop deviate from its course without losses, by an amount whose rms follows from the excitation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.linear_model import LinearModel, takes_models
from abrace_lqg.analysis.prediction import output_amplitudes
from abrace_lqg.loop import sampled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_lqg.analysis.prediction import Excitation

LONGEST_PERIOD = 50
"""Of the periodic losses that are checked [samples]."""

FOLLOWED = 500
"""Samples for which the deviation after a single loss is followed."""


@dataclass(frozen=True)
class LostSamples:
    """The effect of losing some samples in a row.

    Parameters
    ----------
    in_a_row
        Number of samples lost at a time.
    stable_every
        The loop is stable when this happens once in every so many samples, or more seldom (checked up to
        LONGEST_PERIOD); None: not even then.
    command_deviation
        Greatest rms over time of the change of a command after a single loss, over the rms of the command itself; of
        several commands the greatest.
    """

    in_a_row: int
    stable_every: int | None
    command_deviation: float

    def __str__(self) -> str:
        rhythm = f"stable when lost in every {self.stable_every}" if self.stable_every else "not stable when repeated"
        return f"{self.in_a_row} lost in a row: {rhythm}, once: command off by {self.command_deviation:.1%} of its rms"


@takes_models
def lost_samples(
    model: LinearModel,
    controller: LinearModel,
    correction: NDArray[np.float64],
    *,
    excitation: Excitation,
    in_a_row: int,
) -> LostSamples:
    """The effect on a stable loop of losing samples, periodically and once.

    Parameters
    ----------
    model, controller
        As in `abrace_lqg.loop.closed_loop`.
    correction
        (controller's states, commands): `ControllerDesign.correction`.
    excitation
        Of the ground.
    in_a_row
        Samples lost at a time.
    """
    answered, lost = _transitions(sampled(model, controller.sample_period), controller, correction)
    gap = np.linalg.matrix_power(lost.a, in_a_row)
    cycles = [gap @ answered.a]
    for _ in range(in_a_row + 1, LONGEST_PERIOD):
        cycles.append(cycles[-1] @ answered.a)
    stable_every = None
    for period, cycle in zip(range(LONGEST_PERIOD, in_a_row, -1), reversed(cycles), strict=True):
        if np.abs(np.linalg.eigvals(cycle)).max() >= 1:
            break
        stable_every = period
    omega, amplitudes = output_amplitudes(answered, excitation)
    states, advance = answered.order, np.exp(1j * omega * controller.sample_period)[:, None]
    change_a, change_b = lost.a - answered.a, lost.b - answered.b
    course, ground = amplitudes[:, :states], amplitudes[:, states:]
    deviation = np.zeros_like(course)
    for _ in range(in_a_row):
        deviation = deviation @ lost.a.T + course @ change_a.T + ground @ change_b.T
        course, ground = course * advance, ground * advance
    # a real factor of the deviation's covariance
    _, upper = np.linalg.qr(np.vstack([deviation.real, deviation.imag]))
    factor = upper.T
    first = states - len(controller.inputs) - controller.order - len(controller.outputs)
    force = slice(first, first + len(controller.outputs))
    largest, in_force = np.zeros(len(controller.outputs)), np.eye(states)[force]
    for _ in range(FOLLOWED):
        largest = np.maximum(largest, np.linalg.norm(in_force @ factor, axis=1))
        # the commands in force a sample later, as combinations of the first states
        in_force = in_force @ answered.a
    usual = np.sqrt(np.sum(np.abs(amplitudes[:, force]) ** 2, axis=0))
    return LostSamples(in_a_row, stable_every, float(np.max(largest / np.where(usual > 0, usual, np.inf))))


def _transitions(
    plant: LinearModel, controller: LinearModel, correction: NDArray[np.float64]
) -> tuple[LinearModel, LinearModel]:
    """The loop from one sample to the next, the sample being answered or lost, driven by the ground acceleration.

    States: the plant's, the commands in force, the controller's, the values measured last. Outputs: the states and the
    ground acceleration.
    """
    external = tuple(name for name in plant.inputs if name not in controller.outputs)
    driven, commanded = plant.select(inputs=external), plant.select(inputs=controller.outputs)
    y_driven, y_commanded = driven.select(controller.inputs).d, commanded.select(controller.inputs)
    n, m, states, p, w = plant.order, len(controller.outputs), controller.order, len(controller.inputs), len(external)
    size = n + m + states + p
    motion = np.hstack([plant.a, commanded.b, np.zeros((n, states + p))])
    measured = np.hstack([y_commanded.c, y_commanded.d, np.zeros((p, states + p))])
    in_force, estimate, last = np.split(np.eye(size)[n:], [m, m + states])
    transitions = []
    for answered in (True, False):
        y, y_w = (measured, y_driven) if answered else (last, np.zeros((p, w)))
        law, law_w = controller.d @ y + controller.c @ estimate, controller.d @ y_w
        command, command_w = (law, law_w) if answered else (in_force, np.zeros((m, w)))
        advanced = controller.a @ estimate + controller.b @ y + correction @ (command - law)
        advanced_w = controller.b @ y_w + correction @ (command_w - law_w)
        transitions.append(
            LinearModel(
                np.vstack([motion, command, advanced, y]),
                np.vstack([driven.b, command_w, advanced_w, y_w]),
                np.eye(size + w, size),
                np.eye(size + w, w, -size),
                external,
                tuple(f"state {i}" for i in range(size)) + external,
                plant.sample_period,
            )
        )
    return transitions[0], transitions[1]
