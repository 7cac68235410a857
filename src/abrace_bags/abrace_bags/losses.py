"""What a bag says of each topic at its end: messages, gaps in `sequence`, losses."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING

from abrace_bags.ros2msg import MessageField, parse_fields
from abrace_core import wire
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Mapping

TALLY_RECORD = "abrace_topics"
"""Name of the metadata record: by topic, JSON with `messages`, `gaps`, `missing` and `lost`."""

_SEQUENCE = struct.Struct("<Q")


@dataclass
class Tally:
    """Of one topic.

    Parameters
    ----------
    numbered
        Whether its messages have a header and then a `sequence`.
    messages
        Recorded.
    gaps, missing
        Places where `sequence` leaves out numbers, and how many it leaves out.
    lost
        Messages that were published and not recorded, as far as is known.
    last
        The last `sequence`; None where a gap would not count.
    """

    numbered: bool
    messages: int = 0
    gaps: int = 0
    missing: int = 0
    lost: int = 0
    last: int | None = None

    def count(self, payload: bytes) -> None:
        """Count a message.

        Parameters
        ----------
        payload
            As it came from the wire.
        """
        self.messages += 1
        if not self.numbered:
            return
        try:
            (sequence,) = _SEQUENCE.unpack_from(payload, wire.read_header(payload).offset)
        except (AbraceError, struct.error):
            self.last = None
            return
        if self.last is not None and sequence > self.last + 1:
            self.gaps += 1
            self.missing += sequence - self.last - 1
        self.last = sequence


def is_numbered(definition_text: str) -> bool:
    """Whether messages of a type begin with a header and a `sequence`, as the rig's do.

    Parameters
    ----------
    definition_text
        The .msg text.
    """
    try:
        head = parse_fields(definition_text.partition("=" * 80)[0])[:2]
    except AbraceError:
        return False
    return len(head) == 2 and head[0].type_name == "std_msgs/Header" and head[1] == _SEQUENCE_FIELD


_SEQUENCE_FIELD = MessageField("sequence", "uint64", None)


def tally_texts(tallies: Mapping[str, Tally]) -> dict[str, str]:
    """The texts of that record.

    Parameters
    ----------
    tallies
        By topic.
    """
    return {
        topic: json.dumps(
            {"messages": tally.messages, "gaps": tally.gaps, "missing": tally.missing, "lost": tally.lost}
        )
        for topic, tally in tallies.items()
    }


def tallied_losses(records: Mapping[str, Mapping[str, str]]) -> dict[str, int]:
    """Messages lost, by topic, as far as a bag says it.

    Parameters
    ----------
    records
        The bag's metadata records.
    """
    losses = {}
    for topic, text in records.get(TALLY_RECORD, {}).items():
        try:
            losses[topic] = int(json.loads(text)["lost"])
        except (ValueError, KeyError, TypeError):
            continue
    return losses
