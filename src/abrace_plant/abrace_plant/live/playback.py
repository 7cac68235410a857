# SPDX-License-Identifier: Apache-2.0
"""A prepared ground motion played sample by sample, with a stop to rest when it is cancelled."""

from __future__ import annotations

from typing import TYPE_CHECKING

from abrace_core.safety.table_stop import TableState, TableStop

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from abrace_core.safety.table_stop import Table


class Playback:
    """Answers samples of the rig with the ground acceleration of the next sample.

    Parameters
    ----------
    motion
        (samples,) [m/s^2]; its first value is the first answer.
    sample_rate
        Hz.
    table
        Limits of the table, within which a cancelled motion comes to rest.
    displacement
        Where the table rests before the motion [m].
    """

    def __init__(
        self, motion: NDArray[np.float64], sample_rate: float, table: Table, displacement: float = 0.0
    ) -> None:
        self._motion: list[float] = motion.tolist()
        self._first: int | None = None
        self._rate = sample_rate
        self._table = table
        self._state = TableState(1 / sample_rate, displacement)
        self.played = 0
        """Values of the motion played so far."""
        self.cancelled = False

    @property
    def done(self) -> bool:
        """Whether the last value has been played."""
        return self.played >= len(self._motion)

    @property
    def elapsed(self) -> float:
        """Seconds played."""
        return self.played / self._rate

    @property
    def duration(self) -> float:
        """Seconds in all."""
        return len(self._motion) / self._rate

    def answer(self, sequence: int) -> float:
        """Ground acceleration [m/s^2] of the sample after `sequence`; zero after the motion."""
        if self.done:
            return 0.0
        if self._first is None:
            self._first = sequence
        index = sequence - self._first
        played = min(max(index + 1, self.played), len(self._motion))
        for acceleration in self._motion[self.played : played]:
            self._state.update(acceleration)
        self.played = played
        return self._motion[index] if 0 <= index < len(self._motion) else 0.0

    def cancel(self) -> None:
        """Bring the table to rest by a `TableStop`; done at once if nothing was played."""
        if self.cancelled or self.done:
            return
        self.cancelled = True
        if not self.played:
            self._motion = []
            return
        state, period = self._state, 1 / self._rate
        stop = TableStop(state.acceleration, state.velocity, state.displacement, self._table, period)
        self._motion[self.played :] = stop.profile

    def finish(self) -> None:
        """Cancel the motion, and take its stop as done: the rig has brought the table to rest."""
        self.cancel()
        self.played = len(self._motion)
