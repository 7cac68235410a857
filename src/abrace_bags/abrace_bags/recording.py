# SPDX-License-Identifier: Apache-2.0
"""A bag recorded from live topics: one thread receives the messages, another writes them."""

from __future__ import annotations

import contextlib
import struct
import threading
import time
from collections import Counter
from typing import TYPE_CHECKING

from abrace_bags.mcap.contents import is_numbered
from abrace_core import AbraceError
from abrace_core.safety.wire import read_header

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from rosbags.interfaces import Qos

    from abrace_bags.writer import BagWriter

    Message = tuple[int, bytes, int, int]
    """Number of the topic, payload, when it was received and when published [ns]."""

CAPACITY = 128 * 1024 * 1024
"""Bytes that may wait to be written, and as many again that are being written."""
SAMPLE_TYPES = (
    "abrace_interfaces/msg/Response",
    "abrace_interfaces/msg/BraceCommand",
    "geometry_msgs/msg/AccelStamped",
)
"""Messages of the control loop, whose stamps are the times of the rig's samples."""
_WRITTEN_AT_ONCE = 4 * 1024 * 1024
"""Waiting bytes that wake the thread before the next flush."""
_NUMBER = struct.Struct("<Q")
_OVERHEAD = 200
"""Bytes of memory that a waiting message takes in addition to its own."""


class Recording:
    """A bag that a thread writes: a slow disk, a sync or a large chunk does not delay the receiving thread.

    Messages wait in one of two buffers, as in rosbag2's `MessageCache`: the thread takes it, leaves an empty one in its
    place, and writes what it took. Messages that arrive while `capacity` bytes wait are dropped and counted.

    Whatever fails in the thread ends the recording: the bag is closed with what was written, `check` raises.

    Parameters
    ----------
    bag
        The bag, without topics; from here on only this object uses it.
    flush_interval
        Seconds between flushes: what is lost when the process is killed.
    sync_interval
        Seconds between syncs: what is lost in a power loss, in addition to a flush interval.
    capacity
        Bytes that may wait.
    lockstep
        Whether the log time is the rig's: the stamp of `SAMPLE_TYPES`, of other messages that of the last such one.

    Attributes
    ----------
    dropped
        Messages that were not written, by topic number: the disk is too slow, or has failed.
    untimed
        Messages that came without a valid time, by topic number.
    """

    def __init__(
        self,
        bag: BagWriter,
        flush_interval: float,
        *,
        sync_interval: float = 0.5,
        capacity: int = CAPACITY,
        lockstep: bool = False,
    ) -> None:
        self.dropped: Counter[int] = Counter()
        self.untimed: Counter[int] = Counter()
        self._bag = bag
        self._flush_interval, self._sync_interval = flush_interval, sync_interval
        self._capacity = capacity
        self._lockstep = lockstep
        self._sample_time = 0
        self._stamped: set[int] = set()
        self._topic_count = 0
        self._lock = threading.Lock()
        self._topics: list[tuple[str, str, str, str, *tuple[Qos, ...]]] = []
        self._waiting: list[Message] = []
        self._size = 0
        self._wake = threading.Event()
        self._lost: Mapping[int, int] = {}
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
        with self._lock:
            self._topics.append((name, type_name, definition_text, type_hash, *qos))
        self._topic_count += 1
        if type_name in SAMPLE_TYPES:
            self._stamped.add(self._topic_count)
        return self._topic_count

    def write(self, topic_id: int, payload: bytes, log_time_ns: int, publish_time_ns: int) -> None:
        """Record a message, as in `BagWriter.write`, or drop it.

        The middleware gives -1 and -2 for a time that it doesn't know: the time of reception is then now, that of
        publishing the time of reception.
        """
        if log_time_ns < 0 or publish_time_ns < 0:
            self.untimed[topic_id] += 1
            log_time_ns = log_time_ns if log_time_ns >= 0 else time.time_ns()
            publish_time_ns = publish_time_ns if publish_time_ns >= 0 else log_time_ns
        if self._lockstep:
            log_time_ns = self._time_of_sample(topic_id, payload)
        with self._lock:
            size = self._size + len(payload) + _OVERHEAD
            if size > self._capacity:
                self.dropped[topic_id] += 1
                return
            self._size = size
            self._waiting.append((topic_id, payload, log_time_ns, publish_time_ns))
        if size > _WRITTEN_AT_ONCE:
            self._wake.set()

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
            self._lost = lost or {}
            self._ending = True
            self._wake.set()
        self._thread.join()
        self.check()
        return self._bag

    def _run(self) -> None:
        try:
            self._write_all()
            self._count_lost()
            self._bag.close()
        except Exception as error:
            unexpected = AbraceError(f"cannot write bag {self._bag.directory}: {error!r}")
            self._failure = error if isinstance(error, AbraceError) else unexpected
            self.dropped.update(topic_id for topic_id, *_ in self._waiting)
            with contextlib.suppress(Exception):
                self._count_lost()
            with contextlib.suppress(Exception):
                self._bag.close()

    def _write_all(self) -> None:
        """Write until the recording is closed and nothing waits."""
        self._flush_due = time.monotonic() + self._flush_interval
        self._sync_due = time.monotonic() + self._sync_interval
        ending = False
        while not ending:
            self._wake.wait(max(0.0, self._flush_due - time.monotonic()))
            self._wake.clear()
            # before the buffers change places: the last ones have everything
            ending = self._ending
            with self._lock:
                topics, self._topics = self._topics, []
                messages, self._waiting = self._waiting, []
                self._size = 0
            written = 0
            try:
                for topic in topics:
                    self._bag.add_topic(*topic)
                for message in messages:
                    self._bag.write(*message)
                    written += 1
                    if time.monotonic() >= self._flush_due:
                        self._flush()
            except Exception:
                self.dropped.update(topic_id for topic_id, *_ in messages[written:])
                raise
            if time.monotonic() >= self._flush_due:
                self._flush()

    def _flush(self) -> None:
        """Flush the bag, or sync it if that is due."""
        now = time.monotonic()
        if now < self._sync_due:
            self._bag.flush()
        else:
            self._bag.sync()
            self._sync_due = now + self._sync_interval
        self._flush_due = now + self._flush_interval

    def _count_lost(self) -> None:
        for topic_id, count in (self.dropped + Counter(self._lost)).items():
            self._bag.add_lost(topic_id, count)

    def _time_of_sample(self, topic_id: int, payload: bytes) -> int:
        """The stamp of a message of the control loop; of others that of the last one."""
        if topic_id in self._stamped:
            try:
                self._sample_time = max(0, read_header(payload).stamp)
            except AbraceError:
                self.untimed[topic_id] += 1
        return self._sample_time


