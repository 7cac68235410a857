"""A prepared ground motion played sample by sample, with a ramp to zero when it is cancelled."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

CANCEL_TIME = 0.5
"""Seconds in which a cancelled motion ramps to zero."""


class Playback:
    """Answers samples of the rig with the ground acceleration of the next sample.

    Parameters
    ----------
    motion
        (samples,) [m/s^2]; its first value is the first answer.
    sample_rate
        Hz.
    """

    def __init__(self, motion: NDArray[np.float64], sample_rate: float) -> None:
        self._motion: list[float] = motion.tolist()
        self._first: int | None = None
        self._rate = sample_rate
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
        if self._first is None:
            self._first = sequence
        index = sequence - self._first
        self.played = min(max(index + 1, self.played), len(self._motion))
        return self._motion[index] if 0 <= index < len(self._motion) else 0.0

    def cancel(self) -> None:
        """Ramp from the last value to zero along a half cosine; done at once if nothing was played."""
        if self.cancelled or self.done:
            return
        self.cancelled = True
        if not self.played:
            self._motion = []
            return
        steps = round(CANCEL_TIME * self._rate)
        start = self._motion[self.played - 1]
        ramp = start * (1 + np.cos(np.pi * np.arange(1, steps + 1) / steps)) / 2
        self._motion[self.played :] = ramp.tolist()
