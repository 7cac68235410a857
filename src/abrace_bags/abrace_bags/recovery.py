"""A whole bag out of one that was cut off or damaged: everything in it that can be read, as it came from the wire."""

from __future__ import annotations

import contextlib
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from abrace_bags.definitions import is_same_type
from abrace_bags.losses import lost_messages
from abrace_bags.mcap.index import MessageFilter
from abrace_bags.qos import parse_qos
from abrace_bags.reader import in_brackets, missing_messages, open_bag, read_topics
from abrace_bags.writer import WRITTEN_RECORDS, BagWriter
from abrace_core.errors import AbraceError
from abrace_core.files import make_folder, move

if TYPE_CHECKING:
    from collections.abc import Iterator

    from abrace_bags.mcap.file_reader import McapFile
    from abrace_bags.mcap.index import RecordedChannel


@dataclass(frozen=True)
class Recovered:
    """What was recovered.

    Parameters
    ----------
    counts
        Messages by topic.
    warnings
        What is missing or can't be trusted, one sentence each.
    """

    counts: dict[str, int]
    warnings: tuple[str, ...]


def recover(bag: Path | str, output: Path | str) -> Recovered:
    """Write a whole bag of everything that can be read of another.

    Messages, their times, types and QoS, the run's facts, the other metadata and the attachments are kept as they are;
    messages are written in the order of their log times, file after file.

    Parameters
    ----------
    bag
        A bag directory or a single MCAP file, cut off or damaged or not.
    output
        The bag to write: a directory that must not exist.

    Raises
    ------
    AbraceError
        If there is no such bag, it has no message that can be read, or the new one can't be written.
    """
    opened = open_bag(bag, MessageFilter(lambda _: True))
    files, warnings = opened.files, opened.warnings
    types: dict[str, tuple[str, str]] = {}
    usable = [(file, _usable_channels(str(bag), file, types, warnings)) for file in files]
    if not any(file.streams[number].count for file, numbers in usable for number in numbers if number in file.streams):
        raise AbraceError(f"{bag}: no message in it that can be read{in_brackets(warnings)}")
    lost = lost_messages(opened.records)
    records = {name: texts for name, texts in opened.records.items() if name not in WRITTEN_RECORDS}
    counts: dict[str, int] = {}
    topics: dict[str, int] = {}
    with (
        _new_bag(Path(output)) as temporary,
        BagWriter(temporary, opened.facts, records=records, attachments=opened.attachments) as writer,
    ):
        for file, numbers in usable:
            messages = []
            for number in numbers:
                channel = file.channels[number]
                if channel.topic not in topics:
                    topics[channel.topic] = _add_topic(writer, channel)
                    counts[channel.topic] = 0
                if number in file.streams:
                    messages += [(topics[channel.topic], *message) for message in file.streams[number].messages()]
                    counts[channel.topic] += file.streams[number].count
            for topic_id, log_time, publish_time, payload in sorted(messages, key=lambda message: message[1]):
                writer.write(topic_id, payload, log_time, publish_time)
        for topic, topic_id in topics.items():
            writer.add_lost(topic_id, lost.get(topic, 0))
    if opened.uncounted:
        recovered = read_topics(output)
        warnings += [f"{bag}: {missing_messages(topic, messages)}" for topic, messages in recovered.items()]
    return Recovered(counts, tuple(warnings))


@contextlib.contextmanager
def _new_bag(output: Path) -> Iterator[Path]:
    """A temporary path for a bag, which is renamed to `output` when it is whole, and removed after an error."""
    if output.exists():
        raise AbraceError(f"bag {output} exists already, expected a new directory")
    try:
        make_folder(output.parent)
        with tempfile.TemporaryDirectory(prefix=f".{output.name}.", dir=output.parent) as folder:
            temporary = Path(folder) / output.name
            try:
                yield temporary
            except AbraceError as error:
                raise AbraceError(str(error).replace(str(temporary), str(output))) from error
            move(temporary, output)
    except OSError as error:
        raise AbraceError(f"cannot write bag {output}: {error.strerror}") from error


def _usable_channels(bag: str, file: McapFile, types: dict[str, tuple[str, str]], warnings: list[str]) -> list[int]:
    """Ids of the channels that our bags can hold, each topic of one type; a warning for each of the others."""
    usable = []
    for channel_id, channel in file.channels.items():
        encodings = (channel.message_encoding, channel.schema_encoding)
        known = types.setdefault(channel.topic, (channel.type_name, channel.definition))
        if encodings != ("cdr", "ros2msg"):
            why = f"is written as {encodings[0]!r} described by {encodings[1]!r}, expected 'cdr' by 'ros2msg'"
        elif not is_same_type(known, (channel.type_name, channel.definition)):
            why = f"is another {channel.type_name}, expected {known[0]} as before"
        else:
            usable.append(channel_id)
            continue
        warnings.append(f"{bag}: messages of topic {channel.topic} are left out: it {why}")
    return usable


def _add_topic(writer: BagWriter, channel: RecordedChannel) -> int:
    """Add a topic to the new bag as it was in the old one."""
    try:
        profiles = parse_qos(channel.metadata.get("offered_qos_profiles", ""))
    except AbraceError:
        profiles = []
    type_hash = channel.metadata.get("topic_type_hash", "")
    return writer.add_topic(channel.topic, channel.type_name, channel.definition, type_hash, *profiles)
