"""A bag recorded from live topics: one thread receives the messages, another writes them, all or the last seconds."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import Counter, deque
from typing import TYPE_CHECKING

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from abrace_bags.writer import BagWriter

CAPACITY = 256 * 1024 * 1024
"""Bytes that may wait to be written."""
SNAPSHOT_CAPACITY = 512 * 1024 * 1024
"""Bytes of a snapshot, however short its time."""
_WAKE_SIZE = 4 * 1024 * 1024
"""Waiting bytes that wake the thread before the next flush."""
_OVERHEAD = 200
"""Bytes of memory that a waiting message takes in addition to its own."""
_INTERRUPTION = 0
"""In place of a topic's number, which is 1 or more, where messages are left out on purpose."""


class Recording:
    """A bag that a thread writes, so that a slow disk or a large chunk does not delay who receives the messages.

    Messages are given by one thread. Those that come while `capacity` is reached are lost and counted. With a snapshot
    the messages of the last seconds stay in memory, and are written on request.

    Parameters
    ----------
    bag
        The bag; from here on only this object uses it.
    flush_interval
        Seconds between flushes: what is lost when the process is killed.
    snapshot
        Seconds that a message stays in memory; 0: each is written at once.
    capacity
        Bytes that may wait to be written; by default `CAPACITY`, or `SNAPSHOT_CAPACITY`.

    Attributes
    ----------
    overflowed
        Messages lost since the disk is too slow, by topic number.
    """

    def __init__(
        self, bag: BagWriter, flush_interval: float, snapshot: float = 0.0, capacity: int | None = None
    ) -> None:
        self.overflowed: Counter[int] = Counter()
        self._bag = bag
        self._flush_interval = flush_interval
        self._snapshot = round(snapshot * 1e9)
        self._capacity = capacity or (SNAPSHOT_CAPACITY if snapshot else CAPACITY)
        self._waiting: deque[tuple[int, bytes, int, int]] = deque()
        # two counts, as one that both threads change would need a lock for each message
        self._bytes_in = 0
        self._bytes_out = 0
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._ending = False
        self._failure: AbraceError | None = None
        self._thread = threading.Thread(target=self._run, name="bag", daemon=True)
        self._thread.start()

    def write(self, topic_id: int, payload: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Record a message, as in `BagWriter.write`, or count it as lost."""
        size = len(payload) + _OVERHEAD
        waiting = self._bytes_in - self._bytes_out + size
        if waiting > self._capacity and not self._snapshot:
            self.overflowed[topic_id] += 1
            return
        self._bytes_in += size
        self._waiting.append((topic_id, payload, log_time_ns, publish_time_ns))
        if self._snapshot:
            self._drop_old(log_time_ns)
        elif waiting > _WAKE_SIZE:
            self._wake.set()

    def interrupt(self) -> None:
        """Count no gap of `sequence` before the next message of each topic, as in `BagWriter.interrupt`.

        Raises
        ------
        AbraceError
            As `check`.
        """
        self.check()
        last_time = self._waiting[-1][2] if self._snapshot and self._waiting else 0
        self._bytes_in += _OVERHEAD
        self._waiting.append((_INTERRUPTION, b"", last_time, 0))

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
        """The bag, after all messages so far are in it but those of a snapshot.

        Raises
        ------
        AbraceError
            If the bag can't be written.
        """
        with self._lock:
            self.check()
            try:
                if not self._snapshot:
                    self._write_waiting()
                yield self._bag
            except AbraceError as error:
                if self._bag.closed:
                    self._failure = error
                raise

    def write_snapshot(self) -> int:
        """Write the messages of the last seconds and forget them; returns how many those were.

        Raises
        ------
        AbraceError
            If the bag can't be written.
        """
        with self.bag() as bag:
            bag.interrupt()
            count = self._write_waiting()
            bag.flush()
        return count

    def close(self, lost: Mapping[int, int] | None = None) -> BagWriter:
        """Write what waits, and close the bag, which is returned. Closing again does nothing.

        Parameters
        ----------
        lost
            Messages that were published and did not come to `write`, by topic number.

        Raises
        ------
        AbraceError
            If the bag can't be written.
        """
        self._ending = True
        self._wake.set()
        self._thread.join()
        with self.bag() as bag:
            for topic_id, count in (*self.overflowed.items(), *(lost or {}).items()):
                bag.add_lost(topic_id, count)
            self.overflowed.clear()
            bag.close()
        return bag

    def _run(self) -> None:
        flush_due = time.monotonic() + self._flush_interval
        while not self._ending:
            self._wake.wait(max(0.0, flush_due - time.monotonic()))
            self._wake.clear()
            with self._lock:
                if self._failure:
                    return
                try:
                    if not self._snapshot:
                        self._write_waiting()
                    if time.monotonic() >= flush_due:
                        self._bag.flush()
                        flush_due = time.monotonic() + self._flush_interval
                except AbraceError as error:
                    self._failure = error
                    return
                except Exception as error:
                    self._failure = AbraceError(f"cannot write bag {self._bag.directory}: {error!r}")
                    raise

    def _write_waiting(self) -> int:
        write, waiting = self._bag.write, self._waiting
        count = 0
        for _ in range(len(waiting)):
            message = waiting.popleft()
            if message[0] == _INTERRUPTION:
                self._bag.interrupt()
            else:
                write(*message)
                count += 1
            self._bytes_out += len(message[1]) + _OVERHEAD
        return count

    def _drop_old(self, now: int) -> None:
        """Drop messages of a snapshot: older ones, more than fit, and those from before the clock was set back."""
        waiting = self._waiting
        while waiting and (
            abs(now - waiting[0][2]) > self._snapshot or self._bytes_in - self._bytes_out > self._capacity
        ):
            self._bytes_out += len(waiting.popleft()[1]) + _OVERHEAD


def parse_facts(texts: Sequence[str]) -> dict[str, str]:
    """The facts of a run from `texts` of the form key=value.

    Raises
    ------
    AbraceError
        If a text has no key or no `=`, or a key comes twice.
    """
    facts = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not (key and equals):
            raise AbraceError(f"parameter facts: {text!r}, expected key=value")
        if key in facts:
            raise AbraceError(f"parameter facts: {texts}, expected each key once")
        facts[key] = value
    return facts
