"""Bags to arrays: whole topics at a time, from our bags and rosbag2's, also when they were cut off or lack files."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from abrace_bags.cdr import decode, undecodable
from abrace_bags.definitions import is_same_type, parse_message_type
from abrace_bags.mcap.file_reader import McapFile
from abrace_bags.mcap.index import MessageFilter
from abrace_bags.mcap.records import read_facts_record
from abrace_core.errors import AbraceError
from abrace_core.sequence import missing_numbers

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from mcap.records import Attachment
    from numpy.typing import NDArray

    from abrace_bags.mcap.chunk import Stream
    from abrace_bags.mcap.index import RecordedChannel


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
    """Read topics of a bag; of files with a summary section, only the chunks that may hold some of what is asked for.

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
    opened = open_bag(bag, MessageFilter(accepts, begin, end))
    warnings = opened.warnings
    channels: dict[str, list[tuple[RecordedChannel, Stream | None]]] = {}
    for file in opened.files:
        for channel_id, channel in file.channels.items():
            if accepts(channel):
                channels.setdefault(channel.topic, []).append((channel, file.streams.get(channel_id)))
    topics = {}
    for topic, recorded in channels.items():
        try:
            topics[topic], left_out = _topic(recorded)
            warnings += [f"{bag}: topic {topic}: {what}" for what in left_out]
        except AbraceError as error:
            warnings.append(f"{bag}: topic {topic} is left out: {error}")
    if opened.uncounted:
        warnings += [f"{bag}: {missing_messages(topic, messages)}" for topic, messages in topics.items()]
    attachments = {attachment.name: attachment.data for attachment in opened.attachments}
    return BagContents(topics, opened.facts, tuple(warnings), opened.records, attachments)


def read_facts(bag: Path | str) -> dict[str, str]:
    """The facts of the run in a `bag`: rig, controller, record, versions. Empty where it has none.

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


def topic_names(bag: Path | str) -> set[str]:
    """Names of the topics of a `bag`.

    Raises
    ------
    AbraceError
        As `open_bag`.
    """
    files = open_bag(bag, MessageFilter(lambda _: False)).files
    return {channel.topic for file in files for channel in file.channels.values()}


@dataclass(frozen=True)
class OpenedBag:
    """What is whole in the files of a bag.

    Parameters
    ----------
    files
        Those that can be read, in their order.
    warnings
        What is missing or can't be trusted, one sentence each.
    uncounted
        Whether messages may be missing and the files do not say how many.
    """

    files: list[McapFile]
    warnings: list[str]
    uncounted: bool

    @property
    def facts(self) -> dict[str, str]:
        """The run's facts, of the first file that has them."""
        return next((file.facts for file in self.files if file.facts is not None), {})

    @property
    def records(self) -> dict[str, dict[str, str]]:
        """Metadata records: texts by key, by the record's name."""
        return {name: texts for file in self.files for name, texts in file.metadata.items()}

    @property
    def attachments(self) -> list[Attachment]:
        """Files of the run."""
        return [attachment for file in self.files for attachment in file.attachments]


def open_bag(bag: Path | str, message_filter: MessageFilter) -> OpenedBag:
    """Read the files of a bag; one that can't be read does not keep the others from being read.

    Parameters
    ----------
    bag
        A bag directory or a single MCAP file.
    message_filter
        Which messages to keep.

    Raises
    ------
    AbraceError
        If there is no such bag, or none of its files can be read.
    """
    files, unreadable = [], []
    for path in bag_files(bag):
        try:
            files.append(McapFile(path, message_filter))
        except AbraceError as error:
            unreadable.append(str(error))
    if not files:
        raise AbraceError("; ".join(unreadable))
    warnings = missing_files(bag) + [f"{reason}; nothing is read of it" for reason in unreadable]
    warnings += [warning for file in files for warning in file.warnings]
    return OpenedBag(files, warnings, bool(unreadable) or any(file.uncounted for file in files))


