# SPDX-License-Identifier: Apache-2.0
"""Serialised messages of a bag of any length: a first pass finds what is there, a second gives the messages.

Replay, recovery, export to CSV and the description of a bag are based on this. No more than some chunks are in memory.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from abrace_bags.mcap.contents import TopicContent
from abrace_bags.topics import every_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from abrace_bags.mcap.bag_file import BagFile
    from abrace_bags.mcap.chunk import Messages
    from abrace_bags.topics import RecordedTopic, Selection


class RawMessage(NamedTuple):
    """A message: topic, serialised bytes, and when it was logged and published [ns]."""

    topic: str
    payload: bytes
    log_time: int
    publish_time: int


class RawMessages:
    """The messages of a `selection` in the `files` of a bag with these `facts`.

    Iterating gives them in the order of their log times. Those of one time come in the order in which they were
    written; a log time never steps back. Each iteration begins anew.

    Attributes
    ----------
    topics
        By name; also those that have no message in that time.
    contents
        By the name of each topic: how many messages, their times and numbers.
    first, last
        Log times of the first and the last message [ns]; both 0 without a message.
    set_back
        Whether the clock was set back during the recording: messages then come in the order of the file.
    warnings
        What is missing or can't be trusted, one sentence each.
    """

    def __init__(self, files: Sequence[BagFile], selection: Selection, facts: Mapping[str, str]) -> None:
        self._files, self._selection, self._facts = files, selection, facts
        self._places: list[tuple[array[int], array[int]]] = []
        self.topics: dict[str, RecordedTopic] = selection.topics
        self.contents: dict[str, TopicContent] = {}
        self.set_back = False
        self.warnings: tuple[str, ...] = ()
        for file in files:
            self._go_through(file)
        edges = [(one.first_time or 0, one.last_time or 0) for one in self.contents.values() if one.messages]
        self.first, self.last = min((one for one, _ in edges), default=0), max((one for _, one in edges), default=0)
        if self.set_back:
            self.first = next(iter(self)).log_time
            self.last = max(message.log_time for message in self)

    @property
    def count(self) -> int:
        """Messages."""
        return sum(content.messages for content in self.contents.values())

    def __iter__(self) -> Iterator[RawMessage]:
        return continuous(self.as_written()) if self.set_back else self._by_time()

    def as_written(self) -> Iterator[RawMessage]:
        """All messages in the order in which they were written."""
        for file, (offsets, _) in zip(self._files, self._places, strict=True):
            for messages in file.chunks_at(offsets, self._selection):
                yield from self._raw(file, messages)

    def _go_through(self, file: BagFile) -> None:
        offsets, times = array("Q"), array("q")
        self._places.append((offsets, times))
        deferred = []
        for messages in file.chunks(self._selection):
            if not messages.begins.size:
                continue
            offsets.append(messages.offset)
            times.append(int(messages.log_time.min()))
            if np.isin(messages.channel_ids, list(file.channels)).all():
                self._add(file, messages)
            else:  # in a damaged file, whose first chunk described their channels
                deferred.append(messages.offset)
        for messages in file.chunks_at(deferred, self._selection):
            self._add(file, messages)
        for channel in file.channels.values():
            if self._selection.accepts(channel):
                self._content(channel)

    def _content(self, channel: RecordedTopic) -> TopicContent:
        if channel.name not in self.contents:
            self.contents[channel.name] = TopicContent.of(channel.definition, every_of(self._facts, channel.name))
        return self.contents[channel.name]

    def _add(self, file: BagFile, messages: Messages) -> None:
        for channel_id, some in messages.by_channel():
            channel = file.channels.get(channel_id)
            if channel is not None and self._selection.accepts(channel):
                self.set_back |= self._content(channel).read(some)

    def _by_time(self) -> Iterator[RawMessage]:
        """A chunk is read when its first message is due: only those are in memory that overlap."""
        places = sorted(
            (start, number, offset)
            for number, (offsets, starts) in enumerate(self._places)
            for offset, start in zip(offsets, starts, strict=True)
        )
        waiting: list[tuple[int, int, int, RawMessage]] = []
        for place, (start, number, offset) in enumerate(places):
            due = bisect_left(waiting, (start,))
            if due:
                yield from [message for _, _, _, message in waiting[:due]]
                del waiting[:due]
            file = self._files[number]
            for messages in file.chunks_at([offset], self._selection):
                waiting += [(one.log_time, place, k, one) for k, one in enumerate(self._raw(file, messages))]
            waiting.sort()
        yield from [message for _, _, _, message in waiting]

    def _raw(self, file: BagFile, messages: Messages) -> list[RawMessage]:
        """The `messages` of a chunk of a `file`, one by one."""
        known = {number: one.name for number, one in file.channels.items() if self._selection.accepts(one)}
        wanted = np.isin(messages.channel_ids, list(known))
        messages = messages if wanted.all() else messages.chosen(wanted)
        topics = [known[number] for number in messages.channel_ids.tolist()]
        times = messages.log_time.tolist(), messages.publish_time.tolist()
        return list(map(RawMessage, topics, messages.payloads(), *times))


def continuous(messages: Iterable[RawMessage]) -> Iterator[RawMessage]:
    """The `messages` in their order, their log times shifted from each on that was logged before the last one."""
    shift, last = 0, None
    for message in messages:
        if last is not None and message.log_time + shift < last:
            shift = last - message.log_time
        last = message.log_time + shift
        yield message._replace(log_time=last)