class EveryNth:
    """Keeps one of `every` messages of a topic: those whose number it divides.

    That is the `sequence` of messages that begin with a header and one, by the `definition` (.msg) of their type;
    others are counted from 0 on. A message that has no number where it is expected is kept.
    """

    def __init__(self, every: int, definition: str) -> None:
        self._every = every
        self._numbered = is_numbered(definition)
        self._last = -1

    def add(self, payload: bytes, missing: int) -> tuple[bool, int]:
        """Whether the message of a `payload` is kept, and how many of the `missing` just before it would have been."""
        number = self._last + 1 + missing
        if self._numbered:
            try:
                (number,) = _NUMBER.unpack_from(payload, read_header(payload).offset)
            except (AbraceError, struct.error):
                return True, missing
        last, self._last = self._last, number
        between = (number - 1) // self._every - last // self._every if number > last else 0
        return number % self._every == 0, min(missing, between)


def parse_every(texts: Sequence[str]) -> dict[str, int]:
    """Of how many messages of a topic one is to be kept, by its name as given, from `texts` of the form topic=n.

    Raises
    ------
    AbraceError
        If a text is not of this form, or a topic comes twice.
    """
    found: dict[str, int] = {}
    for text in texts:
        topic, _, number = text.rpartition("=")
        if not topic or not (number.isascii() and number.isdecimal()) or int(number) < 1:
            raise AbraceError(f"parameter every: {text!r}, expected topic=n, one of n messages, as response=5")
        if topic in found:
            raise AbraceError(f"parameter every: {texts}, expected each topic once")
        found[topic] = int(number)
    return found


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
