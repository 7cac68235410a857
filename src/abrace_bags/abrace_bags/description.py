# SPDX-License-Identifier: Apache-2.0
"""What is in a bag: topics, types, counts, rates, duration, missing numbers, facts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from abrace_bags.bag import missing_messages, open_bag
from abrace_bags.losses import RecordedCounts, recorded_counts
from abrace_bags.mcap.file_reader import McapFile
from abrace_bags.survey import TopicSurvey, edges, survey

if TYPE_CHECKING:
    from pathlib import Path

    from abrace_bags.bag import OpenedBag


@dataclass(frozen=True)
class TopicDescription:
    """One topic of a bag.

    Parameters
    ----------
    name, type_name
        As `/response` and `abrace_interfaces/msg/Response`.
    count
        Messages.
    rate
        Messages a second between the first and the last; 0 where there are fewer than two.
    first
        `sequence` of its first message; None for messages that do not begin with a header and one.
    gaps
        How often `sequence` skips numbers; None where `first` is.
    missing
        Numbers that it skips in all; None where `first` is.
    lost
        Messages that the logger counted as lost; None where the bag has no such count.
    """

    name: str
    type_name: str
    count: int
    rate: float
    first: int | None
    gaps: int | None
    missing: int | None
    lost: int | None


@dataclass(frozen=True)
class BagDescription:
    """What is in a bag.

    Parameters
    ----------
    topics
        In the order of their names.
    begin, end
        Log times of the first and the last message [ns]; both 0 where there is none.
    size
        Bytes of its MCAP files.
    files
        How many those are.
    facts
        Of its run: rig, controller, record.
    attachments
        Bytes of the files that are in it, by name.
    warnings
        What is missing or can't be trusted, one sentence each.
    """

    topics: tuple[TopicDescription, ...]
    begin: int
    end: int
    size: int
    files: int
    facts: dict[str, str]
    attachments: dict[str, int]
    warnings: tuple[str, ...]

    @property
    def duration(self) -> float:
        """Seconds between the first and the last message."""
        return 1e-9 * (self.end - self.begin)


def describe(bag: Path | str, check: bool = False) -> BagDescription:
    """Describe a `bag`, a directory or a single file.

    That takes its index, the counts that the logger wrote at its end, and the first and the last chunk of each topic. A
    bag that lacks some of these, as one of another writer or one that was cut off, is read chunk by chunk, and so is
    every bag with `check`, which finds damage in any chunk.

    Raises
    ------
    AbraceError
        If there is no such bag or it isn't one.
    """
    opened = open_bag(bag)
    found = None if check else _by_index(opened)
    if found is None:
        read = survey(bag)
        opened, found = read.opened, list(read.topics.values())
    recorded = recorded_counts(opened.records)
    counted = [topic for topic in found if topic.count]
    warnings = opened.warnings
    if opened.uncounted:
        warnings += [f"{bag}: {missing_messages(topic.channel.topic, topic.numbers)}" for topic in found]
    sizes = [path.stat().st_size for path in opened.paths]
    return BagDescription(
        topics=tuple(_topic(topic, recorded) for topic in sorted(found, key=lambda topic: topic.channel.topic)),
        begin=min((topic.first_time for topic in counted), default=0),
        end=max((topic.last_time for topic in counted), default=0),
        size=sum(sizes),
        files=len(sizes),
        facts=opened.facts,
        attachments={attachment.name: len(attachment.data) for attachment in opened.attachments},
        warnings=tuple(warnings),
    )


def _topic(found: TopicSurvey, recorded: dict[str, RecordedCounts]) -> TopicDescription:
    span = 1e-9 * (found.last_time - found.first_time)
    rate = (found.count - 1) / span if span else 0.0
    name = found.channel.topic
    numbers = found.numbers if found.numbers is not None and found.numbers.ranges else recorded.get(name)
    gaps, missing = (None, None) if found.first_number is None or numbers is None else (numbers.gaps, numbers.missing)
    lost = recorded[name].lost if name in recorded else None
    return TopicDescription(name, found.channel.type_name, found.count, rate, found.first_number, gaps, missing, lost)


def _by_index(opened: OpenedBag) -> list[TopicSurvey] | None:
    """What the topics have, from the index and the logger's counts; None where these do not say it, or are damaged."""
    counted = recorded_counts(opened.records)
    found: dict[str, TopicSurvey] = {}
    for file in opened.files:
        if not isinstance(file, McapFile) or not file.indexed or file.summary is None:
            return None
        for number, channel in file.channels.items():
            topic = found.setdefault(channel.topic, TopicSurvey(channel))
            topic.count += (file.summary.message_counts or {}).get(number, 0)
    for name, topic in found.items():
        if topic.count:
            topic.set_edges(*edges(opened, name))
        # the numbers themselves are in no index: the logger's counts hold if they are of the same messages
        if topic.numbers is not None and (name not in counted or counted[name].messages != topic.count):
            return None
    return None if any(file.warnings for file in opened.files) else list(found.values())
