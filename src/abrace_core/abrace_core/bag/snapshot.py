"""The last seconds of all topics in memory, for a bag that is written only on request."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from abrace_core.bag.writing_thread import OVERHEAD

if TYPE_CHECKING:
    from abrace_core.bag.writer import BagWriter

CAPACITY = 512 * 1024 * 1024
"""Bytes that are kept at most, however short the time."""


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
        """Keep a message, and drop those that are too old: `BagWriter.write` for later.

        Parameters
        ----------
        topic_id
            From `BagWriter.add_topic`.
        payload
            The serialised message.
        log_time_ns, publish_time_ns
            When it arrived and when it was published [ns].
        """
        messages = self._messages
        messages.append((topic_id, payload, log_time_ns, publish_time_ns))
        self._size += len(payload) + OVERHEAD
        # a clock that was set back leaves messages of times to come
        while messages and (abs(log_time_ns - messages[0][2]) > self._duration or self._size > CAPACITY):
            self._size -= len(messages.popleft()[1]) + OVERHEAD

    def hand_to(self, bag: BagWriter) -> int:
        """Write what is kept to a bag, which keeps nothing here; returns how many messages that were.

        Parameters
        ----------
        bag
            The bag, open.
        """
        bag.interrupt()
        count = len(self._messages)
        while self._messages:
            bag.write(*self._messages.popleft())
        self._size = 0
        bag.flush()
        return count
