# SPDX-License-Identifier: Apache-2.0
"""A pass through a bag, chunk by chunk: the content of each topic, and where its messages are.

Description, recovery, replay and export of bags of any length are based on this.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from abrace_bags.bag import open_bag
from abrace_bags.losses import is_numbered
from abrace_bags.mcap.chunk import MESSAGE_HEAD_SIZE
from abrace_bags.mcap.index import MessageFilter
from abrace_core.errors import AbraceError
from abrace_core.sequence import NumberRanges, clock_was_set_back

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from abrace_bags.bag import OpenedBag
    from abrace_bags.mcap.chunk import Messages
    from abrace_bags.mcap.file_reader import McapFile
    from abrace_bags.mcap.index import RecordedChannel
    from abrace_bags.other_storage import OtherStorage

_OUT_OF_TURN = 100_000_000
"""How far the times of several publishers' messages may step back [ns]; a larger step means a clock that was set
back."""
_LENGTH_OFFSET, _FRAME_OFFSET = MESSAGE_HEAD_SIZE + 12, MESSAGE_HEAD_SIZE + 16
"""Offsets in a message record of the length of the header's frame_id, and of its text."""


class RawMessage(NamedTuple):
    """A message: topic, serialised bytes, and when it was logged and published [ns]."""

    topic: str
    payload: bytes
    log_time: int
    publish_time: int


@dataclass
class TopicSurvey:
    """The content of one topic in a bag.

    Parameters
    ----------
    channel
        The first of its channels.
    count
        Messages.
    first_time, last_time
        Least and greatest of their log times [ns]; both 0 without a message.
    first_number
        `sequence` of the first message; None for topics that are not numbered.
    numbers
        All of them; None for topics that are not numbered.
    steps_back
        Whether log times step back.
    """

    channel: RecordedChannel
    count: int = 0
    first_time: int = 0
    last_time: int = 0
    first_number: int | None = None
    numbers: NumberRanges | None = None
    steps_back: bool = False
    _last: tuple[int, int] = field(default=(-1, -1), repr=False)

    def __post_init__(self) -> None:
        if is_numbered(self.channel.definition):
            self.numbers = NumberRanges()

    def set_edges(self, first_time: int, last_time: int, first_number: int | None) -> None:
        """Take what is found at both ends: `first_time`, `last_time` [ns], and `first_number`."""
        self.first_time, self.last_time = first_time, last_time
        self.first_number = None if self.numbers is None else first_number

    def add(self, messages: Messages) -> bool:
        """Add messages of this topic, in the order of the file; returns whether the clock was set back before them."""
        log_time = messages.log_time
        first, last = int(log_time.min()), int(log_time.max())
        self.first_time = min(self.first_time, first) if self.count else first
        self.last_time = max(self.last_time, last) if self.count else last
        before, number_before = self._last
        self.steps_back |= bool((np.diff(log_time, prepend=max(before, 0)) < -_OUT_OF_TURN).any())
        number, set_back = -1, False
        if self.numbers is not None:
            numbers = sequence_numbers(messages)
            if numbers.size:
                self.numbers.add(numbers)
                self.first_number = int(numbers[0]) if self.first_number is None else self.first_number
                number = int(numbers[-1])
            if numbers.size == log_time.size:
                times, sequence = log_time, numbers.astype(np.int64)
                if number_before >= 0:
                    times, sequence = np.append(before, times), np.append(number_before, sequence)
                set_back = clock_was_set_back(times, sequence)
        self.count += log_time.size
        self._last = int(log_time[-1]), number
        return set_back


@dataclass
class Survey:
    """The messages of a bag that a filter accepts.

    Parameters
    ----------
    opened
        The bag's files.
    message_filter
        Which messages.
    topics
        By name.
    places
        Of each file: where its chunks are that have some of the messages, and the least log time in each [ns].
    set_back
        Whether the clock was set back while the bag was recorded, by the numbers of its messages.
    """

    opened: OpenedBag
    message_filter: MessageFilter
    topics: dict[str, TopicSurvey] = field(default_factory=dict)
    places: list[tuple[array[int], array[int]]] = field(default_factory=list)
    set_back: bool = False

    @property
    def count(self) -> int:
        """Messages."""
        return sum(topic.count for topic in self.topics.values())

    def messages(self) -> Iterator[RawMessage]:
        """All messages in the order of their log times, those of one time in the order in which they were written.

        Where the clock was set back, they come in the order in which they were written.
        """
        if self.set_back or any(file.in_time_order for file in self.opened.files):
            return self.as_written()
        return self._by_time()

    def as_written(self) -> Iterator[RawMessage]:
        """All messages in the order in which they were written."""
        for file, (offsets, _) in zip(self.opened.files, self.places, strict=True):
            for messages in file.chunks_at(offsets, self.message_filter):
                yield from raw_messages(file, messages)

    def _by_time(self) -> Iterator[RawMessage]:
        """A chunk is read when its first message is due: only those are in memory that overlap."""
        starts = np.concatenate([np.array(times, np.int64) for _, times in self.places])
        files = np.repeat(np.arange(len(self.places)), [len(times) for _, times in self.places])
        offsets = np.concatenate([np.array(offsets, np.uint64) for offsets, _ in self.places])
        waiting: list[tuple[int, int, int, RawMessage]] = []
        for place in np.argsort(starts, kind="stable").tolist():
            due = bisect_left(waiting, (int(starts[place]),))
            if due:
                yield from [message for _, _, _, message in waiting[:due]]
                del waiting[:due]
            file = self.opened.files[int(files[place])]
            for messages in file.chunks_at([int(offsets[place])], self.message_filter):
                waiting += [(one.log_time, place, k, one) for k, one in enumerate(raw_messages(file, messages))]
            waiting.sort()
        yield from [message for _, _, _, message in waiting]


