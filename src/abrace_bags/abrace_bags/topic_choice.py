# SPDX-License-Identifier: Apache-2.0
"""Which topics of the graph a bag is to hold, and the one message type that the publishers of a topic have to have."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from abrace_bags.definitions import MessageDefinition, message_definition
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from rosbags.interfaces import Qos


class Publisher(NamedTuple):
    """A discovered publisher: its message type, that type's RIHS01 hash (empty if unknown), the QoS that it offers."""

    type_name: str
    type_hash: str
    qos: Qos


@dataclass(frozen=True)
class TopicChoice:
    """Topics by their full names.

    Parameters
    ----------
    names
        Topics to record whenever they appear.
    pattern
        Regular expression that is searched for in each name; empty: none.
    everything
        Whether to record all topics except hidden ones, of which a part begins with an underscore.

    Raises
    ------
    AbraceError
        If the pattern is no regular expression, or nothing is chosen.
    """

    names: frozenset[str]
    pattern: str = ""
    everything: bool = False

    def __post_init__(self) -> None:
        try:
            re.compile(self.pattern)
        except re.error as error:
            raise AbraceError(f"pattern {self.pattern!r}: {error}, expected a regular expression") from error
        if not (self.names or self.pattern or self.everything):
            raise AbraceError("no topics: expected names, a pattern, or all")

    def of(self, topics: Iterable[str]) -> set[str]:
        """Those of some `topics`, by full name, that are chosen."""
        return {name for name in topics if name in self.names or self._matches(name)}

    def _matches(self, name: str) -> bool:
        if "/_" in name:
            return False
        return self.everything or (self.pattern != "" and re.search(self.pattern, name) is not None)


def common_definition(topic: str, publishers: Sequence[Publisher]) -> MessageDefinition:
    """The definition of the messages of all `publishers` of a `topic`, at least one.

    Raises
    ------
    AbraceError
        If they have several types, or theirs is not the installed one.
    """
    types = {publisher.type_name for publisher in publishers}
    if len(types) > 1:
        raise AbraceError(f"topic {topic}: has the types {', '.join(sorted(types))}, expected one")
    try:
        definition = message_definition(types.pop())
    except AbraceError as error:
        raise AbraceError(f"topic {topic}: {error}") from error
    hashes = {publisher.type_hash for publisher in publishers} - {""}
    if hashes - {definition.type_hash}:
        raise AbraceError(
            f"topic {topic}: {definition.type_name} is published as {', '.join(sorted(hashes))}, "
            f"expected {definition.type_hash} as it is installed here"
        )
    return definition
