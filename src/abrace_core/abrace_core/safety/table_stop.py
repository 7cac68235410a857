# SPDX-License-Identifier: Apache-2.0
"""A shake table's limits, its velocity and displacement sample by sample, and the stop that brings it to rest.

The table's acceleration is linear between samples, as in the simulated rig: over a sample period T in which it changes
from a to b, the velocity v changes by T (a + b) / 2 and the displacement by T v + T^2 (2 a + b) / 6.

A stop is a half cosine from the initial acceleration to zero, plus a raised cosine that brings the velocity to zero;
the final velocity is exactly zero for any number of samples. A stop lasts 0.5 s unless a limit of the table requires
another duration: longer at high velocity (at most 3.06 s), shorter near the end of the stroke. If no such stop keeps
within all limits, the stop of least time is used: at the greatest jerk J to the greatest deceleration A, hold, and back
to zero. It takes at most |v| / A + 2 (|a| + A) / J.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.safety.rig_safety import RAMP_TIME

if TYPE_CHECKING:
    from numpy.typing import NDArray

LONGEST = 3.06
"""Greatest duration of a stop [s], unless even the stop of least time takes longer."""
MARGIN = 0.99
"""Share of the table's limits that a stop uses; a stop of least time uses all."""

_POWERS = sorted(range(-34, 20), key=abs)
_TIMES = RAMP_TIME * 1.1 ** np.array(_POWERS, dtype=np.float64)
"""(times,) from 0.02 to 3.06 s, tried in this order: the nearest to RAMP_TIME first [s]."""
_SHARE = np.linspace(0, 1, 65)
_RISE, _BUMP = (1 + np.cos(np.pi * _SHARE)) / 2, (1 - np.cos(2 * np.pi * _SHARE)) / 2
"""Half cosine and raised cosine over a stop; the integral of each is 1/2."""
_SLOPES = -np.pi / 2 * np.sin(np.pi * _SHARE), np.pi * np.sin(2 * np.pi * _SHARE)
_INTEGRALS = (
    _SHARE / 2 + np.sin(np.pi * _SHARE) / (2 * np.pi),
    _SHARE / 2 - np.sin(2 * np.pi * _SHARE) / (4 * np.pi),
)
_SECOND_INTEGRALS = (
    _SHARE**2 / 4 + (1 - np.cos(np.pi * _SHARE)) / (2 * np.pi**2),
    _SHARE**2 / 4 - (1 - np.cos(2 * np.pi * _SHARE)) / (8 * np.pi**2),
)


@dataclass(frozen=True)
class Table:
    """Limits of the shake table.

    Parameters
    ----------
    peak_acceleration
        [m/s^2].
    peak_jerk
        Greatest rate of the acceleration [m/s^3].
    peak_velocity
        [m/s].
    peak_displacement
        Stroke to each side of the middle [m].
    """

    peak_acceleration: float
    peak_jerk: float
    peak_velocity: float
    peak_displacement: float


class TableState:
    """Acceleration, velocity and displacement of a table, integrated from its commanded accelerations.

    Parameters
    ----------
    period
        Sample period [s].
    displacement
        Initial displacement, at rest [m].

    Attributes
    ----------
    acceleration, velocity, displacement
        Values at the last sample [m/s^2, m/s, m].
    """

    __slots__ = ("_period", "acceleration", "displacement", "velocity")

    def __init__(self, period: float, displacement: float = 0.0) -> None:
        self._period = period
        self.acceleration = 0.0
        self.velocity = 0.0
        self.displacement = displacement

    def update(self, acceleration: float) -> None:
        """Advance to the next sample, at which the table has this `acceleration` [m/s^2]."""
        period, last = self._period, self.acceleration
        self.displacement += period * (self.velocity + period / 6 * (2 * last + acceleration))
        self.velocity += period / 2 * (last + acceleration)
        self.acceleration = acceleration

    def hold(self, samples: int) -> None:
        """Advance by this number of `samples`, with the present acceleration."""
        time = samples * self._period
        self.displacement += time * (self.velocity + time / 2 * self.acceleration)
        self.velocity += time * self.acceleration


def turning_point(acceleration: float, velocity: float, displacement: float, limits: Table) -> float:
    """Displacement at which a table comes to a standstill if it decelerates as fast as its `limits` allow [m].

    `acceleration` [m/s^2], `velocity` [m/s] and `displacement` [m] are those at the last sample. A motion within the
    limits of acceleration and jerk never turns before it.
    """
    sign = math.copysign(1.0, velocity)
    now, left, most, jerk = sign * acceleration, abs(velocity), limits.peak_acceleration, limits.peak_jerk
    # the deceleration at the standstill, if the greatest one is not reached before
    peak = math.sqrt(now**2 + 2 * jerk * left)
    ramp = (now + min(peak, most)) / jerk
    way = ramp * (left + ramp * (now / 2 - ramp * jerk / 6))
    if peak > most:
        way += (left + ramp * (now - ramp * jerk / 2)) ** 2 / (2 * most)
    return displacement + sign * way


