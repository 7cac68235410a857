# SPDX-License-Identifier: Apache-2.0
"""A bag recorded from live topics: one thread receives the messages, another writes them, all or the last seconds."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import Counter, deque
from functools import partial
from typing import TYPE_CHECKING

from rosbags.interfaces import QosDurability

from abrace_core.errors import AbraceError
from abrace_core.wire import read_header

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from pathlib import Path

    from rosbags.interfaces import Qos

    from abrace_bags.writer import BagWriter

    Message = tuple[int, bytes, int, int]
    """Number of the topic, payload, when it was received and when published [ns]."""

CAPACITY = 256 * 1024 * 1024
"""Bytes that may wait to be written."""
SNAPSHOT_CAPACITY = 512 * 1024 * 1024
"""Bytes of a snapshot, however short its time, with what waits to be written."""
TRANSIENT_LOCAL_KEPT = 100
"""Messages of each transient local topic that a snapshot keeps, however old: a message doesn't tell its publisher."""
SAMPLE_TYPES = (
    "abrace_interfaces/msg/Response",
    "abrace_interfaces/msg/BraceCommand",
    "geometry_msgs/msg/AccelStamped",
)
"""Messages of the control loop, whose stamps are the times of the rig's samples."""
_WRITTEN_AT_ONCE = 4 * 1024 * 1024
"""Waiting bytes that wake the thread before the next flush, and after which it looks whether to sync."""
_OVERHEAD = 200
"""Bytes of memory that a waiting message takes in addition to its own."""
_STEP = 0
"""In place of a topic's number, which is 1 or more, for a step of the writing thread in place of a message."""


