"""What is in a bag: topics, types, counts, rates, duration, missing numbers, facts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from abrace_bags.losses import lost_messages
from abrace_bags.reader import bag_files, read_topics, sequence_of
from abrace_core.sequence import missing_numbers

if TYPE_CHECKING:
    from pathlib import Path

    from abrace_bags.reader import TopicArrays


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
    gaps
        How often `sequence` skips numbers; None for messages without one.
    missing
        Numbers that it skips in all; None for messages without a `sequence`.
    lost
        Messages that the logger counted as lost; None where the bag has no such count.
    """

    name: str
    type_name: str
    count: int
    rate: float
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


def describe(bag: Path | str) -> BagDescription:
    """Read a whole `bag`, a directory or a single MCAP file, and describe it.

    Raises
    ------
    AbraceError
        If there is no such bag or it isn't one.
    """
    contents = read_topics(bag)
    files = bag_files(bag)
    times = [messages.log_time for messages in contents.values() if messages.log_time.size]
    lost = lost_messages(contents.records)
    return BagDescription(
        topics=tuple(_topic(name, contents[name], lost.get(name)) for name in sorted(contents)),
        begin=min((int(time.min()) for time in times), default=0),
        end=max((int(time.max()) for time in times), default=0),
        size=sum(path.stat().st_size for path in files),
        files=len(files),
        facts=contents.facts,
        attachments={name: len(data) for name, data in contents.attachments.items()},
        warnings=contents.warnings,
    )


def _topic(name: str, messages: TopicArrays, lost: int | None) -> TopicDescription:
    time = messages.log_time
    span = 1e-9 * int(time.max() - time.min()) if time.size > 1 else 0.0
    sequence = sequence_of(messages)
    gaps, missing = (None, None) if sequence is None else missing_numbers(sequence)
    rate = (time.size - 1) / span if span else 0.0
    return TopicDescription(name, messages.type_name, time.size, rate, gaps, missing, lost)
