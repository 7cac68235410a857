# SPDX-License-Identifier: Apache-2.0
"""The damping of each mode of a structure without and with control, unmodelled modes included.

Each pole pair is followed along the root locus: from the uncontrolled plant to the closed loop, while a gain on the
commands grows from zero to one. So each closed-loop pole is assigned to the mode that it came from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
import pydantic
from scipy.optimize import linear_sum_assignment

from abrace_core.files.config_file import Number  # noqa: TC001  pydantic reads it
from abrace_core.model.lifting import divisor
from abrace_core.model.linear_model import takes_models
from abrace_core.model.modes import nearest_mode
from abrace_lqg.loop import NEGLIGIBLE_POLE, at_rate, closed_loop, eigenvalues

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from abrace_core.model.linear_model import LinearModel

LEAST_STEP, LONGEST_STEP = 1 / 150, 1 / 8
"""Steps of the square root of the gain on the commands, which goes from zero to one."""

CLEAR = 0.2
"""A pole that moves in a step by a smaller share of the distance to the next pole is not taken for that one."""

SAME_POLE = 1e-5
"""Distance in the z plane of poles of the same mode, which some models have once for each input."""


@dataclass(frozen=True)
class ModeEffect:
    """One pole pair of the plant, without and with control; in files by pydantic.

    Parameters
    ----------
    frequency, damping
        [rad/s] and damping ratio without control.
    controlled_frequency, controlled_damping
        The same pair in the closed loop; a frequency of zero where it is real.
    modelled
        Whether the design model has a pole pair of this frequency.
    """

    frequency: Annotated[float, pydantic.Field(alias="frequency_rad_s")]
    damping: Annotated[float, pydantic.Field(alias="damping_ratio")]
    controlled_frequency: Annotated[float, pydantic.Field(alias="controlled_frequency_rad_s")]
    controlled_damping: Annotated[Number, pydantic.Field(alias="controlled_damping_ratio")]
    modelled: bool

    @pydantic.computed_field  # type: ignore[prop-decorator]
    @property
    def damping_kept(self) -> Number:
        """Damping ratio with control over that without; above 1 where control adds damping.

        Infinite, of the sign of the difference, where there was none.
        """
        if self.damping > 0:
            return self.controlled_damping / self.damping
        return float(np.copysign(np.inf, self.controlled_damping - self.damping))


@takes_models
def mode_effects(model: LinearModel, controller: LinearModel, design_model: LinearModel) -> list[ModeEffect]:
    """Frequency and damping of each oscillating pole pair of a model without and with control, slowest first.

    Parameters
    ----------
    model, controller
        As in `abrace_lqg.loop.closed_loop`.
    design_model
        The model that the controller was designed with; pole pairs that it lacks are unmodelled.
    """
    period = controller.sample_period
    plant = at_rate(model, controller)
    loop = closed_loop(plant, controller).a
    commands = slice(plant.order + controller.order, None)
    gain = np.ones((len(loop), 1))
    gain[commands] = 0.0
    start = eigenvalues(gain * loop)
    # with zero gain the loop's poles are the plant's and the controller's: find the plant's among them
    own = eigenvalues(plant.a)
    own = own[(own.imag > 1e-9) & (np.abs(own) > NEGLIGIBLE_POLE)]
    seen = own ** divisor(period, plant.sample_period)
    _, indices = linear_sum_assignment(np.abs(seen[:, None] - start))

    def poles_at(share: float) -> NDArray[np.complex128]:
        gain[commands] = share**2
        return eigenvalues(gain * loop)

    followed = _followed(poles_at, start, indices)
    known = np.abs(design_model.poles[design_model.poles.imag > 0])
    effects = []
    uncontrolled = np.log(own) / plant.sample_period
    # seen by a slower controller a fast mode is at another frequency
    folded = np.log(seen) / period - uncontrolled
    for before, after in zip(uncontrolled, np.log(followed) / period - folded, strict=True):
        frequency = float(abs(before))
        effects.append(
            ModeEffect(
                frequency,
                float(-before.real / frequency),
                float(abs(after)) if after.imag else 0.0,
                float(-after.real / abs(after)),
                nearest_mode(known, frequency) is not None,
            )
        )
    return sorted(effects, key=lambda effect: effect.frequency)


def _followed(
    poles_at: Callable[[float], NDArray[np.complex128]], start: NDArray[np.complex128], indices: NDArray[np.int64]
) -> NDArray[np.complex128]:
    """Where the poles with these `indices` in `start` are at the end, followed from `poles_at(0)` to `poles_at(1)`.

    A step is halved, down to the least, if such a pole moves so far that it may be taken for another one that began
    elsewhere.
    """
    followed, share, step = start, 0.0, LONGEST_STEP
    together = np.abs(start[indices, None] - start) < SAME_POLE
    while share < 1:
        step = min(step, 1 - share)
        poles = poles_at(share + step)
        _, order = linear_sum_assignment(np.abs(followed[:, None] - poles))
        poles = poles[order]
        moved = np.abs(poles - followed)[indices]
        others = np.abs(poles[indices, None] - poles)
        others[together] = np.inf
        if step > LEAST_STEP and (moved > CLEAR * others.min(axis=1)).any():
            step = max(step / 2, LEAST_STEP)
            continue
        followed, share, step = poles, share + step, min(2 * step, LONGEST_STEP)
    return followed[indices]
