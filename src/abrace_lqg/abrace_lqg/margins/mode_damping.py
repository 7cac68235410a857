"""What control does to the damping of each mode of a structure, the ones that it was not designed with among them.

Each pole pair is followed from its place without control to its place in the loop while the controller's command grows
from nothing to the whole (a root locus), so that it is known which pole came from which.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import linear_sum_assignment

from abrace_lqg.loop import GONE, closed_loop, sampled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel

STEPS = 150
"""In which the command grows."""

SAME = 0.05
"""Relative difference of frequency within which a pair is one that the design model has too."""


@dataclass(frozen=True)
class ModeEffect:
    """One pole pair without control and with it.

    Parameters
    ----------
    frequency, damping
        [rad/s] and damping ratio without control.
    controlled_frequency, controlled_damping
        The same pair in the loop; a frequency of zero where it oscillates no more.
    modelled
        Whether the design model has it.
    """

    frequency: float
    damping: float
    controlled_frequency: float
    controlled_damping: float
    modelled: bool

    @property
    def kept(self) -> float:
        """Share of its damping that control leaves it; over 1 where control adds some."""
        return self.controlled_damping / self.damping


def mode_effects(model: LinearModel, controller: LinearModel, design_model: LinearModel) -> list[ModeEffect]:
    """What the controller does to each oscillating pole pair of a model, slowest first.

    Parameters
    ----------
    model, controller
        As in `abrace_lqg.loop.closed_loop`.
    design_model
        What the controller was designed with: tells modelled pairs from others.
    """
    period = controller.sample_period
    plant = sampled(model, period)
    loop = closed_loop(plant, controller).a
    commands = slice(plant.order, plant.order + len(controller.outputs))
    share = np.ones((len(loop), 1))
    share[commands] = 0.0
    start = followed = _poles(share * loop)
    for gain in np.linspace(0, 1, STEPS + 1)[1:] ** 2:
        share[commands] = gain
        now = _poles(share * loop)
        _, order = linear_sum_assignment(np.abs(followed[:, None] - now))
        followed = now[order]
    # without command the loop's poles are the plant's and the controller's: find the plant's among them
    own = _poles(plant.a)
    own = own[(own.imag > 1e-9) & (np.abs(own) > GONE)]
    _, places = linear_sum_assignment(np.abs(own[:, None] - start))
    known = np.abs(design_model.poles()[design_model.poles().imag > 0])
    effects = []
    for before, after in zip(np.log(own) / period, np.log(followed[places]) / period, strict=True):
        frequency = float(abs(before))
        effects.append(
            ModeEffect(
                frequency,
                float(-before.real / frequency),
                float(abs(after)) if after.imag else 0.0,
                float(-after.real / abs(after)),
                bool((np.abs(known / frequency - 1) < SAME).any()),
            )
        )
    return sorted(effects, key=lambda effect: effect.frequency)


def _poles(a: NDArray[np.float64]) -> NDArray[np.complex128]:
    return np.asarray(np.linalg.eigvals(a), dtype=np.complex128)
