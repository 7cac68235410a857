"""A bag's messages as they came from the wire, in the order in which they were logged: what `replay` publishes.

MCAP bags, ours and rosbag2's, are read also when they were cut off. What else rosbag2 writes (sqlite3, compressed
files, compressed messages) is read by `rosbags`.
"""

from __future__ import annotations

import operator
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import yaml

from abrace_bags.mcap.index import MessageFilter
from abrace_bags.qos import combined_qos, parse_qos
from abrace_bags.reader import open_bag
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from rosbags.interfaces import Qos

    from abrace_bags.mcap.index import RecordedChannel


OUT_OF_TURN = 100_000_000
"""By how much the times of several publishers' messages may step back [ns]; more is a clock that was set back."""


class RawMessage(NamedTuple):
    """A message: its topic, its bytes as they came from the wire, and when it was logged [ns]."""

    topic: str
    payload: bytes
    log_time: int


@dataclass(frozen=True)
class RecordedTopic:
    """A topic of a bag.

    Parameters
    ----------
    name
        As `/response`.
    type_name
        As `abrace_interfaces/msg/Response`.
    type_hash
        RIHS01 hash of the type as it was recorded; empty where the bag does not say.
    qos
        What its publishers offered, combined into one.
    """

    name: str
    type_name: str
    type_hash: str
    qos: Qos


@dataclass(frozen=True)
class RawBag:
    """Topics of a bag and their messages.

    Parameters
    ----------
    topics
        By name.
    messages
        Of these topics, in the order of their log times, those of one time in the order in which they were written.
    warnings
        What is missing or can't be trusted, one sentence each.
    """

    topics: dict[str, RecordedTopic]
    messages: list[RawMessage]
    warnings: tuple[str, ...]


def read_raw(bag: Path | str, topics: Collection[str] = ()) -> RawBag:
    """Read the raw messages of a bag, all into memory.

    Parameters
    ----------
    bag
        A bag directory or a single file.
    topics
        Names of the topics to read, each whole (`/demo/response`) or the end of one (`response`); all when empty.

    Raises
    ------
    AbraceError
        If there is no such bag, it isn't one, or a topic asked for is not in it or stands for several.
    """
    path = Path(bag)
    raw = _by_rosbags(path, topics) if _needs_rosbags(path) else _from_mcap(path, topics)
    raw.messages.sort(key=operator.attrgetter("log_time"))
    return raw


def choose_topics(bag: Path | str, names: Iterable[str], asked: Collection[str]) -> set[str]:
    """Names of a bag's topics that are asked for.

    Parameters
    ----------
    bag
        For the error message.
    names
        Of the bag's topics.
    asked
        Whole names or ends of names; all when empty.

    Raises
    ------
    AbraceError
        If a name is not among them or stands for several.
    """
    names = sorted(set(names))
    chosen = set(names if not asked else ())
    for one in asked:
        matching = [one] if one in names else [name for name in names if _is_end_of(one, name)]
        if len(matching) > 1:
            raise AbraceError(f"{bag}: topic {one} stands for {', '.join(matching)}, name one of them")
        if not matching:
            raise AbraceError(f"{bag}: no topic {one} in it, it has {', '.join(names) or 'none'}")
        chosen.update(matching)
    return chosen


def _is_end_of(asked: str, name: str) -> bool:
    return not asked.startswith("/") and name.endswith(f"/{asked}")


def _needs_rosbags(path: Path) -> bool:
    """Whether a bag is not plain MCAP, by its name or by what its metadata.yaml says."""
    metadata = path / "metadata.yaml"
    try:
        if path.is_file():
            return path.suffix == ".db3"
        if not metadata.is_file():
            return any(path.glob("*.db3"))
        information = yaml.safe_load(metadata.read_text(encoding="utf-8"))["rosbag2_bagfile_information"]
        return information["storage_identifier"] != "mcap" or bool(information.get("compression_format"))
    except (OSError, ValueError, yaml.YAMLError, KeyError, TypeError, AttributeError):
        # reading its MCAP files reports what is wrong
        return False


