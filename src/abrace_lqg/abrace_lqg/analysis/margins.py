# SPDX-License-Identifier: Apache-2.0
"""Gain, phase and delay margin and sensitivity peak of a loop broken at one signal, the others closed.

The signal is a command at the plant's input or a measured quantity. The margin for changes of all signals at once is
`disk_margin`'s.

python-control's `stability_margins` of `open_loop` gives the same within 0.02 dB and 0.1 degrees, from a grid of one
signal at a time; here one response serves all signals, and crossings are its roots.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
import pydantic

from abrace_core import AbraceError
from abrace_core.files.config_file import Number  # noqa: TC001  pydantic reads it
from abrace_core.model.linear_model import takes_models
from abrace_core.model.verdict import nan_first, nan_last
from abrace_lqg.loop import Loop, at_rate, closed_loop, eigenvalues

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from abrace_core.model.linear_model import LinearModel

REAL_PHASE = 1e-2
"""Radians within which L counts as real at the ends of the frequency grid, where it reaches the real axis without
crossing it."""

MOST_STEPS = 40
"""Most steps of the search for a crossing, which seldom needs ten."""

TOLERANCE = 1e-12
"""Relative change of a crossing's frequency at which the search ends."""

LARGEST_GAIN, GAIN_STEP, GAIN_TOLERANCE = 20.0, 1.0, 1e-3
"""`common_gain_margin` looks up to this gain, in these steps, as finely as this [dB]."""


@dataclass(frozen=True)
class Margins:
    """Stability margins of a loop broken at one signal; in files by pydantic, with `delay_s`.

    Parameters
    ----------
    gain_db
        Least change of gain, up or down, that makes the loop unstable [dB]; infinite if none does.
    phase_deg
        Least change of phase, either way, that does [degrees].
    delay
        Least additional delay that does [s].
    sensitivity_peak
        Greatest |1 / (1 + L)|: one over the Nyquist curve's distance from -1.
    """

    gain_db: Number
    phase_deg: Number
    delay: Annotated[Number, pydantic.Field(alias="delay_s")]
    sensitivity_peak: Number

    def __str__(self) -> str:
        return (
            f"gain margin {self.gain_db:.1f} dB, phase margin {self.phase_deg:.1f} deg, "
            f"delay margin {1e3 * self.delay:.1f} ms, sensitivity peak {self.sensitivity_peak:.2f}"
        )

    @staticmethod
    def least(several: Sequence[Margins]) -> Margins:
        """The least of each margin of `several` loops, and the greatest sensitivity peak; NaN if one is."""
        return Margins(
            min((one.gain_db for one in several), key=nan_first),
            min((one.phase_deg for one in several), key=nan_first),
            min((one.delay for one in several), key=nan_first),
            max((one.sensitivity_peak for one in several), key=nan_last),
        )


@takes_models
def margins(model: LinearModel, controller: LinearModel) -> Margins:
    """The margins of a stable loop at the plant's input.

    Parameters
    ----------
    model, controller
        As in `abrace_lqg.loop.closed_loop`. With several commands the loop is broken at each in turn, the others
        closed, and the least of each margin is returned.

    Raises
    ------
    AbraceError
        If the loop is not stable.
    """
    return Margins.least(list(margins_at(model, controller, controller.outputs).values()))


@takes_models
def margins_at(
    model: LinearModel, controller: LinearModel, broken_at: Sequence[str] | None = None
) -> dict[str, Margins]:
    """The margins of a stable loop broken at each signal in turn, the others closed.

    Parameters
    ----------
    model, controller
        As in `abrace_lqg.loop.closed_loop`.
    broken_at
        Commands and measured quantities; None: all of them.

    Raises
    ------
    AbraceError
        If the loop is not stable, or has no such signal.
    """
    loop = Loop(model, controller)
    if not loop.is_stable:
        raise AbraceError("margins: the closed loop is not stable")
    omega = loop.frequencies()
    complementary = loop.complementary_sensitivity(omega)
    names = loop.signals if broken_at is None else broken_at
    return {name: _margins_of(loop, name, omega, complementary[:, loop.index(name)]) for name in names}


