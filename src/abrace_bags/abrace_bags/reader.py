"""Bags to arrays: whole topics at a time, from our bags and rosbag2's, also when they were cut off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_bags.cdr import decode, misfits
from abrace_bags.files import bag_files, open_bag, topic_names
from abrace_bags.mcap.records import read_facts_record
from abrace_bags.mcap.selection import Wanted
from abrace_bags.ros2msg import is_same_type, parse_message_type
from abrace_core.errors import AbraceError
from abrace_core.sequence import missing_numbers

if TYPE_CHECKING:
    from collections.abc import Callable, Collection
    from pathlib import Path

    from numpy.typing import NDArray

    from abrace_bags.mcap.stream import Channel, Stream


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
        What the bag says of its run; empty where it says nothing.
    warnings
        What is missing or can't be trusted, one sentence each; empty where all is well.
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
    """Read topics of a bag; where it has an index, only the chunks in which there is something of what is asked for.

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
        why = f" ({'; '.join(contents.warnings)})" if contents.warnings else ""
        named = ", ".join(sorted(topic_names(bag))) or "none"
        raise AbraceError(f"{bag}: no topic {missing[0]} in it{why}, expected one of {named}")
    return contents


def read_selected(
    bag: Path | str, wanted: Callable[[Channel], bool], begin: int | None = None, end: int | None = None
) -> BagContents:
    """Read the topics of a bag whose channels are wanted: `read_topics` by more than a name, else as `read_topics`."""
    opened = open_bag(bag, Wanted(wanted, begin, end))
    files, warnings = opened.files, opened.warnings
    facts = next((file.facts for file in files if file.facts is not None), {})
    parts: dict[str, list[tuple[Channel, Stream | None]]] = {}
    for file in files:
        for number, channel in file.channels.items():
            if wanted(channel):
                parts.setdefault(channel.topic, []).append((channel, file.streams.get(number)))
    contents = {}
    for topic, found in parts.items():
        try:
            contents[topic], left_out = _topic(found)
            warnings += [f"{bag}: topic {topic}: {what}" for what in left_out]
        except AbraceError as error:
            warnings.append(f"{bag}: topic {topic} is left out: {error}")
    if opened.uncounted:
        warnings += [f"{bag}: {missing_messages(topic, found)}" for topic, found in contents.items()]
    records = {name: texts for file in files for name, texts in file.metadata.items()}
    attachments = {attachment.name: attachment.data for file in files for attachment in file.attachments}
    return BagContents(contents, facts, tuple(warnings), records, attachments)


def read_facts(bag: Path | str) -> dict[str, str]:
    """What a bag says of its run: rig, controller, record, versions. Empty where it says nothing.

    Raises
    ------
    AbraceError
        If there is no such bag, it isn't one, or its facts are damaged.
    """
    damaged = []
    for path in bag_files(bag):
        try:
            facts = read_facts_record(path)
        except AbraceError as error:
            damaged.append(error)
            continue
        if facts is not None:
            return facts
    if damaged:
        raise damaged[0]
    return {}


def missing_messages(topic: str, found: TopicArrays) -> str:
    """What is known of the messages of a `topic` that are missing beside those `found`, if the bag's count is lost."""
    sequence = found.fields.get("sequence")
    if sequence is None or sequence.dtype.kind not in "iu" or sequence.ndim > 1 or not sequence.size:
        return f"topic {topic}: how many messages are missing is not known"
    _, missing = missing_numbers(sequence)
    span = f"{sequence.min()} to {sequence.max()}"
    return f"topic {topic}: {missing} of the samples {span} are missing, later ones are not known"


def _topic(found: list[tuple[Channel, Stream | None]]) -> tuple[TopicArrays, list[str]]:
    """All messages of one topic, from each file and channel that has some, and what is left out of them."""
    channel = found[0][0]
    described = channel.type_name, channel.definition
    for other, _ in found:
        if not is_same_type(described, (other.type_name, other.definition)):
            raise AbraceError(f"has messages of {channel.type_name} and another {other.type_name}, expected one")
        if (other.message_encoding, other.schema_encoding) != ("cdr", "ros2msg"):
            encodings = f"{other.message_encoding!r} described by {other.schema_encoding!r}"
            raise AbraceError(f"is written as {encodings}, expected 'cdr' described by 'ros2msg'")
    message_type = parse_message_type(*described)
    streams = [stream for _, stream in found if stream is not None]
    first = 0
    payloads = []
    for stream in streams:
        payloads += [(numbers + first, block) for numbers, block in stream.payloads()]
        first += stream.count
    none = [np.empty(0, np.int64)]
    log_time = np.concatenate(none + [stream.log_time for stream in streams])
    publish_time = np.concatenate(none + [stream.publish_time for stream in streams])
    left_out = []
    try:
        fields = decode(message_type, payloads)
    except AbraceError as error:
        fits = np.ones(first, bool)
        fits[misfits(message_type, payloads)] = False
        if not fits.any():
            raise
        left_out = [f"{first - fits.sum()} of {first} messages are left out: {error}"]
        place = np.cumsum(fits) - 1
        kept = [(place[numbers[fits[numbers]]], block[fits[numbers]]) for numbers, block in payloads]
        fields = decode(message_type, [part for part in kept if len(part[0])])
        log_time, publish_time = log_time[fits], publish_time[fits]
    if (log_time[1:] < log_time[:-1]).any():
        order = np.argsort(log_time, kind="stable")
        fields = {name: values[order] for name, values in fields.items()}
        log_time, publish_time = log_time[order], publish_time[order]
    return TopicArrays(channel.type_name, fields, log_time, publish_time), left_out