class Recording:
    """A bag that a thread writes: a slow disk, a sync or a large chunk does not delay the receiving thread.

    One thread calls the methods. Only `close` waits for the disk: the other requests are queued. Messages that arrive
    while `capacity` is reached are lost and counted. With a snapshot the messages of the last seconds stay in memory,
    and are written on request.

    Whatever fails in the writing thread ends the recording: the bag is closed with what was written, `check` raises.

    Parameters
    ----------
    bag
        The bag, without topics; from here on only this object uses it.
    flush_interval
        Seconds between flushes: what is lost when the process is killed.
    sync_interval
        Seconds between syncs: what is lost in a power loss, in addition to a flush interval.
    snapshot
        Seconds that a message stays in memory; 0: each is written at once.
    capacity
        Bytes that may wait to be written; by default `CAPACITY`, or `SNAPSHOT_CAPACITY`.
    lockstep
        Whether the log time is the rig's: the stamp of `SAMPLE_TYPES`, of other messages that of the last such one.

    Attributes
    ----------
    overflowed
        Messages lost since the disk is too slow, by topic number.
    untimed
        Messages that came without a valid time, by topic number.
    """

    def __init__(
        self,
        bag: BagWriter,
        flush_interval: float,
        *,
        sync_interval: float = 0.5,
        snapshot: float = 0.0,
        capacity: int | None = None,
        lockstep: bool = False,
    ) -> None:
        self.overflowed: Counter[int] = Counter()
        self.untimed: Counter[int] = Counter()
        self._bag = bag
        self._flush_interval, self._sync_interval = flush_interval, sync_interval
        self._snapshot = round(snapshot * 1e9)
        self._capacity = capacity or (SNAPSHOT_CAPACITY if snapshot else CAPACITY)
        self._lockstep = lockstep
        self._sample_time = 0
        self._topics = 0
        self._stamped: set[int] = set()
        self._waiting: deque[tuple[int, bytes | Callable[[], object], int, int]] = deque()
        # of a snapshot: the last seconds, and older messages of each transient local topic
        self._recent: deque[Message] = deque()
        self._transient_local: dict[int, deque[Message]] = {}
        # two counts: a single one that both threads change would need a lock for each message
        self._bytes_in = 0
        self._bytes_out = 0
        self._wake = threading.Event()
        self._ending = False
        self._failure: AbraceError | None = None
        self._thread = threading.Thread(target=self._run, name="bag", daemon=True)
        self._thread.start()

    @property
    def file(self) -> Path:
        """The file that is being written."""
        return self._bag.file

    def add_topic(self, name: str, type_name: str, definition_text: str, type_hash: str, *qos: Qos) -> int:
        """Announce a topic, as in `BagWriter.add_topic`, once; returns its number."""
        self._topics += 1
        self._do(partial(self._bag.add_topic, name, type_name, definition_text, type_hash, *qos))
        if type_name in SAMPLE_TYPES:
            self._stamped.add(self._topics)
        if any(one.durability is QosDurability.TRANSIENT_LOCAL for one in qos):
            self._transient_local[self._topics] = deque()
        return self._topics

    def write(self, topic_id: int, payload: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Record a message, as in `BagWriter.write`, or count it as lost.

        The middleware gives -1 and -2 for a time that it doesn't know: the time of reception is then now, that of
        publishing the time of reception.
        """
        if log_time_ns < 0 or publish_time_ns < 0:
            self.untimed[topic_id] += 1
            log_time_ns = log_time_ns if log_time_ns >= 0 else time.time_ns()
            publish_time_ns = publish_time_ns if publish_time_ns >= 0 else log_time_ns
        if self._lockstep:
            log_time_ns = self._time_of_sample(topic_id, payload)
        size = len(payload) + _OVERHEAD
        waiting = self._bytes_in - self._bytes_out + size
        if self._snapshot:
            self._bytes_in += size
            self._recent.append((topic_id, payload, log_time_ns, publish_time_ns))
            self._drop_old(log_time_ns)
            return
        if waiting > self._capacity:
            self.overflowed[topic_id] += 1
            return
        self._bytes_in += size
        self._waiting.append((topic_id, payload, log_time_ns, publish_time_ns))
        if waiting > _WRITTEN_AT_ONCE:
            self._wake.set()

    def interrupt(self) -> None:
        """Count no gap of `sequence` before the next message of each topic, as in `BagWriter.interrupt`."""
        if self._snapshot and self._recent:
            self._recent.append((_STEP, b"", self._recent[-1][2], 0))
            self._bytes_in += _OVERHEAD
        else:
            self._do(self._bag.interrupt)

    def split(self) -> None:
        """Go on in the next file, after the messages so far."""
        self._do(self._bag.split)

    def write_snapshot(self) -> int:
        """Write the messages of the last seconds, and older ones of transient local topics; returns how many.

        They are forgotten, so that none is written twice.
        """
        kept = [message for messages in self._transient_local.values() for message in messages]
        kept.sort(key=lambda message: message[2])
        kept += self._recent
        for messages in self._transient_local.values():
            messages.clear()
        self._recent.clear()
        self._do(self._bag.interrupt)
        self._waiting += [message if message[0] else (_STEP, self._bag.interrupt, 0, 0) for message in kept]
        self._do(self._bag.flush)
        return sum(message[0] != _STEP for message in kept)

    def check(self) -> None:
        """Raise an error that occurred in the thread.

        Raises
        ------
        AbraceError
            If the bag can't be written any more: it is closed as it is.
        """
        if self._failure:
            raise self._failure

    def close(self, lost: Mapping[int, int] | None = None) -> BagWriter:
        """Write all waiting messages and close the bag, which is returned. Closing again does nothing.

        Parameters
        ----------
        lost
            Messages that were published and did not come to `write`, by topic number.

        Raises
        ------
        AbraceError
            If the bag can't be written.
        """
        if not self._ending:
            self._do(partial(self._add_lost, [*self.overflowed.items(), *(lost or {}).items()]))
            self._ending = True
            self._wake.set()
        self._thread.join()
        self.check()
        return self._bag

    def _do(self, step: Callable[[], object]) -> None:
        """Have the thread take a step after the messages so far."""
        self._bytes_in += _OVERHEAD
        self._waiting.append((_STEP, step, 0, 0))
        self._wake.set()

    def _add_lost(self, lost: Iterable[tuple[int, int]]) -> None:
        for topic_id, count in lost:
            self._bag.add_lost(topic_id, count)

    def _run(self) -> None:
        try:
            self._write_all()
            self._bag.close()
        except Exception as error:
            unexpected = AbraceError(f"cannot write bag {self._bag.directory}: {error!r}")
            self._failure = error if isinstance(error, AbraceError) else unexpected
            self._salvage()

    def _write_all(self) -> None:
        """Write until the recording is closed and nothing waits."""
        flush_due = time.monotonic() + self._flush_interval
        sync_due = time.monotonic() + self._sync_interval
        while not self._ending or self._waiting:
            self._wake.wait(max(0.0, flush_due - time.monotonic()))
            self._wake.clear()
            self._write_waiting()
            now = time.monotonic()
            if now >= sync_due:
                self._bag.sync()
                sync_due = now + self._sync_interval
            elif now >= flush_due:
                self._bag.flush()
            if now >= flush_due:
                flush_due = now + self._flush_interval

    def _write_waiting(self) -> None:
        """Write waiting messages, at most as many as take a short time."""
        waiting, write = self._waiting, self._bag.write
        done = self._bytes_out
        end = done + _WRITTEN_AT_ONCE
        while waiting and done < end:
            topic_id, payload, log_time, publish_time = waiting[0]
            done += _OVERHEAD
            if callable(payload):
                payload()
            else:
                write(topic_id, payload, log_time, publish_time)
                done += len(payload)
            # what fails still waits: it is counted as lost
            waiting.popleft()
            self._bytes_out = done
        if waiting:
            self._wake.set()

    def _salvage(self) -> None:
        """After a failure, close the bag if possible; waiting messages are counted as lost in it."""
        lost = Counter(topic_id for topic_id, *_ in tuple(self._waiting) if topic_id != _STEP)
        with contextlib.suppress(Exception):
            self._add_lost((lost + self.overflowed).items())
        with contextlib.suppress(Exception):
            self._bag.close()

    def _time_of_sample(self, topic_id: int, payload: bytes) -> int:
        """The stamp of a message of the control loop; of others that of the last one."""
        if topic_id in self._stamped:
            try:
                self._sample_time = max(0, read_header(payload).stamp)
            except AbraceError:
                self.untimed[topic_id] += 1
        return self._sample_time

    def _drop_old(self, now: int) -> None:
        """Drop messages of a snapshot: older ones, more than fit, and those from before the clock was set back."""
        recent = self._recent
        while recent and (
            abs(now - recent[0][2]) > self._snapshot or self._bytes_in - self._bytes_out > self._capacity
        ):
            dropped = recent.popleft()
            kept = self._transient_local.get(dropped[0])
            if kept is not None:
                kept.append(dropped)
                if len(kept) <= TRANSIENT_LOCAL_KEPT:
                    continue
                dropped = kept.popleft()
            self._bytes_in -= len(dropped[1]) + _OVERHEAD


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
