"""A whole bag out of one that was cut off or damaged: everything in it that can be read, as it came from the wire."""

from __future__ import annotations

import contextlib
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from abrace_bags.files import open_bag
from abrace_bags.losses import tallied_losses
from abrace_bags.mcap.selection import Wanted
from abrace_bags.metadata import DEFAULT_QOS
from abrace_bags.reader import missing_messages, read_topics
from abrace_bags.ros2msg import is_same_type
from abrace_bags.writer import WRITTEN_RECORDS, BagWriter
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from abrace_bags.mcap.file_reader import McapFile
    from abrace_bags.mcap.stream import Channel, Stream


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
    messages stand in the order of their log times, file after file.

    Parameters
    ----------
    bag
        A bag directory or a single MCAP file, cut off or damaged or not.
    output
        The bag to write: a directory that is not there yet.

    Raises
    ------
    AbraceError
        If there is no such bag, it has no message that can be read, or the new one can't be written.
    """
    opened = open_bag(bag, Wanted(lambda _: True))
    files, warnings = opened.files, opened.warnings
    types: dict[str, tuple[str, str]] = {}
    usable = [_usable(str(bag), file, types, warnings) for file in files]
    found = (stream.count for file, numbers in zip(files, usable, strict=True) for stream in _streams(file, numbers))
    if not any(found):
        why = f" ({'; '.join(warnings)})" if warnings else ""
        raise AbraceError(f"{bag}: no message in it that can be read{why}")
    facts = next((file.facts for file in files if file.facts is not None), {})
    records = {name: texts for file in files for name, texts in file.metadata.items()}
    lost = tallied_losses(records)
    records = {name: texts for name, texts in records.items() if name not in WRITTEN_RECORDS}
    attachments = [attachment for file in files for attachment in file.attachments]
    counts: dict[str, int] = {}
    topics: dict[str, int] = {}
    with (
        _new_bag(Path(output)) as temporary,
        BagWriter(temporary, facts, records=records, attachments=attachments) as writer,
    ):
        for file, numbers in zip(files, usable, strict=True):
            messages = []
            for number in numbers:
                channel = file.channels[number]
                if channel.topic not in topics:
                    topics[channel.topic] = _add(writer, channel)
                    counts[channel.topic] = 0
                if number in file.streams:
                    messages += [(topics[channel.topic], *message) for message in file.streams[number].messages()]
                    counts[channel.topic] += file.streams[number].count
            for topic_id, log_time, publish_time, payload in sorted(messages, key=lambda message: message[1]):
                writer.write(topic_id, payload, log_time, publish_time)
        for topic, topic_id in topics.items():
            writer.add_lost(topic_id, lost.get(topic, 0))
    if opened.uncounted:
        warnings += [f"{bag}: {missing_messages(topic, found)}" for topic, found in read_topics(output).items()]
    return Recovered(counts, tuple(warnings))


@contextlib.contextmanager
def _new_bag(output: Path) -> Iterator[Path]:
    """Where to write a bag that becomes `output` when it is whole, and leaves nothing if it does not."""
    if output.exists():
        raise AbraceError(f"bag {output} exists already, expected a new directory")
    try:
        output.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{output.name}.", dir=output.parent) as folder:
            temporary = Path(folder) / output.name
            try:
                yield temporary
            except AbraceError as error:
                raise AbraceError(str(error).replace(str(temporary), str(output))) from error
            temporary.rename(output)
    except OSError as error:
        raise AbraceError(f"cannot write bag {output}: {error.strerror}") from error


def _streams(file: McapFile, numbers: list[int]) -> list[Stream]:
    return [file.streams[number] for number in numbers if number in file.streams]


def _usable(bag: str, file: McapFile, types: dict[str, tuple[str, str]], warnings: list[str]) -> list[int]:
    """Numbers of the channels that our bags can hold, each topic of one type; the others are said."""
    usable = []
    for number, channel in file.channels.items():
        encodings = (channel.message_encoding, channel.schema_encoding)
        known = types.setdefault(channel.topic, (channel.type_name, channel.definition))
        if encodings != ("cdr", "ros2msg"):
            said = f"is written as {encodings[0]!r} described by {encodings[1]!r}, expected 'cdr' by 'ros2msg'"
        elif not is_same_type(known, (channel.type_name, channel.definition)):
            said = f"is another {channel.type_name}, expected {known[0]} as before"
        else:
            usable.append(number)
            continue
        warnings.append(f"{bag}: messages of topic {channel.topic} are left out: it {said}")
    return usable


def _add(writer: BagWriter, channel: Channel) -> int:
    """Announce a topic as it was in the old bag."""
    try:
        profiles = yaml.safe_load(channel.details.get("offered_qos_profiles", ""))
    except (yaml.YAMLError, ValueError):
        profiles = None
    profiles = [profile for profile in profiles if isinstance(profile, dict)] if isinstance(profiles, list) else []
    known = [{word: profile[word] for word in DEFAULT_QOS if word in profile} for profile in profiles]
    type_hash = channel.details.get("topic_type_hash", "")
    return writer.add_topic(channel.topic, channel.type_name, channel.definition, type_hash, *known)
