# SPDX-License-Identifier: Apache-2.0
"""Topics of a bag, and what is asked for of it: some topics, a range of time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

from abrace_bags.definitions import is_same_type
from abrace_bags.qos import combined_qos, parse_qos
from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from rosbags.interfaces import Qos

EVERY = "every of "
"""Begin of the fact that says of how many messages of a topic one was recorded; the topic's whole name follows."""


@dataclass(frozen=True, eq=False)
class RecordedTopic:
    """A topic of a bag, or one of its channels in a file; all its messages are of one type.

    Parameters
    ----------
    name
        As `/response`.
    type_name
        As `abrace_interfaces/msg/Response`; empty where the schema is unknown.
    type_hash
        RIHS01 hash of the type as it was recorded; empty where the bag does not say.
    profiles
        QoS that its publishers offered, as the bag's files have it: YAML.
    definition, schema_encoding
        Of the type: its text, and how that is written (`ros2msg`, `ros2idl`).
    message_encoding
        How its messages are serialised: `cdr` in bags of ROS 2.
    """

    name: str
    type_name: str
    type_hash: str = ""
    profiles: tuple[str, ...] = ()
    definition: str = ""
    schema_encoding: str = "ros2msg"
    message_encoding: str = "cdr"

    @cached_property
    def offers(self) -> list[Qos]:
        """What each of its publishers offered.

        Raises
        ------
        AbraceError
            If the bag's text is no QoS.
        """
        try:
            return [qos for text in dict.fromkeys(self.profiles) for qos in parse_qos(text)]
        except AbraceError as error:
            raise AbraceError(f"topic {self.name}: {error}") from error

    @cached_property
    def qos(self) -> Qos:
        """What its publishers offered, combined into one.

        Raises
        ------
        AbraceError
            As of `offers`, or if a number in it is negative.
        """
        offers = self.offers
        try:
            return combined_qos(offers)
        except AbraceError as error:
            raise AbraceError(f"topic {self.name}: {error}") from error

    def joined(self, other: RecordedTopic) -> RecordedTopic | None:
        """The topic with the publishers of an `other` of its name; None if their messages are of different types."""
        hashes = {self.type_hash, other.type_hash} - {""}
        types = [(one.type_name, one.definition, one.schema_encoding) for one in (self, other)]
        if len(hashes) > 1 or self.message_encoding != other.message_encoding or not is_same_type(*types):
            return None
        profiles = tuple(dict.fromkeys((*self.profiles, *other.profiles)))
        return replace(self, type_hash=self.type_hash or other.type_hash, profiles=profiles)


class Selection:
    """The messages of a bag that are asked for.

    Parameters
    ----------
    asked
        Names of topics, each whole or the end of one; all when empty.
    begin, end
        Log times [ns], `begin` included, `end` not; None: from the first, to the last.

    Attributes
    ----------
    topics
        By name, those that are asked for, as far as the bag was read.
    left_out
        By name, topics of which messages are not read, and why.
    """

    def __init__(self, asked: Collection[str] = (), begin: int | None = None, end: int | None = None) -> None:
        self.asked, self.begin, self.end = asked, begin, end
        self.topics: dict[str, RecordedTopic] = {}
        self.left_out: dict[str, tuple[RecordedTopic, str]] = {}
        self._known: dict[RecordedTopic, bool] = {}

    def accepts(self, channel: RecordedTopic) -> bool:
        """Whether the messages of a `channel` are asked for, and are of their topic's one type."""
        if channel not in self._known:
            self._known[channel] = self._add(channel)
        return self._known[channel]

    def _add(self, channel: RecordedTopic) -> bool:
        name = channel.name
        if self.asked and not any(name == one or is_end_of(one, name) for one in self.asked):
            return False
        known = self.topics.get(name, channel)
        joined = known.joined(channel)
        if joined is None:
            why = f"they are of another {channel.type_name}, expected {known.type_name} as before"
            self.left_out[name] = channel, why
            return False
        self.topics[name] = joined
        return True


def every_of(facts: Mapping[str, str], topic: str) -> int:
    """Of how many messages of a `topic`, by its whole name, one was recorded, as a bag's `facts` say; 1: all."""
    text = facts.get(EVERY + topic, "")
    return max(int(text), 1) if text.isdecimal() else 1


def is_end_of(asked: str, name: str) -> bool:
    """Whether what is `asked` for is the end of a topic's `name`: `response` of `/demo/response`."""
    return not asked.startswith("/") and name.endswith(f"/{asked}")


def printable(text: str) -> str:
    """A `text` with names from a bag, in which control characters can't act on the terminal."""
    return "".join(one if one.isprintable() or one == "\n" else one.encode("unicode_escape").decode() for one in text)