def bag_files(bag: Path | str) -> list[Path]:
    """The MCAP files of a `bag`, in their order.

    Raises
    ------
    AbraceError
        If there is none.
    """
    bag = Path(bag)
    try:
        exists = bag.exists()
    except OSError as error:
        raise AbraceError(f"{bag}: {error.strerror}") from error
    if not exists:
        raise AbraceError(f"{bag}: no such bag, expected a bag directory or an MCAP file")
    if not bag.is_dir():
        return [bag]

    def by_numbers(path: Path) -> list[int | str]:
        return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", path.name)]

    files = sorted(bag.glob("*.mcap"), key=by_numbers)
    if not files:
        raise AbraceError(f"{bag}: no MCAP file in it, expected a bag directory")
    return files


def missing_files(bag: Path | str) -> list[str]:
    """Files that the metadata.yaml of a `bag` lists and that do not exist, one sentence each."""
    bag = Path(bag)
    path = bag / "metadata.yaml"
    if not path.is_file():
        return []
    try:
        named = yaml.safe_load(path.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]["relative_file_paths"]
        return [f"{bag}: {name} is missing" for name in named if not (bag / Path(name).name).is_file()]
    except (OSError, ValueError, yaml.YAMLError, KeyError, TypeError) as error:
        return [f"{path}: can't be read ({' '.join(str(error).split())})"]


def in_brackets(warnings: Sequence[str]) -> str:
    """The `warnings` of a bag for the error that they may explain; empty without any."""
    return f" ({'; '.join(warnings)})" if warnings else ""


def sequence_of(messages: TopicArrays) -> NDArray[Any] | None:
    """The `sequence` of `messages` (messages,); None where there are no messages, or none with a `sequence`."""
    sequence = messages.fields.get("sequence")
    if sequence is None or sequence.dtype.kind not in "iu" or sequence.ndim > 1 or not sequence.size:
        return None
    return sequence


def missing_messages(topic: str, messages: TopicArrays) -> str:
    """How many `messages` of a `topic` are missing by their `sequence`, for a warning where the bag's count is lost."""
    sequence = sequence_of(messages)
    if sequence is None:
        return f"topic {topic}: how many messages are missing is not known"
    _, missing = missing_numbers(sequence)
    span = f"{sequence.min()} to {sequence.max()}"
    return f"topic {topic}: {missing} of the samples {span} are missing, later ones are not known"


def _topic(recorded: list[tuple[RecordedChannel, Stream | None]]) -> tuple[TopicArrays, list[str]]:
    """All messages of one topic, from its channels in all files, and how many of them are left out and why."""
    channel = recorded[0][0]
    described = channel.type_name, channel.definition
    for other, _ in recorded:
        if not is_same_type(described, (other.type_name, other.definition)):
            raise AbraceError(f"has messages of {channel.type_name} and another {other.type_name}, expected one")
        if (other.message_encoding, other.schema_encoding) != ("cdr", "ros2msg"):
            encodings = f"{other.message_encoding!r} described by {other.schema_encoding!r}"
            raise AbraceError(f"is written as {encodings}, expected 'cdr' described by 'ros2msg'")
    message_type = parse_message_type(*described)
    streams = [stream for _, stream in recorded if stream is not None]
    count = 0
    payloads = []
    for stream in streams:
        payloads += [(numbers + count, block) for numbers, block in stream.payloads()]
        count += stream.count
    none = [np.empty(0, np.int64)]
    log_time = np.concatenate(none + [stream.log_time for stream in streams])
    publish_time = np.concatenate(none + [stream.publish_time for stream in streams])
    left_out = []
    try:
        fields = decode(message_type, payloads)
    except AbraceError as error:
        fits = np.ones(count, bool)
        fits[undecodable(message_type, payloads)] = False
        if not fits.any():
            raise
        left_out = [f"{count - fits.sum()} of {count} messages are left out: {error}"]
        renumbered = np.cumsum(fits) - 1
        kept = [(renumbered[numbers[fits[numbers]]], block[fits[numbers]]) for numbers, block in payloads]
        fields = decode(message_type, [part for part in kept if len(part[0])])
        log_time, publish_time = log_time[fits], publish_time[fits]
    if (log_time[1:] < log_time[:-1]).any():
        order = np.argsort(log_time, kind="stable")
        fields = {name: values[order] for name, values in fields.items()}
        log_time, publish_time = log_time[order], publish_time[order]
    return TopicArrays(channel.type_name, fields, log_time, publish_time), left_out
