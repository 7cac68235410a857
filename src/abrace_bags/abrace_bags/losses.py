# SPDX-License-Identifier: Apache-2.0
"""The counts that a bag has of each topic at its end: messages, gaps in `sequence`, losses."""

from __future__ import annotations

import contextlib
import json
import struct
from typing import TYPE_CHECKING, NamedTuple

from abrace_bags.definitions import MessageField, parse_fields
from abrace_core import wire
from abrace_core.errors import AbraceError
from abrace_core.sequence import SequenceCounter

if TYPE_CHECKING:
    from collections.abc import Mapping

COUNTS_RECORD = "abrace_topics"
"""Name of the metadata record: by topic, JSON with `messages`, `gaps`, `missing` and `lost`."""

_SEQUENCE = struct.Struct("<Q")
_SEQUENCE_FIELD = MessageField("sequence", "uint64", None)


class TopicCounts(SequenceCounter):
    """Messages of one topic of a bag.

    Parameters
    ----------
    numbered
        Whether its messages have a header and then a `sequence`.

    Attributes
    ----------
    messages
        Recorded.
    lost
        Published and not recorded, as far as is known.
    """

    def __init__(self, numbered: bool) -> None:
        super().__init__()
        self.numbered = numbered
        self.messages = 0
        self.lost = 0


def is_numbered(definition_text: str) -> bool:
    """Whether messages begin with a header and a `sequence`, as the rig's do, by the `definition_text` (.msg)."""
    try:
        head = parse_fields(definition_text.partition("=" * 80)[0])[:2]
    except AbraceError:
        return False
    return len(head) == 2 and head[0].type_name == "std_msgs/Header" and head[1] == _SEQUENCE_FIELD


def sequence_number(payload: bytes) -> int:
    """The `sequence` of a numbered message, the serialised `payload`; -1 if that is too short to have one."""
    try:
        number: int = _SEQUENCE.unpack_from(payload, wire.read_header(payload).offset)[0]
    except (AbraceError, struct.error):
        return -1
    return number


def counts_record(counts: Mapping[str, TopicCounts]) -> dict[str, str]:
    """The texts of the metadata record from `counts` by topic."""
    return {
        topic: json.dumps({"messages": one.messages, "gaps": one.gaps, "missing": one.missing, "lost": one.lost})
        for topic, one in counts.items()
    }


class RecordedCounts(NamedTuple):
    """What the logger counted of a topic: messages, gaps in their numbers, numbers missing in them, messages lost."""

    messages: int
    gaps: int
    missing: int
    lost: int


def recorded_counts(records: Mapping[str, Mapping[str, str]]) -> dict[str, RecordedCounts]:
    """What the logger counted by topic, of those topics that a bag's metadata `records` have."""
    counts = {}
    for topic, text in records.get(COUNTS_RECORD, {}).items():
        with contextlib.suppress(ValueError, KeyError, TypeError):
            content = json.loads(text)
            counts[topic] = RecordedCounts(*(int(content[name]) for name in RecordedCounts._fields))
    return counts


def lost_messages(records: Mapping[str, Mapping[str, str]]) -> dict[str, int]:
    """Messages lost at recording by topic, of those topics that a bag's metadata `records` have."""
    return {topic: counts.lost for topic, counts in recorded_counts(records).items()}
