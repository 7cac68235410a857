"""The checks that every force command passes before it acts: finite, within capacity and rate limit, no fault.

A command within the limits passes bit for bit, as identification needs it. The first fault is latched: the force goes
along a half cosine to zero within the ramp time, whatever is commanded, and stays zero until the guard is cleared.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray


class CommandGuard:
    """Guards the force commands of a rig's brace groups, sample by sample.

    Parameters
    ----------
    capacity
        (groups,) greatest force of one brace of each group [N].
    rate_limit
        (groups,) greatest rate of the force of one brace of each group [N/s].
    sample_period
        Between two calls of `check` [s].
    ramp_time
        From a fault to zero force [s]; long enough to get there from capacity within the rate limit.

    Attributes
    ----------
    saturations
        Commands so far that were limited to capacity.
    rate_limits
        Samples so far at which the rate limit held the force back from its command.

    Raises
    ------
    AbraceError
        If a limit is not positive and finite, or the ramp time is too short for the rate limit.
    """

    def __init__(self, capacity: ArrayLike, rate_limit: ArrayLike, sample_period: float, ramp_time: float) -> None:
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
        self._shape = (len(self._capacity),)
        steps = int(ramp_time / sample_period * (1 + 1e-12))
        # the steepest step of the half cosine of `steps` steps is sin(pi / (2 steps)) of the force that it starts from
        steepest = math.sin(math.pi / (2 * steps)) if steps else 1.0
        for most, step in zip(self._capacity, self._step, strict=True):
            if steps == 0 or steepest * most > step:
                needed = math.ceil(math.pi / 2 / math.asin(min(1.0, step / most))) * sample_period
                raise AbraceError(
                    f"command guard: ramp_time {ramp_time:g} s, expected at least {needed:g} s to bring {most:g} N "
                    f"to zero at {step / sample_period:g} N/s"
                )
        self._ramp = [(1 + math.cos(math.pi * j / steps)) / 2 for j in range(1, steps)]
        self._ramp_steps = 0
        self._ramp_start: list[float] = []
        self._fault_reason: str | None = None
        self._command = [0.0] * len(self._capacity)
        self._force = [0.0] * len(self._capacity)
        self.saturations = 0
        self.rate_limits = 0

    @property
    def fault_reason(self) -> str | None:
        """Reason of the first fault since the start or the last `clear`; None: no fault."""
        return self._fault_reason

    @property
    def force(self) -> NDArray[np.float64]:
        """(groups,) [N], result of the last `check`; zero before the first."""
        return np.array(self._force)

    def reset_force(self) -> None:
        """Set force and command to zero, because the rig has restarted with its braces at rest."""
        self._force = self._ramp_start = self._command = [0.0] * len(self._capacity)

    def fault(self, reason: str) -> None:
        """Latch a fault: from the next `check` on, the force goes to zero. Only the first reason is kept."""
        if self._fault_reason is None:
            self._fault_reason = reason
            self._ramp_start = self._force
            self._ramp_steps = 0

    def clear(self) -> None:
        """Clear the fault. The force starts from where the ramp has brought it, in the end zero, with zero command."""
        self._fault_reason = None
        self._command = [0.0] * len(self._capacity)

    def check(self, force: NDArray[np.float64] | Sequence[float] | None) -> NDArray[np.float64]:
        """The force that acts from this sample on; called once a sample.

        Parameters
        ----------
        force
            (groups,) the new command [N]; None: the last one is held. A command of another length, or with a value that
            is not finite, is a fault.

        Returns
        -------
        NDArray
            (groups,) [N], a new array: the command itself within the limits.
        """
        if force is not None and self._fault_reason is None:
            self._accept(force)
        self._force = self._follow() if self._fault_reason is None else self._ramp_down()
        return np.array(self._force)

    def _accept(self, force: NDArray[np.float64] | Sequence[float]) -> None:
        """Limit a new command to capacity and make it the present one, or latch a fault."""
        try:
            given = np.asarray(force, dtype=np.float64)
        except (TypeError, ValueError):
            self.fault(f"command {force!r}, expected numbers")
            return
        if given.shape != self._shape:
            self.fault(f"command of shape {given.shape}, expected {self._shape}")
            return
        command: list[float] = given.tolist()
        saturated = False
        for i, value in enumerate(command):
            if not math.isfinite(value):
                self.fault(f"command {command}, expected finite numbers")
                return
            most = self._capacity[i]
            if value > most or value < -most:
                command[i] = math.copysign(most, value)
                saturated = True
        self.saturations += saturated
        self._command = command

    def _follow(self) -> list[float]:
        """The command, limited to the rate limit's step from the last force."""
        force = self._command.copy()
        limited = False
        for i, last in enumerate(self._force):
            change, step = force[i] - last, self._step[i]
            if change > step or change < -step:
                force[i] = last + math.copysign(step, change)
                limited = True
        self.rate_limits += limited
        return force

    def _ramp_down(self) -> list[float]:
        """The force at the ramp's next step; zero after its end."""
        if self._ramp_steps == len(self._ramp):
            return [0.0] * len(self._capacity)
        share = self._ramp[self._ramp_steps]
        self._ramp_steps += 1
        return [share * force for force in self._ramp_start]
