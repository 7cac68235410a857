# SPDX-License-Identifier: Apache-2.0
"""A bag's arrays together with all that a test compares with them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from abrace_bags import Bag, TopicArrays
from abrace_bags.mcap.contents import recorded_contents

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping
    from pathlib import Path


class Contents(dict[str, TopicArrays]):
    """Topics by name, and the bag's warnings, facts, metadata records and attachments (by name)."""

    def __init__(self, bag: Bag, topics: dict[str, TopicArrays]) -> None:
        super().__init__(topics)
        self.warnings = bag.warnings
        self.facts = bag.facts
        self.records = bag.metadata
        self.attachments: dict[str, bytes] = {one.name: one.data for one in bag.attachments}


def read_topics(
    path: Path | str, topics: Collection[str] = (), begin: int | None = None, end: int | None = None
) -> Contents:
    """What `Bag.arrays` gives of the bag at `path`, with the rest."""
    bag = Bag(path)
    return Contents(bag, bag.arrays(topics, begin, end))


def lost_messages(records: Mapping[str, Mapping[str, str]]) -> dict[str, int | None]:
    """Messages lost at recording by topic, as a bag's metadata `records` say."""
    return {topic: one.lost for topic, one in recorded_contents(records).items()}
