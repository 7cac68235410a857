# SPDX-License-Identifier: Apache-2.0
"""A network link with faults: delay, jitter, loss, repetition, reordering and corruption of packets."""

from __future__ import annotations

import heapq
import random
from dataclasses import dataclass


@dataclass
class Faults:
    """What is wrong with a link; may be changed at any time."""

    delay: float = 0.0
    """Of every packet [s]."""
    jitter: float = 0.0
    """Greatest additional delay, evenly spread [s]; packets may overtake each other."""
    loss: float = 0.0
    """Share of packets that are lost."""
    repetition: float = 0.0
    """Share of packets that arrive twice."""
    reordering: float = 0.0
    """Share of packets that arrive after the next one."""
    corruption: float = 0.0
    """Share of packets in which a bit is inverted."""


class Link:
    """One direction of a link.

    Parameters
    ----------
    seed
        Of what happens by chance.
    """

    def __init__(self, seed: int) -> None:
        self.faults = Faults()
        self._random = random.Random(seed)
        self._waiting: list[tuple[float, int, bytes]] = []
        self._kept: bytes | None = None
        self._number = 0

    def put(self, packet: bytes, now: float) -> None:
        """Let a `packet` enter at `now` [s]."""
        faults, chance = self.faults, self._random.random
        if faults.loss and chance() < faults.loss:
            return
        if faults.corruption and packet and chance() < faults.corruption:
            bit = self._random.randrange(8 * len(packet))
            changed = bytearray(packet)
            changed[bit // 8] ^= 1 << bit % 8
            packet = bytes(changed)
        if faults.reordering and self._kept is None and chance() < faults.reordering:
            self._kept = packet
            return
        self._enter(packet, now)
        if faults.repetition and chance() < faults.repetition:
            self._enter(packet, now)
        if self._kept is not None:
            self._enter(self._kept, now)
            self._kept = None

    def _enter(self, packet: bytes, now: float) -> None:
        due = now + self.faults.delay + (self.faults.jitter * self._random.random() if self.faults.jitter else 0.0)
        heapq.heappush(self._waiting, (due, self._number, packet))
        self._number += 1

    def take(self, now: float) -> list[bytes]:
        """The packets that leave until `now` [s], in their order."""
        left = []
        while self._waiting and self._waiting[0][0] <= now:
            left.append(heapq.heappop(self._waiting)[2])
        return left

    @property
    def due(self) -> float:
        """When the next packet leaves [s]; infinite where none waits."""
        return self._waiting[0][0] if self._waiting else float("inf")
