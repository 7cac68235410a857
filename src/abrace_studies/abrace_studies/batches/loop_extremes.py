# SPDX-License-Identifier: Apache-2.0
"""Peak and rms of many closed loops of one model and one controller, without their time histories.

The samples are those of `simulation`, to rounding; only the greatest and the sum of squares are kept. Each loop is
computed in the same way, whichever others are computed with it: results do not depend on how loops are grouped.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_core.model.linear_model import LinearModel, takes_models
from abrace_core.model.si_units import in_si_units
from abrace_core.model.stepping import check_finite, connect, extremes

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray


@dataclass(frozen=True)
class Motions:
    """Ground motions of one sampling, in one array.

    Parameters
    ----------
    ground
        (motions, samples of the longest) [m/s^2], zero past the end of a shorter one.
    samples
        (motions,) of each.
    """

    ground: NDArray[np.float64]
    samples: NDArray[np.int64]

    @classmethod
    def of(cls, grounds: Iterable[NDArray[np.float64]]) -> Motions:
        """Of `grounds`, accelerations (samples,) [m/s^2] of any lengths; not finite or empty ones are refused."""
        grounds = list(grounds)
        samples = np.array([len(ground) for ground in grounds], dtype=np.int64)
        if not samples.min(initial=1):
            raise AbraceError("closed loops: a motion without samples, expected one or more")
        together = np.zeros((len(samples), samples.max(initial=0)))
        for row, ground in zip(together, grounds, strict=True):
            check_finite("closed loops: ground acceleration", ground)
            row[: len(ground)] = ground
        return cls(together, samples)


@dataclass(frozen=True)
class Extremes:
    """Peak and rms of the outputs and commands of several loops.

    Parameters
    ----------
    names
        Names of the model's outputs, then of its commands.
    peak, rms
        (loops, names), SI units; infinite where an unstable loop has no finite ones.
    saturated
        (loops,) samples at which a command was at its limit.
    """

    names: tuple[str, ...]
    peak: NDArray[np.float64]
    rms: NDArray[np.float64]
    saturated: NDArray[np.int64]


@takes_models
def loop_extremes(
    model: LinearModel,
    controller: LinearModel | None,
    motions: Motions,
    capacity: NDArray[np.float64] | None = None,
    correction: NDArray[np.float64] | None = None,
    *,
    chosen: NDArray[np.int64] | None = None,
    scale: NDArray[np.float64] | None = None,
) -> Extremes:
    """Peak and rms of what `simulate_closed_loop` gives, for several ground motions.

    Parameters
    ----------
    model
        Discrete; its first input is the ground acceleration, the others are the commands.
    controller
        Discrete, from some of the outputs to the commands, at the same sample period; None: the commands are zero.
    motions
        Ground motions.
    capacity
        (commands,) [N], to which commands are limited; None: they are not, and all is proportional to the motion.
    correction
        As in `simulate_closed_loop`.
    chosen
        (loops,) which motion each loop has; None: one loop for each motion.
    scale
        (loops,) factor of its motion; None: 1.

    Raises
    ------
    AbraceError
        If model, controller, capacity and records do not fit each other.
    """
    model = in_si_units(model)
    count, commands = len(model.outputs), len(model.inputs) - 1
    names = (*model.outputs, *model.inputs[1:])
    chosen = np.arange(len(motions.samples)) if chosen is None else np.asarray(chosen, dtype=np.int64)
    scale = np.ones(len(chosen)) if scale is None else np.asarray(scale, dtype=np.float64)
    limit = np.zeros(0) if controller is None or capacity is None else np.array(capacity, dtype=np.float64)
    if controller is None:
        whole = model.select(inputs=model.inputs[:1])
    else:
        whole = connect(model, controller, capacity, correction)
        if capacity is None:
            whole = _close(whole, commands)
    given = len(whole.outputs) - len(limit)
    uncounted = np.where(np.arange(given) < count, 0, 1)  # the last command acts on no sample
    peak, square, command_peak, command_square, limited = extremes(
        whole, motions.ground, motions.samples, chosen, scale, limit, uncounted
    )
    silent = np.zeros((len(chosen), count + commands - given - len(limit)))
    peak, square = np.hstack([peak, command_peak, silent]), np.hstack([square, command_square, silent])
    bounded = np.isfinite(square)
    rms = np.sqrt(np.where(bounded, square, np.inf) / motions.samples[chosen, None])
    return Extremes(names, np.where(bounded, peak, np.inf), rms, limited)


def _close(series: LinearModel, commands: int) -> LinearModel:
    """The series of model and controller, closed: from the ground to the outputs and the commands in force."""
    states, outputs = series.order, len(series.outputs) - commands
    a = np.block([[series.a, series.b[:, 1:]], [series.c[outputs:], series.d[outputs:, 1:]]])
    b = np.vstack([series.b[:, :1], series.d[outputs:, :1]])
    c = np.block([[series.c[:outputs], series.d[:outputs, 1:]], [np.eye(commands, states + commands, states)]])
    d = np.vstack([series.d[:outputs, :1], np.zeros((commands, 1))])
    return LinearModel(a, b, c, d, series.inputs[:1], series.outputs, series.sample_period)