def survey(
    bag: Path | str,
    accepts: Callable[[RecordedChannel], bool] = lambda _: True,
    begin: int | None = None,
    end: int | None = None,
) -> Survey:
    """Go through the messages of a `bag`; what is missing and damaged is in the `warnings` of its files.

    Parameters
    ----------
    bag
        A bag directory or a single file.
    accepts
        Whether to take a channel's messages.
    begin, end
        Log times [ns], `begin` included, `end` not; None: from the first, to the last.

    Raises
    ------
    AbraceError
        If there is no such bag, or it can't be read.
    """
    found = Survey(open_bag(bag), MessageFilter(accepts, begin, end))
    for file in found.opened.files:
        offsets, times = array("Q"), array("q")
        found.places.append((offsets, times))
        deferred = []
        for messages in file.chunks(found.message_filter):
            if not messages.begins.size:
                continue
            offsets.append(messages.offset)
            times.append(int(messages.log_time.min()))
            if np.isin(messages.channel_ids, list(file.channels)).all():
                _add(found, file, messages)
            else:  # in a damaged file, whose first chunk described their channels
                deferred.append(messages.offset)
        for messages in file.chunks_at(deferred, found.message_filter):
            _add(found, file, messages)
        for channel in file.channels.values():
            if accepts(channel):
                found.topics.setdefault(channel.topic, TopicSurvey(channel))
    return found


def _add(found: Survey, file: McapFile | OtherStorage, messages: Messages) -> None:
    for channel_id in np.flatnonzero(np.bincount(messages.channel_ids)).tolist():
        if channel_id in file.channels:
            channel = file.channels[channel_id]
            topic = found.topics.setdefault(channel.topic, TopicSurvey(channel))
            found.set_back |= topic.add(messages.chosen(messages.channel_ids == channel_id))


def first_time(opened: OpenedBag, accepts: Callable[[RecordedChannel], bool]) -> int | None:
    """The least log time [ns] of the messages of an `opened` bag's channels that `accepts`; None without a message."""
    parts = [one.log_time for file in opened.files for one in file.edge(MessageFilter(accepts), last=False)]
    return min((int(times.min()) for times in parts if times.size), default=None)


def _last_time(opened: OpenedBag, accepts: Callable[[RecordedChannel], bool]) -> int:
    parts = [one.log_time for file in opened.files for one in file.edge(MessageFilter(accepts), last=True)]
    return max(int(times.max()) for times in parts if times.size)


def time_range(
    bag: Path | str, accepts: Callable[[RecordedChannel], bool], start_offset: float, duration: float
) -> tuple[int | None, int | None]:
    """Log times [ns] between which a part of a `bag` lies; None: from the first message, to the last.

    `accepts` says whose messages these are, `start_offset` [s] counts from the first, a `duration` [s] of 0 is to the
    end.

    Raises
    ------
    AbraceError
        If there are messages, but none that late.
    """
    if not start_offset and not duration:
        return None, None
    opened = open_bag(bag)
    first = first_time(opened, accepts)
    if first is None:
        return None, None
    begin = first + round(start_offset * 1e9)
    last = _last_time(opened, accepts)
    if begin > last:
        raise no_message(bag, start_offset, duration, last - first)
    return begin, begin + round(duration * 1e9) if duration else None


def no_message(bag: Path | str, start_offset: float, duration: float, span: int) -> AbraceError:
    """The error of a part of a `bag` without a message: from `start_offset` [s], of a `duration` [s]; `span` [ns]."""
    part = f"{start_offset:g} s to {f'{start_offset + duration:g} s' if duration else 'the end'}"
    return AbraceError(f"{bag}: there is no message from {part}, its messages span {span * 1e-9:.3f} s")


def edges(opened: OpenedBag, name: str) -> tuple[int, int, int | None]:
    """Least and greatest log time [ns] of the topic `name` of an `opened` bag, and its first `sequence`, if any."""
    message_filter = MessageFilter(lambda channel: channel.topic == name)
    first = last = number = None
    for file in opened.files:
        for messages in file.edge(message_filter, last=False):
            times = messages.log_time
            if times.size and (first is None or times.min() < first):
                first = int(times.min())
                numbers = sequence_numbers(messages.chosen(np.array([times.argmin()])))
                number = int(numbers[0]) if numbers.size else None
        for messages in file.edge(message_filter, last=True):
            times = messages.log_time
            if times.size and (last is None or times.max() > last):
                last = int(times.max())
    return first or 0, last or 0, number


def raw_messages(file: McapFile | OtherStorage, messages: Messages) -> list[RawMessage]:
    """The `messages` of a chunk of a `file`, one by one."""
    known = np.isin(messages.channel_ids, list(file.channels))
    messages = messages if known.all() else messages.chosen(known)
    topics = [file.channels[number].topic for number in messages.channel_ids.tolist()]
    times = messages.log_time.tolist(), messages.publish_time.tolist()
    return list(map(RawMessage, topics, messages.payloads(), *times))


def sequence_numbers(messages: Messages) -> NDArray[np.uint64]:
    """The `sequence` of numbered messages, without those that are too short to have one."""
    messages = messages.chosen(messages.sizes >= _FRAME_OFFSET)
    # the number follows the frame_id, aligned to 8 bytes from the end of the encapsulation's 4 bytes
    text_end = messages.numbers("<u4", _LENGTH_OFFSET).astype(np.int64) + _FRAME_OFFSET - MESSAGE_HEAD_SIZE
    offset = MESSAGE_HEAD_SIZE + text_end + (4 - text_end) % 8
    fits = offset + 8 <= messages.sizes
    numbers: NDArray[np.uint64] = messages.chosen(fits).numbers("<u8", offset[fits])
    return numbers
