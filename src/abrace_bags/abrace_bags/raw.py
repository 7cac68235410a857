# SPDX-License-Identifier: Apache-2.0
"""A bag's serialised messages in the order of their log times, as `replay` publishes them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from abrace_bags.qos import combined_qos, parse_qos
from abrace_bags.survey import RawMessage, Survey, no_message, survey, time_range
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator

    from rosbags.interfaces import Qos

    from abrace_bags.mcap.index import RecordedChannel


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
    """Topics of a bag, or of a part of its time, and their messages.

    Parameters
    ----------
    topics
        By name.
    read
        Gives the messages from the first one on, in the order of their log times, those of one time in the order in
        which they were written; a log time never steps back.
    counts
        Messages by topic.
    first, last
        Log times of the first and the last message [ns]; both 0 without a message.
    warnings
        What is missing or can't be trusted, one sentence each.
    """

    topics: dict[str, RecordedTopic]
    read: Callable[[], Iterator[RawMessage]]
    counts: dict[str, int]
    first: int
    last: int
    warnings: tuple[str, ...]

    @property
    def count(self) -> int:
        """Messages."""
        return sum(self.counts.values())


def read_raw(
    bag: Path | str,
    topics: Collection[str] = (),
    start_offset: float = 0.0,
    duration: float = 0.0,
    refuses: Callable[[RecordedChannel], bool] = lambda _: False,
) -> RawBag:
    """Find the raw messages of a bag, which are then read chunk by chunk.

    Parameters
    ----------
    bag
        A bag directory or a single file.
    topics
        Names of the topics to read, each whole (`/demo/response`) or the end of one (`response`); all when empty.
    start_offset
        Where the part to read begins [s], counted from the first message of these topics.
    duration
        Its length [s]; 0: to the end.
    refuses
        Whether to leave out a channel.

    Raises
    ------
    AbraceError
        If there is no such bag, it isn't one, it has no message in that part, or a name of `topics` is not in it or
        matches several.
    """
    path = Path(bag)

    def accepts(channel: RecordedChannel) -> bool:
        asked = not topics or any(channel.topic == one or _is_end_of(one, channel.topic) for one in topics)
        return asked and not refuses(channel)

    begin, end = time_range(path, accepts, start_offset, duration)
    found = survey(path, accepts, begin, end)
    channels = [channel for file in found.opened.files for channel in file.channels.values()]
    choose_topics(bag, (channel.topic for channel in channels), topics)
    recorded: dict[str, RecordedTopic] = {}
    for channel in filter(accepts, channels):
        if channel.message_encoding != "cdr":
            written = f"is written as {channel.message_encoding!r}, expected 'cdr'"
            raise AbraceError(f"{bag}: topic {channel.topic} {written}")
        metadata = channel.metadata
        qos = _offered_qos(path, channel.topic, metadata.get("offered_qos_profiles", ""))
        _add(path, recorded, RecordedTopic(channel.topic, channel.type_name, metadata.get("topic_type_hash", ""), qos))
    counts = {name: topic.count for name, topic in found.topics.items()}
    if begin is not None and not any(counts.values()):
        whole = survey(path, accepts)
        span = max(one.last_time for one in whole.topics.values()) - min(
            one.first_time for one in whole.topics.values() if one.count
        )
        raise no_message(bag, start_offset, duration, span)
    return _raw_bag(path, recorded, found, counts)


def _raw_bag(bag: Path, recorded: dict[str, RecordedTopic], found: Survey, counts: dict[str, int]) -> RawBag:
    warnings = found.opened.warnings
    if found.set_back:
        warnings.append(f"{bag}: the clock was set back during the recording: messages come in the order of the file")

        def read() -> Iterator[RawMessage]:
            return continuous(found.messages())

        first = next(read()).log_time
        last = max(message.log_time for message in read())
        return RawBag(recorded, read, counts, first, last, tuple(warnings))
    times = [time for topic in found.topics.values() if topic.count for time in (topic.first_time, topic.last_time)]
    warnings += [
        f"{bag}: the times of {name} step back, its messages come in the order of their times"
        for name, topic in found.topics.items()
        if topic.steps_back
    ]
    return RawBag(recorded, found.messages, counts, min(times, default=0), max(times, default=0), tuple(warnings))


def continuous(messages: Iterable[RawMessage]) -> Iterator[RawMessage]:
    """The `messages` in their order, their log times shifted from each on that was logged before the last one."""
    shift, last = 0, None
    for message in messages:
        if last is not None and message.log_time + shift < last:
            shift = last - message.log_time
        last = message.log_time + shift
        yield message._replace(log_time=last)


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
        If a name is not among them or matches several.
    """
    names = sorted(set(names))
    chosen = set(names if not asked else ())
    for one in asked:
        matching = [one] if one in names else [name for name in names if _is_end_of(one, name)]
        if len(matching) > 1:
            raise AbraceError(f"{bag}: topic {one} matches {', '.join(matching)}, name one of them")
        if not matching:
            raise AbraceError(f"{bag}: no topic {one} in it, it has {', '.join(names) or 'none'}")
        chosen.update(matching)
    return chosen


def _is_end_of(asked: str, name: str) -> bool:
    return not asked.startswith("/") and name.endswith(f"/{asked}")


def _offered_qos(bag: Path, topic: str, offers: str) -> Qos:
    try:
        return combined_qos(parse_qos(offers))
    except AbraceError as error:
        raise AbraceError(f"{bag}: topic {topic}: {error}") from error


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
