# SPDX-License-Identifier: Apache-2.0
"""What is in a bag: topics, types, counts, rates, duration, missing numbers, facts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from abrace_bags.bag import Bag, missing_messages
from abrace_bags.mcap.contents import TopicContent, recorded_contents

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True)
class BagDescription:
    """What is in a bag.

    Parameters
    ----------
    types
        Of the messages of each topic, by its name.
    contents
        Messages, times, gaps, losses of each topic, by its name.
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

    types: dict[str, str]
    contents: dict[str, TopicContent]
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

    That takes its index and the counts that were written at its end. A bag that lacks them, as one of another writer or
    one that was cut off, is read chunk by chunk, and so is every bag with `check`, which finds damage in any chunk.

    Raises
    ------
    AbraceError
        If there is no such bag or it isn't one.
    """
    opened = Bag(bag)
    recorded = recorded_contents(opened.metadata)
    found = recorded if not check and _is_counted(opened, recorded) else opened.raw().contents
    warnings = list(opened.warnings)
    if opened.uncounted:
        warnings += [f"{bag}: {missing_messages(name, one.numbers)}" for name, one in found.items()]
    contents = {name: found.get(name, TopicContent()) for name in opened.topics}
    for name, one in contents.items():
        one.lost = recorded[name].lost if name in recorded else None
        if one.numbers is not None:
            one.gaps, one.missing = one.numbers.gaps, one.numbers.missing
    times = [(one.first_time or 0, one.last_time or 0) for one in contents.values() if one.messages]
    return BagDescription(
        types={name: topic.type_name for name, topic in opened.topics.items()},
        contents=contents,
        begin=min((first for first, _ in times), default=0),
        end=max((last for _, last in times), default=0),
        size=sum(file.path.stat().st_size for file in opened.files),
        files=len(opened.files),
        facts=opened.facts,
        attachments={attachment.name: attachment.size for attachment in opened.attachments},
        warnings=tuple(warnings),
    )


def _is_counted(opened: Bag, recorded: dict[str, TopicContent]) -> bool:
    """Whether the counts `recorded` in a bag are those of all messages that its index names."""
    counts = dict.fromkeys(opened.topics, 0)
    for file in opened.files:
        if not file.indexed or file.summary is None or file.summary.message_counts is None or file.warnings:
            return False
        for number, channel in file.channels.items():
            counts[channel.name] += file.summary.message_counts.get(number, 0)
    return {name: one.messages for name, one in recorded.items()} == counts and all(
        one.first_time is not None and one.stated_rate is not None for one in recorded.values() if one.messages
    )
