"""The last seconds of all topics in memory, for a bag that is written only on request."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from abrace_bags.writing_thread import OVERHEAD

if TYPE_CHECKING:
    from abrace_bags.writer import BagWriter

CAPACITY = 512 * 1024 * 1024
"""Bytes that are kept at most, however short the time."""

_INTERRUPTION = 0
"""Stands for the number of a topic, which are counted from 1."""


class Snapshot:
    """What came in the last seconds.

    Parameters
    ----------
    duration
        How long a message is kept [s].
    """

    def __init__(self, duration: float) -> None:
        self._duration = round(duration * 1e9)
        self._messages: deque[tuple[int, bytes, int, int]] = deque()
        self._size = 0

    def write(self, topic_id: int, payload: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Keep a message, as in `BagWriter.write` but for later, and drop those that are too old."""
        messages = self._messages
        messages.append((topic_id, payload, log_time_ns, publish_time_ns))
        self._size += len(payload) + OVERHEAD
        # a clock that was set back leaves messages of times to come
        while messages and (abs(log_time_ns - messages[0][2]) > self._duration or self._size > CAPACITY):
            self._size -= len(messages.popleft()[1]) + OVERHEAD

    def interrupt(self) -> None:
        """What is left out from here to the next message of each topic is left out on purpose."""
        if self._messages:
            self._messages.append((_INTERRUPTION, b"", self._messages[-1][2], 0))
            self._size += OVERHEAD

    def hand_to(self, bag: BagWriter) -> int:
        """Write what is kept to a bag, which keeps nothing here; returns how many messages that were.

        Parameters
        ----------
        bag
            The bag, open.
        """
        bag.interrupt()
        count = 0
        while self._messages:
            message = self._messages.popleft()
            if message[0] == _INTERRUPTION:
                bag.interrupt()
            else:
                bag.write(*message)
                count += 1
        self._size = 0
        bag.flush()
        return count
