# SPDX-License-Identifier: Apache-2.0
"""Recovery of a bag that was cut off or damaged: everything in it that can be read is written to a new bag."""

from __future__ import annotations

import contextlib
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from abrace_bags.bag import in_brackets, missing_messages
from abrace_bags.definitions import is_same_type
from abrace_bags.losses import lost_messages
from abrace_bags.qos import parse_qos
from abrace_bags.survey import survey
from abrace_bags.writer import WRITTEN_RECORDS, BagWriter
from abrace_core.errors import AbraceError
from abrace_core.files import make_folder, move

if TYPE_CHECKING:
    from collections.abc import Iterator

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
    """Write everything that can be read of a bag to a new one.

    Messages, their times, types and QoS, the run's facts, the other metadata and the attachments are kept as they are;
    messages are written in the order in which they were recorded. No more than some chunks are in memory.

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
    types: dict[str, tuple[str, str]] = {}
    found = survey(bag, lambda channel: not _unusable(channel, types))
    warnings = found.opened.warnings
    if not found.count:
        raise AbraceError(f"{bag}: no message in it that can be read{in_brackets(warnings)}")
    for file in found.opened.files:
        for channel in file.channels.values():
            why = _unusable(channel, types)
            if why:
                warnings.append(f"{bag}: messages of topic {channel.topic} are left out: it {why}")
    lost = lost_messages(found.opened.records)
    records = {name: texts for name, texts in found.opened.records.items() if name not in WRITTEN_RECORDS}
    attachments = found.opened.attachments
    with (
        _new_bag(Path(output)) as temporary,
        BagWriter(temporary, found.opened.facts, records=records, attachments=attachments) as writer,
    ):
        numbers = {name: _add_topic(writer, topic.channel) for name, topic in found.topics.items()}
        for topic, payload, log_time, publish_time in found.as_written():
            writer.write(numbers[topic], payload, log_time, publish_time)
        for topic, number in numbers.items():
            writer.add_lost(number, lost.get(topic, 0))
    if found.opened.uncounted:
        warnings += [f"{bag}: {missing_messages(name, topic.numbers)}" for name, topic in found.topics.items()]
    return Recovered({name: topic.count for name, topic in found.topics.items()}, tuple(warnings))


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


def _unusable(channel: RecordedChannel, types: dict[str, tuple[str, str]]) -> str:
    """Why abrace's bags, with one type a topic, can't hold a channel's messages; empty if they can."""
    encodings = channel.message_encoding, channel.schema_encoding
    if encodings != ("cdr", "ros2msg"):
        return f"is written as {encodings[0]!r} described by {encodings[1]!r}, expected 'cdr' by 'ros2msg'"
    known = types.setdefault(channel.topic, (channel.type_name, channel.definition))
    if not is_same_type(known, (channel.type_name, channel.definition)):
        return f"is another {channel.type_name}, expected {known[0]} as before"
    return ""


def _add_topic(writer: BagWriter, channel: RecordedChannel) -> int:
    """Add a topic to the new bag as it was in the old one."""
    try:
        profiles = parse_qos(channel.metadata.get("offered_qos_profiles", ""))
    except AbraceError:
        profiles = []
    type_hash = channel.metadata.get("topic_type_hash", "")
    return writer.add_topic(channel.topic, channel.type_name, channel.definition, type_hash, *profiles)
