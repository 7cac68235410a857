# SPDX-License-Identifier: Apache-2.0
"""The limits of every acceleration of the shake table before it acts, and the stop that brings the table to rest."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from abrace_core.safety.table_stop import TableState, TableStop, turning_point

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_core.safety.table_stop import Table


STILL, DRIFT = 1.0, 0.02
"""A table whose command is zero for this time [s] is at rest if its velocity is at most this share of the greatest:
what is left is due to rounding and missed samples, and the table's own controller holds its position."""


class TableGuard:
    """Limits the acceleration of a shake table, sample by sample; within the limits it passes bit for bit.

    Parameters
    ----------
    table
        Limits of the table.
    sample_period
        Time between two calls of `follow` or `come_to_rest` [s].

    Attributes
    ----------
    value
        (1,) [m/s^2], the acceleration that acts.
    state
        State of the table, as commanded.
    limited
        Whether the last acceleration was limited.
    limits
        Number of samples so far with a limited acceleration.
    lost
        Whether the displacement is unknown: the device failed, or its target stopped, while the table moved.
    """

    def __init__(self, table: Table, sample_period: float) -> None:
        self._table, self._period = table, sample_period
        self._step = table.peak_jerk * sample_period
        self._still, self._slow = 0.0, DRIFT * table.peak_velocity
        self.limits = 0
        self.lost = False
        self.state = TableState(sample_period)
        self.reset()

    def reset(self) -> None:
        """Set the table to rest, at its present displacement."""
        self.state = TableState(self._period, self.state.displacement)
        self.value = self._command = [0.0]
        self._stop: TableStop | None = None
        self.limited = False

    def place(self, displacement: float) -> None:
        """Set the table to rest at the `displacement` that is measured [m]."""
        self.state = TableState(self._period, displacement)
        self.lost = False
        self.reset()

    def problem(self, command: Sequence[float]) -> str | None:
        """Why a `command` (1,), an acceleration [m/s^2], cannot act; None: it can act."""
        if len(command) != 1 or not math.isfinite(command[0]):
            return f"ground acceleration {list(command)}, expected one finite number"
        return None

    def follow(self, command: Sequence[float] | None, share: float = 1.0) -> None:  # noqa: ARG002
        """Apply a `command` (1,) [m/s^2] that has no `problem`; None: the last command.

        A motion that was scaled for a while would not end at rest, so it is applied whole, whatever the `share`.
        """
        if command is not None:
            self._command = [float(command[0])]
        wanted, last = self._command[0], self.value[0]
        most, step = self._table.peak_acceleration, self._step
        value = min(max(wanted, -most), most)
        if abs(value - last) > step:
            value = last + math.copysign(step, value - last)
        self.limited = value != wanted
        self.limits += self.limited
        self._go(value)

    def begin_to_rest(self) -> None:
        """Begin the stop that brings the table to rest within its limits."""
        state = self.state
        self._command = [0.0]
        self.limited = False
        self._stop = TableStop(state.acceleration, state.velocity, state.displacement, self._table, self._period)

    @property
    def moving(self) -> bool:
        """Whether the table moves by more than what is due to rounding and missed samples."""
        return self.value[0] != 0.0 or abs(self.state.velocity) > self._slow

    @property
    def turning_point(self) -> float:
        """Displacement at which the table can come to a standstill at the earliest, as commanded [m]."""
        return turning_point(self.state.acceleration, self.state.velocity, self.state.displacement, self._table)

    @property
    def at_rest(self) -> bool:
        """Whether the stop is over."""
        return self._stop is None or self._stop.done

    def come_to_rest(self, samples: int = 1) -> None:
        """Advance the stop by this number of `samples`; in all but the last the table could not be commanded.

        Where it would then continue with a step beyond the limit of jerk, another one begins from here.
        """
        stop = self._stop
        assert stop is not None
        self.state.hold(samples - 1)
        for _ in range(samples - 1):
            stop.next()
        acceleration = stop.next()
        if samples > 1 and abs(acceleration - self.value[0]) > self._step:
            self.begin_to_rest()
            stop = self._stop
            assert stop is not None
            acceleration = stop.next()
        self._go(acceleration)
        if stop.done and abs(self.state.velocity) > self._slow:
            self.begin_to_rest()

    def hold(self, samples: int) -> None:
        """Count `samples` in which the last acceleration went on, as no command could be given."""
        self.state.hold(samples)
        if not self.at_rest:
            # the stop that has not begun yet begins from here
            self.begin_to_rest()

    def _go(self, acceleration: float) -> None:
        self.value = [acceleration]
        state = self.state
        state.update(acceleration)
        self._still = 0.0 if acceleration else self._still + self._period
        if self._still >= STILL and abs(state.velocity) <= self._slow:
            state.velocity = 0.0
