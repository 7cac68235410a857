"""A bag written by a thread of its own, so that a slow disk or a large chunk holds up nobody who takes messages."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import Counter, deque
from typing import TYPE_CHECKING

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from abrace_bags.writer import BagWriter

CAPACITY = 256 * 1024 * 1024
"""Bytes that may wait to be written."""

_URGENT = 4 * 1024 * 1024
"""Bytes that wake the thread before it is time to flush."""

OVERHEAD = 200
"""Bytes that a waiting message takes beside its own."""


class WritingThread:
    """Takes messages for a bag at once and writes them soon; flushes the bag at a set interval.

    Messages are given by one thread. When the disk is so slow that `CAPACITY` is reached, messages are left out and
    counted.

    Parameters
    ----------
    bag
        The bag, which from here on is this object's alone.
    flush_interval
        Seconds between flushes: what is lost when the process is killed.
    capacity
        Bytes that may wait to be written.

    Attributes
    ----------
    overflowed
        Messages left out, by topic number.
    """

    def __init__(self, bag: BagWriter, flush_interval: float, capacity: int = CAPACITY) -> None:
        self.overflowed: Counter[int] = Counter()
        self._bag = bag
        self._flush_interval = flush_interval
        self._capacity = capacity
        self._waiting: deque[tuple[int, bytes, int, int]] = deque()
        self._given = 0
        self._written = 0
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._ending = False
        self._failure: AbraceError | None = None
        self._thread = threading.Thread(target=self._run, name="bag", daemon=True)
        self._thread.start()

    def write(self, topic_id: int, payload: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Give a message to write, as in `BagWriter.write`, or count it where too many wait."""
        size = len(payload) + OVERHEAD
        waiting = self._given - self._written + size
        if waiting > self._capacity:
            self.overflowed[topic_id] += 1
            return
        self._given += size
        self._waiting.append((topic_id, payload, log_time_ns, publish_time_ns))
        if waiting > _URGENT:
            self._wake.set()

    def check(self) -> None:
        """Raise what has gone wrong in the thread.

        Raises
        ------
        AbraceError
            If the bag can't be written any more: it is closed as it is.
        """
        if self._failure:
            raise self._failure

    @contextlib.contextmanager
    def bag(self) -> Iterator[BagWriter]:
        """The bag, to do something with that comes after all messages so far.

        Raises
        ------
        AbraceError
            If the bag can't be written.
        """
        with self._lock:
            self.check()
            try:
                self._drain()
                yield self._bag
            except AbraceError as error:
                if self._bag.closed:
                    self._failure = error
                raise

    def close(self) -> None:
        """Write what waits, and close the bag. Closing again does nothing.

        Raises
        ------
        AbraceError
            If the bag can't be written.
        """
        self._ending = True
        self._wake.set()
        self._thread.join()
        with self.bag() as bag:
            for topic_id, count in self.overflowed.items():
                bag.add_lost(topic_id, count)
            self.overflowed.clear()
            bag.close()

    def _run(self) -> None:
        flush_due = time.monotonic() + self._flush_interval
        while not self._ending:
            self._wake.wait(max(0.0, flush_due - time.monotonic()))
            self._wake.clear()
            with self._lock:
                if self._failure:
                    return
                try:
                    self._drain()
                    if time.monotonic() >= flush_due:
                        self._bag.flush()
                        flush_due = time.monotonic() + self._flush_interval
                except AbraceError as error:
                    self._failure = error
                    return
                except Exception as error:
                    self._failure = AbraceError(f"cannot write bag {self._bag.directory}: {error!r}")
                    raise

    def _drain(self) -> None:
        write, waiting = self._bag.write, self._waiting
        for _ in range(len(waiting)):
            message = waiting.popleft()
            write(*message)
            self._written += len(message[1]) + OVERHEAD
