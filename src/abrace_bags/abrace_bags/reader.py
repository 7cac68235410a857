# SPDX-License-Identifier: Apache-2.0
"""Bags to arrays: whole topics at a time, from our bags and rosbag2's, also when they were cut off or lack files."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_bags.bag import in_brackets, missing_messages, open_bag, read_facts, topic_names
from abrace_bags.cdr import decode, undecodable
from abrace_bags.definitions import is_same_type, parse_message_type
from abrace_bags.mcap.chunk import LOG_TIME, MESSAGE_HEAD_SIZE, PUBLISH_TIME
from abrace_bags.mcap.index import MessageFilter
from abrace_core.errors import AbraceError
from abrace_core.sequence import NumberRanges, are_interleaved, clock_was_set_back

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from abrace_bags.definitions import MessageType
    from abrace_bags.mcap.chunk import Messages
    from abrace_bags.mcap.index import RecordedChannel

__all__ = ["BagContents", "TopicArrays", "read_facts", "read_selected", "read_topics", "topic_names"]


@dataclass(frozen=True)
class TopicArrays:
    """All messages of one topic, in the order of their log times.

    Parameters
    ----------
    type_name
        As `abrace_interfaces/msg/Response`.
    fields
        By field, nested names joined by dots: (messages, ...) numbers or str. An array of objects, one a message, where
        the messages' shapes differ.
    log_time, publish_time
        (messages,) [ns].
    """

    type_name: str
    fields: dict[str, NDArray[Any]]
    log_time: NDArray[np.int64]
    publish_time: NDArray[np.int64]


class BagContents(dict[str, TopicArrays]):
    """Topics of a bag by name.

    Parameters
    ----------
    topics
        What was read.
    facts
        The run's facts (rig, controller, record); empty where the bag has none.
    warnings
        What is missing or can't be trusted, one sentence each; empty for a whole bag.
    records
        Its metadata records: texts by key, by the record's name.
    attachments
        Files that are in it, by name.
    """

    def __init__(
        self,
        topics: dict[str, TopicArrays],
        facts: dict[str, str],
        warnings: tuple[str, ...],
        records: dict[str, dict[str, str]],
        attachments: dict[str, bytes],
    ) -> None:
        super().__init__(topics)
        self.facts = facts
        self.warnings = warnings
        self.records = records
        self.attachments = attachments


def read_topics(
    bag: Path | str, topics: Collection[str] | None = None, begin: int | None = None, end: int | None = None
) -> BagContents:
    """Read topics of a bag; of files with a summary section, only chunks that may hold requested messages.

    Parameters
    ----------
    bag
        A bag directory or a single MCAP file.
    topics
        Names of the topics to read; all when None.
    begin, end
        Log times of the messages to read [ns], `begin` included, `end` not; None: from the first, to the last.

    Returns
    -------
    BagContents
        The topics, with the run's facts and what is missing.

    Raises
    ------
    AbraceError
        If there is no such bag, it isn't one, a topic asked for is not in it, or messages do not fit their definition.
    """
    contents = read_selected(bag, lambda channel: topics is None or channel.topic in topics, begin, end)
    missing = sorted(set(topics or ()) - set(contents))
    if missing:
        named = ", ".join(sorted(topic_names(bag))) or "none"
        raise AbraceError(
            f"{bag}: no topic {missing[0]} in it{in_brackets(contents.warnings)}, expected one of {named}"
        )
    return contents


def read_selected(
    bag: Path | str, accepts: Callable[[RecordedChannel], bool], begin: int | None = None, end: int | None = None
) -> BagContents:
    """Read the topics of a bag by more than their names: those of which `accepts` accepts a channel.

    `bag`, `begin`, `end` and what is returned and raised are as for `read_topics`.
    """
    opened = open_bag(bag)
    channels: dict[str, list[tuple[RecordedChannel, Stream | None]]] = {}
    for file in opened.files:
        streams: dict[int, Stream] = {}
        for messages in file.chunks(MessageFilter(accepts, begin, end)):
            for channel_id in np.flatnonzero(np.bincount(messages.channel_ids)).tolist():
                streams.setdefault(channel_id, Stream()).append(messages, messages.channel_ids == channel_id)
        for channel_id, channel in file.channels.items():
            if accepts(channel):
                channels.setdefault(channel.topic, []).append((channel, streams.get(channel_id)))
    warnings = opened.warnings
    topics = {}
    for topic, recorded in channels.items():
        try:
            topics[topic], notes = _topic(recorded)
            warnings += [f"{bag}: topic {topic}: {note}" for note in notes]
        except AbraceError as error:
            warnings.append(f"{bag}: topic {topic} is left out: {error}")
    if opened.uncounted:
        warnings += [f"{bag}: {missing_messages(topic, _ranges(arrays))}" for topic, arrays in topics.items()]
    attachments = {attachment.name: attachment.data for attachment in opened.attachments}
    return BagContents(topics, opened.facts, tuple(warnings), opened.records, attachments)


def _ranges(messages: TopicArrays) -> NumberRanges | None:
    sequence = sequence_in(messages.fields)
    if sequence is None:
        return None
    ranges = NumberRanges()
    ranges.add(sequence)
    return ranges


class Stream:
    """Messages of one channel of a file, by their lengths: those of one length are decoded together.

    Attributes
    ----------
    count
        How many.
    """

    def __init__(self) -> None:
        self.count = 0
        self._blocks: dict[int, list[tuple[NDArray[np.int64], NDArray[np.void]]]] = {}

    def append(self, messages: Messages, which: NDArray[np.bool_]) -> None:
        """Add those of a chunk's `messages` that `which` (messages,) says."""
        begins, sizes = (
            (messages.begins, messages.sizes) if which.all() else (messages.begins[which], messages.sizes[which])
        )
        numbers = np.arange(self.count, self.count + begins.size)
        self.count += begins.size
        for size in np.unique(sizes).tolist():
            of_size = sizes == size
            # a record at every byte of the chunk, of which those that are records are copied
            everywhere = np.ndarray((len(messages.records) - size + 1,), f"V{size}", messages.records, strides=(1,))
            self._blocks.setdefault(size, []).append((numbers[of_size], everywhere[begins[of_size]]))

    def times(self, offset: int) -> NDArray[np.int64]:
        """(messages,) [ns], of which each record has one at `offset`."""
        times = np.empty(self.count, np.int64)
        for size, blocks in self._blocks.items():
            for numbers, records in blocks:
                times[numbers] = _fields(records, size, "<i8", offset)
        return times

    def payloads(self) -> list[tuple[NDArray[np.int64], NDArray[np.void]]]:
        """For each length that occurs: numbers of the messages, and their bytes."""
        payloads = []
        for size, blocks in self._blocks.items():
            records = np.concatenate([records for _, records in blocks])
            payload = _fields(records, size, f"V{size - MESSAGE_HEAD_SIZE}", MESSAGE_HEAD_SIZE)
            payloads.append((np.concatenate([numbers for numbers, _ in blocks]), payload))
        return payloads


