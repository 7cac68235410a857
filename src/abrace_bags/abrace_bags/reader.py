# SPDX-License-Identifier: Apache-2.0
"""Messages of a bag to arrays: whole topics at a time, or a topic of any length part by part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_bags.cdr import decode, decode_each
from abrace_bags.definitions import parse_message_type
from abrace_bags.mcap.chunk import LOG_TIME, MESSAGE_HEAD_SIZE, PUBLISH_TIME, gather
from abrace_bags.sequence import NumberRanges, are_interleaved, clock_was_set_back
from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_bags.cdr import Decoded
    from abrace_bags.definitions import MessageType
    from abrace_bags.mcap.bag_file import BagFile
    from abrace_bags.mcap.chunk import Messages
    from abrace_bags.raw import RawMessage, RawMessages
    from abrace_bags.topics import RecordedTopic, Selection

PART = 10_000
"""Messages in a part."""
PART_SIZE = 1 << 22
"""Bytes of messages in a part, about."""


@dataclass(frozen=True)
class TopicArrays:
    """Messages of one topic, in the order of their log times.

    Parameters
    ----------
    type_name
        As `abrace_interfaces/msg/Response`.
    fields
        By field, nested names joined by dots: (messages, ...) numbers or str. An array of objects, one a message, where
        the messages' shapes differ, and of str objects where texts are long.
    log_time, publish_time
        (messages,) [ns].
    """

    type_name: str
    fields: dict[str, NDArray[Any]]
    log_time: NDArray[np.int64]
    publish_time: NDArray[np.int64]


def read_arrays(
    files: Sequence[BagFile], selection: Selection
) -> tuple[dict[str, TopicArrays], dict[str, str], list[str], list[str]]:
    """Read the messages of a `selection` in the `files` of a bag.

    Returns
    -------
    tuple
        The topics by name; why others can't be decoded, by name; of those that can, what is left out, and what is wrong
        with the order of their log times.
    """
    records: list[bytes] = []
    places: dict[str, list[tuple[NDArray[np.int64], NDArray[np.int64]]]] = {}
    size = 0
    for file in files:
        read: list[tuple[int, Messages]] = []
        for chunk in file.chunks(selection):
            messages = chunk.compact()
            read.append((size, messages))
            records.append(messages.records)
            size += len(messages.records)
        # in a damaged file a channel may be known only now
        for channel in file.channels.values():
            if selection.accepts(channel):
                places.setdefault(channel.name, [])
        for offset, messages in read:
            for number, some in messages.by_channel():
                if number in file.channels and selection.accepts(file.channels[number]):
                    places[file.channels[number].name].append((some.begins + offset, some.sizes))
    content = b"".join(records)
    del records
    found, failed, missing, disorder = {}, {}, [], []
    for name, parts in places.items():
        none = np.empty(0, np.int64)
        begins, sizes = (np.concatenate([none, *(part[k] for part in parts)]) for k in (0, 1))
        try:
            found[name], lost, order = _topic(selection.topics[name], content, begins, sizes)
            missing += [f"{name}: {text}" for text in lost]
            disorder += [f"{name}: {text}" for text in order]
        except AbraceError as error:
            failed[name] = str(error)
    return found, failed, missing, disorder


def _topic(
    topic: RecordedTopic, content: bytes, begins: NDArray[np.int64], sizes: NDArray[np.int64]
) -> tuple[TopicArrays, list[str], list[str]]:
    """The messages whose records are at `begins` in `content`, what is left out, and what is wrong with their order."""
    decoded = decode(type_of(topic), content, begins + MESSAGE_HEAD_SIZE, begins + sizes)
    fields, fits = decoded.fields, begins[decoded.fits] if decoded.misfit else begins
    log_time, publish_time = (gather(content, "<i8", fits + offset) for offset in (LOG_TIME, PUBLISH_TIME))
    order, notes = _order(log_time, sequence_in(fields))
    if order is not None:
        fields = {name: values[order] for name, values in fields.items()}
        log_time, publish_time = log_time[order], publish_time[order]
    return TopicArrays(topic.type_name, fields, log_time, publish_time), left_out(decoded, len(begins)), notes


def left_out(decoded: Decoded, count: int) -> list[str]:
    """A sentence if not all of `count` messages were `decoded`."""
    if not decoded.misfit:
        return []
    return [f"{count - len(decoded.fits)} of {count} messages are left out: {decoded.misfit}"]


def type_of(topic: RecordedTopic) -> MessageType:
    """The type of a `topic`'s messages.

    Raises
    ------
    AbraceError
        If its definition can't be read, or they are not written as CDR.
    """
    if topic.message_encoding != "cdr":
        raise AbraceError(f"its messages are written as {topic.message_encoding!r}, expected 'cdr'")
    return parse_message_type(topic.type_name, topic.definition, topic.schema_encoding)


class TopicParts:
    """Messages of one topic as arrays, part by part in the order in which `raw` has them; at least one part.

    Parameters
    ----------
    messages
        Of one topic.

    Attributes
    ----------
    warnings
        What is missing or can't be trusted, one sentence each; complete after the last part.

    Raises
    ------
    AbraceError
        If the messages can't be decoded.
    """

    def __init__(self, messages: RawMessages) -> None:
        self._messages = messages
        (self._topic,) = messages.topics.values()
        self._type = type_of(self._topic)
        self.warnings = list(messages.warnings)

    def __iter__(self) -> Iterator[TopicArrays]:
        part: list[RawMessage] = []
        parts = size = 0
        for message in self._messages:
            if len(part) == PART or size > PART_SIZE:
                yield self._arrays(part)
                part, parts, size = [], parts + 1, 0
            part.append(message)
            size += len(message.payload)
        if part or not parts:
            yield self._arrays(part)

    def _arrays(self, part: list[RawMessage]) -> TopicArrays:
        try:
            decoded = decode_each(self._type, [message.payload for message in part])
        except AbraceError as error:
            raise AbraceError(f"topic {self._topic.name}: {error}") from error
        self.warnings += [f"topic {self._topic.name}: {note}" for note in left_out(decoded, len(part))]
        times = np.array([message[2:] for message in part], np.int64).reshape(-1, 2)[decoded.fits]
        return TopicArrays(self._topic.type_name, decoded.fields, times[:, 0], times[:, 1])


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


def sequence_ranges(messages: TopicArrays, every: int) -> NumberRanges | None:
    """The numbers of `messages`, of which one of `every` was to be recorded; None where they have none."""
    sequence = sequence_in(messages.fields)
    if sequence is None:
        return None
    ranges = NumberRanges(every)
    ranges.add(sequence)
    return ranges