def _from_mcap(bag: Path, asked: Collection[str]) -> RawBag:
    def accepts(channel: RecordedChannel) -> bool:
        return not asked or any(channel.topic == one or _is_end_of(one, channel.topic) for one in asked)

    opened = open_bag(bag, MessageFilter(accepts))
    files, warnings = opened.files, opened.warnings
    chosen = choose_topics(bag, (channel.topic for file in files for channel in file.channels.values()), asked)
    topics: dict[str, RecordedTopic] = {}
    messages: list[RawMessage] = []
    for file in files:
        numbered: list[tuple[int, RawMessage]] = []
        for channel_id, channel in file.channels.items():
            if channel.topic not in chosen:
                continue
            if channel.message_encoding != "cdr":
                raise AbraceError(
                    f"{bag}: topic {channel.topic} is written as {channel.message_encoding!r}, expected 'cdr'"
                )
            metadata = channel.metadata
            qos = _combined_qos(bag, channel.topic, metadata.get("offered_qos_profiles", ""))
            topic = RecordedTopic(channel.topic, channel.type_name, metadata.get("topic_type_hash", ""), qos)
            _add(bag, topics, topic)
            if channel_id in file.streams:
                stream = file.streams[channel_id]
                if (np.diff(stream.log_time) < -OUT_OF_TURN).any():
                    warnings.append(
                        f"{bag}: the times of {channel.topic} step back, its messages come in the order of their times"
                    )
                of_topic = (RawMessage(channel.topic, payload, log_time) for log_time, _, payload in stream.messages())
                numbered += zip(np.concatenate(stream.file_numbers).tolist(), of_topic, strict=True)
        numbered.sort(key=operator.itemgetter(0))
        messages += [message for _, message in numbered]
    return RawBag(topics, messages, tuple(warnings))


def _combined_qos(bag: Path, topic: str, offers: str | Sequence[Qos]) -> Qos:
    try:
        return combined_qos(parse_qos(offers) if isinstance(offers, str) else offers)
    except AbraceError as error:
        raise AbraceError(f"{bag}: topic {topic}: {error}") from error


def _by_rosbags(bag: Path, asked: Collection[str]) -> RawBag:
    # takes 0.2 s, which plain MCAP bags don't need
    from rosbags.rosbag2 import Reader

    topics: dict[str, RecordedTopic] = {}
    try:
        with Reader(bag) as reader:
            chosen = choose_topics(bag, (connection.topic for connection in reader.connections), asked)
            connections = [connection for connection in reader.connections if connection.topic in chosen]
            for connection in connections:
                extension: Any = connection.ext  # that of rosbag2 has the QoS
                qos = _combined_qos(bag, connection.topic, extension.offered_qos_profiles)
                _add(bag, topics, RecordedTopic(connection.topic, connection.msgtype, connection.digest, qos))
            messages = [
                RawMessage(connection.topic, bytes(payload), time)
                for connection, time, payload in reader.messages(connections)
            ]
            expected: Counter[str] = Counter()
            for connection in connections:
                expected[connection.topic] += connection.msgcount
    except AbraceError:
        raise
    except Exception as error:
        # of a damaged file rosbags raises what its database, its decompression or its own code happen to raise
        raise AbraceError(f"{bag}: {' '.join(str(error).split()) or type(error).__name__}") from error
    found = Counter(message.topic for message in messages)
    warnings = [
        f"{bag}: {count - found[topic]} of {count} messages of {topic} are missing"
        for topic, count in expected.items()
        if found[topic] < count
    ]
    return RawBag(topics, messages, tuple(warnings))


def _add(bag: Path, topics: dict[str, RecordedTopic], found: RecordedTopic) -> None:
    """Put a topic among those that were found; several files or channels may have it, of one type."""
    known = topics.get(found.name, found)
    if known.type_name != found.type_name:
        raise AbraceError(f"{bag}: topic {found.name} has the types {known.type_name} and {found.type_name}")
    if known.type_hash and found.type_hash not in ("", known.type_hash):
        hashes = f"{known.type_hash} and as {found.type_hash}"
        raise AbraceError(f"{bag}: topic {found.name}: {found.type_name} was recorded as {hashes}")
    qos = combined_qos([known.qos, found.qos])
    topics[found.name] = replace(known, type_hash=known.type_hash or found.type_hash, qos=qos)
