"""What lost samples do to the loop, when the run-time law bridges them.

Over a lost sample the command in force holds, and the estimate goes on with the values measured last and the command
that holds (`abrace_lqg.controller.ControlLaw.bridge`). A loop that loses samples in a fixed rhythm is periodic: stable
if the product of its steps over one period has all eigenvalues inside the unit circle (Floquet). A single loss moves
the loop off its course; how far is a matter of chance, with an rms that follows from the excitation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.linear_model import LinearModel
from abrace_lqg.loop import sampled
from abrace_lqg.margins.prediction import excited

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_lqg.margins.prediction import Excitation

SPARSEST = 50
"""Longest period, in samples, of the rhythms of losses."""

FOLLOWED = 500
"""Samples over which a single loss is followed."""


@dataclass(frozen=True)
class LostSamples:
    """What it does to lose some samples in a row.

    Parameters
    ----------
    in_a_row
        How many.
    stable_every
        The loop is stable when this happens once in every so many samples, or more seldom (looked at up to SPARSEST);
        None: not even then.
    command_deviation
        Rms of what a single loss changes in the command where it changes most, over the command's own rms; the largest
        of several commands.
    """

    in_a_row: int
    stable_every: int | None
    command_deviation: float

    def __str__(self) -> str:
        rhythm = f"stable when lost in every {self.stable_every}" if self.stable_every else "not stable when repeated"
        return f"{self.in_a_row} lost in a row: {rhythm}, once: command off by {self.command_deviation:.1%} of its rms"


def lost_samples(
    model: LinearModel,
    controller: LinearModel,
    correction: NDArray[np.float64],
    excitation: Excitation,
    in_a_row: int,
) -> LostSamples:
    """What it does to a stable loop to lose samples, in a rhythm and once.

    Parameters
    ----------
    model, controller
        As in `abrace_lqg.loop.closed_loop`.
    correction
        (controller's states, commands): `ControllerDesign.correction`.
    excitation
        How the ground shakes.
    in_a_row
        Samples lost at a time.
    """
    answered, lost = _steps(sampled(model, controller.sample_period), controller, correction)
    gap = np.linalg.matrix_power(lost.a, in_a_row)
    stable_every = None
    for period in range(SPARSEST, in_a_row, -1):
        cycle = gap @ np.linalg.matrix_power(answered.a, period - in_a_row)
        if np.abs(np.linalg.eigvals(cycle)).max() >= 1:
            break
        stable_every = period
    omega, amplitudes = excited(answered, excitation)
    states, advance = answered.order, np.exp(1j * omega * controller.sample_period)[:, None]
    change_a, change_b = lost.a - answered.a, lost.b - answered.b
    course, ground = amplitudes[:, :states], amplitudes[:, states:]
    deviation = np.zeros_like(course)
    for _ in range(in_a_row):
        deviation = deviation @ lost.a.T + course @ change_a.T + ground @ change_b.T
        course, ground = course * advance, ground * advance
    # a real factor of the deviation's covariance, to be carried on step by step
    _, upper = np.linalg.qr(np.vstack([deviation.real, deviation.imag]))
    factor = upper.T
    first = states - len(controller.inputs) - controller.order - len(controller.outputs)
    force = slice(first, first + len(controller.outputs))
    largest = np.zeros(len(controller.outputs))
    for _ in range(FOLLOWED):
        largest = np.maximum(largest, np.sqrt(np.sum(factor[force] ** 2, axis=1)))
        factor = answered.a @ factor
    usual = np.sqrt(np.sum(np.abs(amplitudes[:, force]) ** 2, axis=0))
    return LostSamples(in_a_row, stable_every, float(np.max(largest / np.where(usual > 0, usual, np.inf))))


def _steps(
    plant: LinearModel, controller: LinearModel, correction: NDArray[np.float64]
) -> tuple[LinearModel, LinearModel]:
    """From one sample to the next, the sample being answered or lost, driven by the ground acceleration.

    States: the plant's, the commands in force, the controller's, the values measured last. Outputs: the states and the
    ground acceleration.
    """
    outside = tuple(name for name in plant.inputs if name not in controller.outputs)
    driven, commanded = plant.select(inputs=outside), plant.select(inputs=controller.outputs)
    c = commanded.select(controller.inputs)
    f = driven.select(controller.inputs).d
    n, m, states, p = plant.order, len(controller.outputs), controller.order, len(controller.inputs)
    size = n + m + states + p
    moves = np.hstack([plant.a, commanded.b, np.zeros((n, states + p))])
    measures = np.hstack([c.c, c.d, np.zeros((p, states + p))])
    holds, estimate, last = np.split(np.eye(size)[n:], [m, m + states])
    steps = []
    for answered in (True, False):
        y, y_driven = (measures, f) if answered else (last, np.zeros_like(f))
        law, law_driven = controller.d @ y + controller.c @ estimate, controller.d @ y_driven
        command, command_driven = (law, law_driven) if answered else (holds, np.zeros_like(law_driven))
        goes_on = controller.a @ estimate + controller.b @ y + correction @ (command - law)
        goes_on_driven = controller.b @ y_driven + correction @ (command_driven - law_driven)
        steps.append(
            LinearModel(
                np.vstack([moves, command, goes_on, y]),
                np.vstack([driven.b, command_driven, goes_on_driven, y_driven]),
                np.vstack([np.eye(size), np.zeros((len(outside), size))]),
                np.vstack([np.zeros((size, len(outside))), np.eye(len(outside))]),
                outside,
                tuple(f"state {i}" for i in range(size)) + outside,
                plant.sample_period,
            )
        )
    return steps[0], steps[1]
