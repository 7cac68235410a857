# SPDX-License-Identifier: Apache-2.0
"""The limits of every force command before it acts: finite, within capacity and rate limit.

A command within the limits passes unchanged, bit for bit, as identification requires. A ramp-down brings the force to
zero along a half cosine within the ramp time.
"""

from __future__ import annotations

import math
from collections import deque
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

MOST_IN_FLIGHT = 500
"""Commands that are remembered."""


def rate_problem(capacity: float, rate_limit: float, sample_period: float, ramp_time: float) -> str:
    """What is wrong with a rate limit too low for the ramp-down from capacity; empty: nothing.

    Parameters
    ----------
    capacity
        Greatest force [N], from which the ramp begins.
    rate_limit
        Greatest rate of the force [N/s].
    sample_period
        [s].
    ramp_time
        Duration of the ramp to zero force [s], at least `sample_period`.
    """
    # the steepest step of the half cosine of n steps is sin(pi / (2 n)) of the force that it starts from
    steepest = math.sin(math.pi / (2 * _ramp_steps(sample_period, ramp_time)))
    least = capacity * steepest / sample_period
    if rate_limit >= least:
        return ""
    digit = 10.0 ** (math.floor(math.log10(least)) - 3)
    enough = math.ceil(least / digit) * digit
    return f"{rate_limit:g} N/s, expected at least {enough:g} N/s to bring {capacity:g} N to zero in {ramp_time:g} s"


def _ramp_steps(sample_period: float, ramp_time: float) -> int:
    """Whole sample periods of the ramp."""
    return int(ramp_time / sample_period * (1 + 1e-12))