@takes_models
def common_gain_margin(model: LinearModel, controller: LinearModel) -> float:
    """Least change of the gain of all commands at once, up or down, that makes a stable loop unstable [dB].

    Infinite where none up to LARGEST_GAIN does. Devices that all push more than the model says, or a structure that is
    lighter, are such a change.

    Parameters
    ----------
    model, controller
        As in `abrace_lqg.loop.closed_loop`.

    Raises
    ------
    AbraceError
        If the loop is not stable.
    """
    plant = at_rate(model, controller)
    whole = closed_loop(plant, controller).a
    in_force = slice(plant.order + controller.order, None)

    def stable(decibels: float) -> bool:
        changed = whole.copy()
        changed[:, in_force] *= 10 ** (decibels / 20)
        return bool(np.abs(eigenvalues(changed)).max() < 1)

    if not stable(0.0):
        raise AbraceError("margins: the closed loop is not stable")
    found = np.inf
    for direction in (1, -1):
        gains = np.arange(GAIN_STEP, min(LARGEST_GAIN, found) + GAIN_STEP, GAIN_STEP)
        unstable = next((gain for gain in gains if not stable(direction * gain)), None)
        if unstable is None:
            continue
        low, high = unstable - GAIN_STEP, unstable
        while high - low > GAIN_TOLERANCE:
            middle = (low + high) / 2
            low, high = (middle, high) if stable(direction * middle) else (low, middle)
        found = min(found, high)
    return float(found)


def _margins_of(loop: Loop, signal: str, omega: NDArray[np.float64], complementary: NDArray[np.complex128]) -> Margins:
    """The margins at one signal, from T (frequencies,) at `omega`, a grid that brackets the crossings."""
    response = complementary / (1 - complementary)

    def crossings(measure: Callable[[NDArray[np.complex128]], NDArray[np.float64]]) -> NDArray[np.float64]:
        """Frequencies where a measure of L goes through zero."""
        values = measure(response)
        changes = np.flatnonzero(np.sign(values[:-1]) != np.sign(values[1:]))
        ends = omega[changes], omega[changes + 1], values[changes], values[changes + 1]
        return _roots(lambda between: measure(loop.transfer_function(signal, between)), *ends)

    at_phase = np.append(loop.transfer_function(signal, crossings(np.imag)), response[[0, -1]])
    at_phase = at_phase[(at_phase != 0) & (np.abs(np.angle(-at_phase)) < REAL_PHASE)]
    gains = np.abs(20 * np.log10(np.abs(at_phase)))
    at_gain = crossings(lambda values: np.abs(values) - 1)
    angles = np.mod(np.angle(-loop.transfer_function(signal, at_gain)), 2 * np.pi)
    return Margins(
        gain_db=float(gains.min(initial=np.inf)),
        phase_deg=float(np.degrees(np.minimum(angles, 2 * np.pi - angles)).min(initial=180.0)),
        delay=float((angles / at_gain).min(initial=np.inf)),
        sensitivity_peak=float(np.abs(1 - complementary).max()),
    )


def _roots(
    function: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    at_low: NDArray[np.float64],
    at_high: NDArray[np.float64],
) -> NDArray[np.float64]:
    """A root in each interval, whose ends' values have opposite signs, by false position (Illinois) for all at once."""
    low, high, at_low, at_high = low.copy(), high.copy(), at_low.copy(), at_high.copy()
    best = low
    for _ in range(MOST_STEPS if len(low) else 0):
        drop = at_high - at_low
        last, best = best, np.where(drop == 0, low, high - at_high * (high - low) / np.where(drop == 0, 1, drop))
        if np.all(np.abs(best - last) <= TOLERANCE * best):
            break
        value = function(best)
        # the new point replaces `high`; where both have the same sign `low` stays and its value is halved
        same = np.sign(value) == np.sign(at_high)
        low, at_low = np.where(same, low, high), np.where(same, at_low / 2, at_high)
        high, at_high = best, value
    return best
