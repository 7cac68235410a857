# SPDX-License-Identifier: Apache-2.0
"""Playback of a bag's messages: which is next, and when it is due by the clock or, in lockstep, after an answer.

In lockstep a controller receives the samples of an earlier run, and reproduces that run's commands to the last
bit: the law of Eq. (13) has no other input.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rosbags.interfaces import QosDurability

from abrace_bags.bag import Bag
from abrace_bags.definitions import message_definition
from abrace_bags.run import RESPONSE_TYPE
from abrace_core import AbraceError
from abrace_core.safety.wire import BraceCommands, Responses

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from rosbags.interfaces import Qos

    from abrace_bags.raw import RawMessage, RawMessages
    from abrace_bags.topics import RecordedTopic

COMMAND_TYPE = "abrace_interfaces/msg/BraceCommand"
COMMAND_TOPIC = "brace_command"
RIG_INPUTS = (COMMAND_TOPIC, "ground_motion", "emergency_stop")
"""Last parts of the names of topics that move a rig, or that end its emergency stop."""


def bag_to_replay(bag: str, topics: Collection[str], start_offset: float, duration: float) -> RawMessages:
    """The messages of a `bag` to replay, as `Bag.raw` has them.

    Without `topics` the inputs of a rig are left out, with a warning, so that a rig is not moved by accident. So are
    hidden topics, those of actions and services. `start_offset` and `duration` [s] are as for `Bag.time_range`.

    Raises
    ------
    AbraceError
        As `Bag.raw`, or if there is no message.
    """
    opened = Bag(bag)
    inputs, hidden, chosen = [], [], list(topics)
    for name, topic in opened.topics.items() if not topics else ():
        if topic.type_name == COMMAND_TYPE or name.rpartition("/")[2] in RIG_INPUTS:
            inputs.append(name)
        elif "/_" in name:
            hidden.append(name)
        elif topic.message_encoding == "cdr":
            chosen.append(name)
    left_out = ((inputs, "they command a rig"), (hidden, "they are hidden"))
    warnings = [
        f"{', '.join(names)} left out: {why} (parameter topics replays them by name)"
        for names, why in left_out
        if names
    ]
    if not chosen:
        raise AbraceError(
            f"bag {bag}: {'; '.join(['there is no message on the topics to replay', *opened.warnings, *warnings])}"
        )
    found = opened.raw(chosen, *opened.time_range(start_offset, duration, chosen))
    found.warnings = (*found.warnings, *warnings)
    if not found.count:
        part = f" from {start_offset:g} s to {start_offset + duration:g} s" if duration else ""
        why = "; ".join([f"there is no message on the topics to replay{part}", *found.warnings])
        raise AbraceError(f"bag {bag}: {why}")
    return found


def check_type(topic: RecordedTopic) -> None:
    """Check that the installed message type of a `topic` is the recorded one.

    Raises
    ------
    AbraceError
        If the type is not installed, or is not the same.
    """
    try:
        installed = message_definition(topic.type_name).type_hash
    except AbraceError as error:
        raise AbraceError(f"topic {topic.name}: {error}") from error
    if topic.type_hash not in ("", installed):
        raise AbraceError(
            f"topic {topic.name}: {topic.type_name} was recorded as {topic.type_hash}, "
            f"expected the one that is installed, {installed}"
        )


def response_topic(bag: RawMessages) -> str:
    """The topic of a `bag` whose samples are answered in lockstep.

    Raises
    ------
    AbraceError
        If there is not exactly one topic of responses, it has no message or not every one, or the answers are to be
        replayed as well.
    """
    found = [name for name, topic in bag.topics.items() if topic.type_name == RESPONSE_TYPE]
    if len(found) != 1:
        raise AbraceError(
            f"parameter lockstep: {len(found)} topics of {RESPONSE_TYPE} to replay "
            f"({', '.join(sorted(found)) or 'none'}), expected one (parameter topics)"
        )
    answers = sibling_topic(found[0], COMMAND_TOPIC)
    if answers in bag.topics:
        raise AbraceError(
            f"parameter lockstep: {answers} answers {found[0]} and can't be replayed as well, "
            "expected topics without it (parameter topics)"
        )
    if not bag.contents[found[0]].messages:
        raise AbraceError(f"parameter lockstep: no message of {found[0]} in the part to replay, expected some")
    if (every := bag.contents[found[0]].every) > 1:
        raise AbraceError(
            f"parameter lockstep: of {every} samples of {found[0]} one was recorded, expected all: a controller would "
            "take the others for lost"
        )
    return found[0]


def sibling_topic(topic: str, name: str) -> str:
    """The topic of this `name` in the namespace of another `topic`."""
    return f"{topic.rpartition('/')[0]}/{name}"


def replayed_qos(recorded: Qos, least_depth: int) -> Qos:
    """The `recorded` QoS with a depth of at least `least_depth`, so that slow subscribers lose nothing.

    A transient local topic keeps its depth: so many messages a late subscriber receives.
    """
    if recorded.durability is QosDurability.TRANSIENT_LOCAL:
        return recorded._replace(depth=recorded.depth or least_depth)
    return recorded._replace(depth=max(recorded.depth, least_depth))


class BagPlayback:
    """Plays messages one after the other.

    Parameters
    ----------
    bag
        The messages.
    rate
        Bag time over time.
    """

    def __init__(self, bag: RawMessages, rate: float) -> None:
        self._bag = bag
        self._rate = rate
        self._messages = iter(bag)
        self._next = next(self._messages, None)
        self.played = 0
        """Messages played."""

    @property
    def ended(self) -> bool:
        """Whether the last message has been played."""
        return self._next is None

    @property
    def fraction(self) -> float:
        """How much of the messages has been played."""
        return self.played / max(self._bag.count, 1)

    def due(self, began: float) -> float | None:
        """When the next message is due [s], where the first was at `began` [s]; None: after the last one."""
        return None if self._next is None else began + (self._next.log_time - self._bag.first) * 1e-9 / self._rate

    def next_message(self) -> RawMessage:
        """Play the next message, of which there is one."""
        message = self._next
        assert message is not None
        self._next = next(self._messages, None)
        self.played += 1
        return message


class Answers:
    """Plays a bag sample by sample, each when a command has answered the last; `topic` is that of the samples."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._responses, self._commands = Responses(), BraceCommands()
        self.missing: int | None = None
        """Number of the sample that is to be answered; None: the last one has been."""

    def next_messages(self, playback: BagPlayback) -> Iterator[RawMessage]:
        """Play all messages of a `playback` up to the next sample and the sample, which then is to be answered.

        Raises
        ------
        AbraceError
            If the sample can't be read.
        """
        while self.missing is None and not playback.ended:
            message = playback.next_message()
            if message.topic == self._topic:
                self.missing = self._responses.unpack(message.payload)[1].sequence
            yield message

    def receive(self, payload: bytes) -> bool:
        """Whether a command, given as its `payload`, is the answer to the last sample.

        Raises
        ------
        AbraceError
            If it can't be read.
        """
        _, sequence, _, _ = self._commands.unpack(payload)
        if sequence != self.missing:
            return False
        self.missing = None
        return True
