# SPDX-License-Identifier: Apache-2.0
"""A bag's messages for a viewer, by the clock, again from the beginning after the last."""

from __future__ import annotations

from typing import TYPE_CHECKING

from abrace_bags import message_definition
from abrace_bags.playback import BagPlayback, check_type
from abrace_bags.raw import read_raw
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from abrace_bags import MessageDefinition
    from abrace_bags.survey import RawMessage


class BagSource:
    """Plays a bag.

    Parameters
    ----------
    bag
        A bag directory or a single file.
    rate
        Bag time over time.
    loop
        Whether to begin again after the last message.

    Raises
    ------
    AbraceError
        If there is no such bag, or no message in it of a type that is installed.
    """

    def __init__(self, bag: str, rate: float, loop: bool) -> None:
        self.warnings: list[str] = []
        """What can't be shown, and why."""
        self.topics: dict[str, MessageDefinition] = {}
        """The topics that are played."""
        found = read_raw(bag)
        for topic in found.topics.values():
            try:
                check_type(topic)
                self.topics[topic.name] = message_definition(topic.type_name)
            except AbraceError as error:
                self.warnings.append(f"{bag}: {error}, it is not shown")
        if not any(found.counts[name] for name in self.topics):
            raise AbraceError("; ".join([f"{bag}: no message in it that can be shown", *self.warnings]))
        self._playback = BagPlayback(found, rate, loop)
        self._last = 0

    def messages(self, now: float, anew: Callable[[], None]) -> Iterator[RawMessage]:
        """The messages that are due.

        Parameters
        ----------
        now
            Time [s] of the clock that they are played by.
        anew
            Called before the first message of each further round.
        """
        self._playback.start_clock(now)
        while self._playback.due is not None and self._playback.due <= now:
            message = self._playback.next_message()
            if message.log_time < self._last:
                anew()
            self._last = message.log_time
            if message.topic in self.topics:
                yield message

    def time(self, now: float) -> int:
        """The time of the bag [ns] at `now` [s] of that clock."""
        return self._playback.bag_time(now)