class CommandGuard:
    """Limits the force commands of a rig's brace groups, sample by sample.

    Parameters
    ----------
    capacity
        (groups,) greatest force of one brace of each group [N].
    rate_limit
        (groups,) greatest rate of the force of one brace of each group [N/s].
    sample_period
        Time between two calls of `follow` or `come_to_rest` [s].
    ramp_time
        Duration of the ramp to zero force [s], at least a sample period.
    rate_name
        What errors call a rate limit that is too low for the ramp: the parameter or key that sets it.

    Attributes
    ----------
    value
        (groups,) [N], the force that acts; zero before the first command.
    commands_in_flight
        Number of the last commands that the actuators may not have received yet; 0 unless set. The next one is within
        the rate limit of each of them and of the one before them, so that it makes no greater step whichever of them
        acts until then.
    saturated, rate_limited
        Whether the last command was limited to the capacity, and by the rate limit.
    saturations
        Number of commands so far that were limited to the capacity.
    rate_limits
        Number of samples so far at which the rate limit kept the force from reaching its command.

    Raises
    ------
    AbraceError
        If a limit is not positive and finite, the ramp time shorter than a sample, or the rate limit too low for a ramp
        from capacity.
    """

    def __init__(
        self,
        capacity: ArrayLike,
        rate_limit: ArrayLike,
        sample_period: float,
        ramp_time: float,
        rate_name: str = "command guard: rate_limit",
    ) -> None:
        limits = np.asarray(capacity, dtype=np.float64), np.asarray(rate_limit, dtype=np.float64)
        if limits[0].ndim != 1 or limits[0].shape != limits[1].shape:
            raise AbraceError(
                f"command guard: capacity of shape {limits[0].shape} and rate_limit of shape {limits[1].shape}, "
                "expected one number for each brace group"
            )
        times = np.array([sample_period, ramp_time])
        for name, values in (("capacity", limits[0]), ("rate_limit", limits[1]), ("sample_period, ramp_time", times)):
            if not (np.isfinite(values) & (values > 0)).all():
                raise AbraceError(f"command guard: {name} {values.tolist()}, expected more than 0")
        self._capacity: list[float] = limits[0].tolist()
        self._step: list[float] = (limits[1] * sample_period).tolist()
        steps = _ramp_steps(sample_period, ramp_time)
        if not steps:
            raise AbraceError(
                f"command guard: ramp_time {ramp_time:g} s, expected at least a sample_period, {sample_period:g} s"
            )
        for most, rate in zip(self._capacity, limits[1].tolist(), strict=True):
            if problem := rate_problem(most, rate, sample_period, ramp_time):
                raise AbraceError(f"{rate_name}: {problem}")
        self._ramp = [(1 + math.cos(math.pi * j / steps)) / 2 for j in range(1, steps)]
        self.saturations = 0
        self.rate_limits = 0
        self.commands_in_flight = 0
        self._given: deque[list[float]] = deque(maxlen=MOST_IN_FLIGHT + 1)
        self.reset()

    def reset(self) -> None:
        """Set force and command to zero."""
        self._command = [0.0] * len(self._capacity)
        self.value = self._command.copy()
        self._given.clear()
        self._given.append(self.value)
        self._ramp_start = self.value
        self._ramp_steps = 0
        self.saturated = self.rate_limited = False

    def problem(self, command: Sequence[float]) -> str | None:
        """Why a command (groups,) [N] cannot act, because of its length or values that are not finite; None: it can."""
        try:
            if len(command) == len(self._capacity) and all(map(math.isfinite, command)):
                return None
            given = np.asarray(command, dtype=np.float64)
        except (TypeError, ValueError):
            return f"command {command!r}, expected {len(self._capacity)} numbers"
        if given.shape != (len(self._capacity),):
            return f"command of shape {given.shape}, expected {(len(self._capacity),)}"
        return f"command {given.tolist()}, expected finite numbers"

    def follow(self, command: Sequence[float] | None, share: float = 1.0) -> None:
        """Apply a `share` of a `command` (groups,) [N] that has no `problem`; None: of the last command."""
        if command is not None:
            self._command = list(map(float, command))
        force, saturated, limited = [], False, False
        within_reach = self._within_reach() if self.commands_in_flight else None
        for i, asked in enumerate(self._command):
            wanted, most = asked * share, self._capacity[i]
            if wanted > most or wanted < -most:
                wanted, saturated = math.copysign(most, wanted), True
            if within_reach is None:
                last, step = self.value[i], self._step[i]
                least, greatest = last - step, last + step
            else:
                least, greatest = within_reach[i]
            if wanted > greatest:
                wanted, limited = greatest, True
            elif wanted < least:
                wanted, limited = least, True
            force.append(wanted)
        self._give(force)
        self.saturated, self.rate_limited = saturated, limited
        self.saturations += saturated and command is not None
        self.rate_limits += limited

    def hold(self, samples: int) -> None:
        """Nothing to do for the `samples` in which no command could be given: forces have no history."""

    def repeat(self) -> None:
        """Note that the last command is sent once more."""
        self._given.append(self.value)

    def begin_to_rest(self) -> None:
        """Begin the ramp from the present force to zero."""
        self._command = [0.0] * len(self._capacity)
        self._ramp_start, self._ramp_steps = self.value, 0
        self.saturated = self.rate_limited = False

    @property
    def moving(self) -> bool:
        """Whether the force is not zero."""
        return any(self.value)

    @property
    def at_rest(self) -> bool:
        """Whether the force is zero."""
        return not self.moving

    def come_to_rest(self, samples: int = 1) -> None:
        """Advance the ramp by this number of `samples`, within the rate limit."""
        self._ramp_steps += samples
        over = self._ramp_steps > len(self._ramp)
        share = 0.0 if over else self._ramp[self._ramp_steps - 1]
        self._give(
            [
                min(max(share * start, least), greatest)
                for start, (least, greatest) in zip(self._ramp_start, self._within_reach(), strict=True)
            ]
        )

    def _within_reach(self) -> list[tuple[float, float]]:
        """The least and greatest next force of each group [N], by the rate limit.

        Where they lie too far apart, as after a pause, the last one is kept.
        """
        if not self.commands_in_flight:
            return [(last - step, last + step) for last, step in zip(self.value, self._step, strict=True)]
        groups = zip(*islice(reversed(self._given), self.commands_in_flight + 1), strict=True)
        return [
            (min(max(given) - step, given[0]), max(min(given) + step, given[0]))
            for given, step in zip(groups, self._step, strict=True)
        ]

    def _give(self, force: list[float]) -> None:
        self.value = force
        self._given.append(force)