def _fields(records: NDArray[np.void], size: int, form: str, offset: int) -> NDArray[Any]:
    """One field of message records of `size` bytes, without a copy."""
    return records.view(np.dtype({"names": ["field"], "formats": [form], "offsets": [offset], "itemsize": size}))[
        "field"
    ]


def _topic(recorded: list[tuple[RecordedChannel, Stream | None]]) -> tuple[TopicArrays, list[str]]:
    """All messages of one topic, from its channels in all files, and the warnings about them."""
    message_type = common_type([channel for channel, _ in recorded])
    streams = [stream for _, stream in recorded if stream is not None]
    count = 0
    payloads = []
    for stream in streams:
        payloads += [(numbers + count, block) for numbers, block in stream.payloads()]
        count += stream.count
    none = [np.empty(0, np.int64)]
    log_time = np.concatenate(none + [stream.times(LOG_TIME) for stream in streams])
    publish_time = np.concatenate(none + [stream.times(PUBLISH_TIME) for stream in streams])
    fields, fits, notes = decode_fitting(message_type, payloads, count)
    order, note = _order(log_time[fits], sequence_in(fields))
    if order is not None:
        fields = {name: values[order] for name, values in fields.items()}
    chosen = fits if order is None else np.flatnonzero(fits)[order]
    return TopicArrays(recorded[0][0].type_name, fields, log_time[chosen], publish_time[chosen]), notes + note


def common_type(channels: Sequence[RecordedChannel]) -> MessageType:
    """The type of the messages of a topic's `channels`, at least one.

    Raises
    ------
    AbraceError
        If they have several, or are not CDR described by .msg texts.
    """
    described = channels[0].type_name, channels[0].definition
    for other in channels:
        if not is_same_type(described, (other.type_name, other.definition)):
            raise AbraceError(f"has messages of {described[0]} and another {other.type_name}, expected one")
        if (other.message_encoding, other.schema_encoding) != ("cdr", "ros2msg"):
            encodings = f"{other.message_encoding!r} described by {other.schema_encoding!r}"
            raise AbraceError(f"is written as {encodings}, expected 'cdr' described by 'ros2msg'")
    return parse_message_type(*described)


def decode_fitting(
    message_type: MessageType, payloads: Sequence[tuple[NDArray[np.int64], NDArray[np.void]]], count: int
) -> tuple[dict[str, NDArray[Any]], NDArray[np.bool_], list[str]]:
    """Decode those of `count` messages that fit their type; `message_type` and `payloads` are as for `decode`.

    Returns
    -------
    tuple
        The fields, (messages,) which messages fit, and a sentence if not all do.

    Raises
    ------
    AbraceError
        If none fits.
    """
    fits = np.ones(count, bool)
    try:
        return decode(message_type, payloads), fits, []
    except AbraceError as error:
        fits[undecodable(message_type, payloads)] = False
        if not fits.any():
            raise
        note = f"{count - fits.sum()} of {count} messages are left out: {error}"
        renumbered = np.cumsum(fits) - 1
        kept = [(renumbered[numbers[fits[numbers]]], block[fits[numbers]]) for numbers, block in payloads]
        return decode(message_type, [part for part in kept if len(part[0])]), fits, [note]


def _order(log_time: NDArray[np.int64], sequence: NDArray[Any] | None) -> tuple[NDArray[np.intp] | None, list[str]]:
    """The order of messages, None as they are, and the warning about it.

    It is that of their log times, unless their numbers show that the clock was set back while they were recorded.
    """
    order = None if (log_time[1:] >= log_time[:-1]).all() else np.argsort(log_time, kind="stable")
    if sequence is None:
        return order, []
    if order is not None and clock_was_set_back(log_time, sequence):
        return None, ["the clock was set back during the recording: messages are in the order of their recording"]
    numbers = sequence if order is None else sequence[order]
    if are_interleaved(numbers):
        by_number = np.argsort(sequence, kind="stable")
        return by_number, ["its log times are not in the order of its numbers: messages are in that of the numbers"]
    return order, []


def sequence_in(fields: Mapping[str, NDArray[Any]]) -> NDArray[Any] | None:
    """The `sequence` in the `fields` of messages (messages,); None where there is none, or no message."""
    sequence = fields.get("sequence")
    if sequence is None or sequence.dtype.kind not in "iu" or sequence.ndim > 1 or not sequence.size:
        return None
    return sequence