class TableStop:
    """The accelerations that bring a table to rest, one for each sample.

    Parameters
    ----------
    acceleration, velocity, displacement
        State of the table at the last sample [m/s^2, m/s, m].
    limits
        Limits of the table. A stop that begins within the limits of acceleration and jerk never exceeds them.
    period
        Sample period [s].

    Attributes
    ----------
    within_stroke
        Whether the table stays within its stroke; if not, no stop within its limits does.
    displacement
        Final displacement of the table [m].
    profile
        The accelerations, in order [m/s^2]; the last one is zero. Empty if the table is already at rest.
    """

    def __init__(self, acceleration: float, velocity: float, displacement: float, limits: Table, period: float) -> None:
        profile = np.zeros(0)
        if acceleration or velocity:
            samples = _gentle(acceleration, velocity, displacement, limits, period)
            if samples:
                profile = _blend(acceleration, velocity, samples, period)
            # a stop that begins at the greatest acceleration may exceed it slightly, between the samples that `_gentle`
            # checks
            if not samples or np.abs(profile).max() > max(limits.peak_acceleration, abs(acceleration)):
                profile = _least_time(acceleration, velocity, limits, period)
        self.profile: list[float] = profile.tolist()
        begin, end = np.concatenate([[acceleration], profile[:-1]])[: len(profile)], profile
        velocities = velocity + np.cumsum(period / 2 * (begin + end))
        before = np.concatenate([[velocity], velocities[:-1]])[: len(profile)]
        path = displacement + np.cumsum(period * before + period**2 / 6 * (2 * begin + end))
        self.displacement = float(path[-1]) if len(path) else displacement
        self.within_stroke = bool(np.abs(path).max(initial=abs(displacement)) <= limits.peak_displacement)
        self._next = 0

    @property
    def done(self) -> bool:
        """Whether the table is at rest."""
        return self._next >= len(self.profile)

    def next(self) -> float:
        """The acceleration of the next sample [m/s^2]; zero when the table is at rest."""
        if self.done:
            return 0.0
        self._next += 1
        return self.profile[self._next - 1]


def _gentle(acceleration: float, velocity: float, displacement: float, limits: Table, period: float) -> int:
    """Number of samples of the smooth stop within the limits that is nearest to 0.5 s; 0: there is none."""
    times = period * np.maximum(np.round(_TIMES / period), 2)[:, None]
    bump = -(2 * velocity / times + acceleration)
    accelerations = acceleration * _RISE + bump * _BUMP
    jerks = (acceleration * _SLOPES[0] + bump * _SLOPES[1]) / times
    velocities = velocity + times * (acceleration * _INTEGRALS[0] + bump * _INTEGRALS[1])
    displacements = (
        displacement
        + times * velocity * _SHARE
        + times**2 * (acceleration * _SECOND_INTEGRALS[0] + bump * _SECOND_INTEGRALS[1])
    )
    unavoidable = abs(velocity) + acceleration**2 / limits.peak_jerk
    fits = np.ones(len(times), dtype=np.bool_)
    for values, limit, now in (
        (accelerations, limits.peak_acceleration, abs(acceleration)),
        (jerks, limits.peak_jerk, 0.0),
        (velocities, limits.peak_velocity, unavoidable),
        (displacements, limits.peak_displacement, abs(displacement)),
    ):
        fits &= np.abs(values).max(axis=1) <= max(MARGIN * limit, now)
    return round(float(times[int(np.argmax(fits)), 0]) / period) if fits.any() else 0


def _blend(acceleration: float, velocity: float, samples: int, period: float) -> NDArray[np.float64]:
    """The smooth stop with this number of samples."""
    share = np.arange(1, samples + 1) / samples
    bump = -(2 * velocity / (samples * period) + acceleration)
    profile = acceleration * (1 + np.cos(np.pi * share)) / 2 + bump * (1 - np.cos(2 * np.pi * share)) / 2
    profile[-1] = 0.0
    return np.asarray(profile, dtype=np.float64)


def _least_time(acceleration: float, velocity: float, limits: Table, period: float) -> NDArray[np.float64]:
    """The stop of least time: a ramp to the greatest deceleration that is needed, a hold, and a ramp to zero.

    The corners of the ideal profile lie between samples. Each part is rounded up to whole samples, and the deceleration
    is chosen so that the final velocity is exactly zero.
    """
    most, jerk = limits.peak_acceleration, limits.peak_jerk
    # the sign of the velocity that would remain if the acceleration were ramped to zero at once
    sign = math.copysign(1.0, velocity + acceleration * abs(acceleration) / (2 * jerk))
    now, left = sign * acceleration, sign * velocity
    peak = min(most, math.sqrt(max(jerk * left + now**2 / 2, 0.0)))
    held = max(0.0, (left + now**2 / (2 * jerk) - peak**2 / jerk) / peak) if peak else 0.0
    step = jerk * period
    down, hold, up = math.ceil(abs(now + peak) / step) or 1, math.ceil(held / period), math.ceil(peak / step) or 1

    def deceleration() -> float:
        return (left / period + down * now / 2) / (down / 2 + hold + up / 2)

    while abs(now + (peak := deceleration())) > down * step:
        down += 1
    while abs(peak) > most or abs(peak) > up * step or abs(now + peak) > down * step:
        up, hold = (up + 1, hold) if abs(peak) > up * step else (up, hold + 1)
        down += abs(now + peak) > down * step
        peak = deceleration()
    first = now - (now + peak) * np.arange(1, down + 1) / down
    last = -peak * (1 - np.arange(1, up + 1) / up)
    return np.asarray(sign * np.concatenate([first, np.full(hold, -peak), last]), dtype=np.float64)
