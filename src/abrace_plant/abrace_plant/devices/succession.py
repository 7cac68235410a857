# SPDX-License-Identifier: Apache-2.0
"""Which packet of a target may follow which, and when its sample was taken.

A packet is used if it is newer than the last one by a number of ticks that can have passed, and if its time agrees. So
a packet that was delayed, repeated, overtaken, or whose counter jumps is distinguished from a valid one after lost
ones.
"""

from __future__ import annotations

from abrace_plant.devices.layout import Malformed

SAME_TICK = 0.4
"""Ticks by which the counter and the time of a packet may disagree."""
RATE_ERROR = 1e-3
"""Share by which the target's ticks may be faster or slower, all in all, than the period that was given."""
CANDIDATES = 64
"""Packets that are remembered until two of them follow each other."""
DRIFT = 1e-4
"""Greatest relative difference of two computers' clocks, cheap quartzes."""


class Succession:
    """Checks the counters of packets that are valid in themselves.

    Two packets of which one follows the other at the next tick begin a succession; nothing is used before.

    Parameters
    ----------
    modulus
        Number of values of the counter.
    period
        Of the target's ticks [ns].
    """

    def __init__(self, modulus: int, period: float) -> None:
        self._modulus = modulus
        self._period = period
        self.reset()

    def reset(self) -> None:
        """Restart, with any counter."""
        self._last: tuple[int, int | None] | None = None
        self._candidates: dict[int, int | None] = {}
        self.ticks = 0
        """Ticks since the succession began."""

    def advance(self, counter: int, time: int | None, longest: int) -> int:
        """Ticks from the last packet to this one, 1 or more.

        Parameters
        ----------
        counter
            Of the packet.
        time
            Of the packet [ns], if it has one.
        longest
            Ticks that can have passed since the last packet.

        Raises
        ------
        Malformed
            Naming why it is not used: "repeated", "old", "jumping", "wrong_time", and "not_consecutive" before two
            of them have followed each other.
        """
        if self._last is None:
            before = (counter - 1) % self._modulus
            if before not in self._candidates or not self._agree(1, self._candidates[before], time):
                if len(self._candidates) >= CANDIDATES:
                    self._candidates.clear()
                self._candidates[counter] = time
                raise Malformed("not_consecutive")
            self._last = before, self._candidates[before]
            self._first_time = self._candidates[before]
            self._candidates.clear()
        last, last_time = self._last
        ticks = (counter - last) % self._modulus
        if ticks == 0:
            raise Malformed("repeated")
        if ticks > self._modulus // 2:
            raise Malformed("old")
        if ticks > longest:
            raise Malformed("jumping")
        whole = self.ticks + ticks
        if not self._agree(ticks, last_time, time) or not self._agree(whole, self._first_time, time):
            raise Malformed("wrong_time")
        self._last = counter, time
        self.ticks += ticks
        return ticks

    def _agree(self, ticks: int, last_time: int | None, time: int | None) -> bool:
        if last_time is None or time is None:
            return True
        return abs((time - last_time) / self._period - ticks) <= SAME_TICK + RATE_ERROR * ticks


class TargetClock:
    """How old a packet is when it arrives, beyond the least that any was: the way there and the clocks' difference.

    The least age is that of the quickest packet so far; it may grow by `DRIFT`, as the target's clock may be slower.
    """

    def __init__(self) -> None:
        self._least: float | None = None
        self._time = 0

    def age(self, time: int, now: int) -> float:
        """Age of a packet [ns].

        Parameters
        ----------
        time
            By the target's clock [ns].
        now
            When it arrived, by ours [ns].
        """
        offset = now - time
        if self._least is None or offset < self._least:
            self._least = offset
        else:
            self._least = min(self._least + DRIFT * abs(time - self._time), offset)
        self._time = time
        return offset - self._least
