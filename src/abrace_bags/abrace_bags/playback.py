# SPDX-License-Identifier: Apache-2.0
"""Playback of a bag's messages: which is next, and when it is due by the clock or, in lockstep, after an answer.

In lockstep a controller receives the samples of an earlier run, and reproduces that run's commands to the last
bit: the law of Eq. (13) has no other input.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from rosbags.interfaces import QosDurability

from abrace_bags.definitions import message_definition
from abrace_bags.raw import read_raw
from abrace_core.errors import AbraceError
from abrace_core.wire import BraceCommands, Responses

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from rosbags.interfaces import Qos

    from abrace_bags.mcap.index import RecordedChannel
    from abrace_bags.raw import RawBag, RecordedTopic
    from abrace_bags.survey import RawMessage

RESPONSE_TYPE = "abrace_interfaces/msg/Response"
COMMAND_TYPE = "abrace_interfaces/msg/BraceCommand"
COMMAND_TOPIC = "brace_command"
RIG_INPUTS = (COMMAND_TOPIC, "ground_motion", "emergency_stop")
"""Last parts of the names of topics that move a rig, or that end its emergency stop."""
CLOCK = "/clock"
_CLOCK_END = 2**31 * 10**9
"""The seconds of a Clock message have 31 bits [ns]."""


def bag_to_replay(bag: str, topics: Collection[str], start_offset: float, duration: float) -> RawBag:
    """The messages of a `bag` to replay, as `read_raw` has them.

    Without `topics` the inputs of a rig are left out, with a warning, so that a rig is not moved by accident. So are
    hidden topics, those of actions and services.

    Raises
    ------
    AbraceError
        As `read_raw`, or if there is no message.
    """
    inputs: set[str] = set()
    hidden: set[str] = set()

    def refuses(channel: RecordedChannel) -> bool:
        name = channel.topic
        if topics:
            return False
        if channel.type_name == COMMAND_TYPE or name.rpartition("/")[2] in RIG_INPUTS:
            inputs.add(name)
        elif "/_" in name:
            hidden.add(name)
        return name in inputs or name in hidden

    found = read_raw(bag, topics, start_offset, duration, refuses)
    for left_out, why in ((inputs, "they command a rig"), (hidden, "they are hidden")):
        if left_out:
            warning = f"{', '.join(sorted(left_out))} left out: {why} (parameter topics replays them by name)"
            found = replace(found, warnings=(*found.warnings, warning))
    if not found.count:
        why = "; ".join(["there is no message on the topics to replay", *found.warnings])
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


def check_clock(name: str, bag: RawBag) -> None:
    """Check that the time of a `bag` of this `name` can be published on /clock when it is replayed.

    Raises
    ------
    AbraceError
        If /clock is one of the topics, or a Clock message can't hold the messages' times.
    """
    if CLOCK in bag.topics:
        raise AbraceError(f"parameter clock: {CLOCK} of the bag is replayed, expected only one of the two")
    if not 0 <= bag.first <= bag.last < _CLOCK_END:
        raise AbraceError(f"parameter clock: /clock can't have the times of {name}, expected 1970 to 2038")


def response_topic(bag: RawBag) -> str:
    """The topic of a `bag` whose samples are answered in lockstep.

    Raises
    ------
    AbraceError
        If there is not exactly one topic of responses, it has no message, or the answers are to be replayed as well.
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
    if not bag.counts.get(found[0]):
        raise AbraceError(f"parameter lockstep: no message of {found[0]} in the part to replay, expected some")
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
    """Plays messages one after the other: each when it is due by a clock, or at once while the clock is stopped.

    The clock is stopped at first.

    Parameters
    ----------
    bag
        Has at least one message.
    rate
        Bag time over time.
    loop
        Whether to begin again at the end.

    Raises
    ------
    AbraceError
        If all are of one time and are to be played again and again.
    """

    def __init__(self, bag: RawBag, rate: float, loop: bool) -> None:
        self._bag = bag
        self._rate = rate
        self._loop = loop
        span = bag.last - bag.first
        if loop and not span:
            raise AbraceError("parameter loop: all messages to replay have the same time, expected later ones too")
        # a round lasts one mean interval longer than its messages: its last one and the first of the next are apart
        self._round = span + round(span / max(bag.count - 1, 1))
        self._messages = bag.read()
        self._next = next(self._messages, None)
        self._position = 0
        self._bag_time = bag.first
        self._clock_time = 0.0
        self._running = False
        self.played = 0
        """Messages played, in all rounds."""

    @property
    def ended(self) -> bool:
        """Whether the last message has been played."""
        return self._next is None

    @property
    def fraction(self) -> float:
        """How much of the messages of this round has been played."""
        return self._position / max(self._bag.count, 1)

    @property
    def due(self) -> float | None:
        """When the next message is due [s]; None: while the clock is stopped, and after the last message."""
        if not self._running or self._next is None:
            return None
        return self._clock_time + (self._next.log_time - self._bag_time) * 1e-9 / self._rate

    def bag_time(self, now: float) -> int:
        """The time of the bag [ns] at `now` [s], within that of its messages."""
        time = self._bag_time
        if self._running:
            time += round((now - self._clock_time) * 1e9 * self._rate)
        return max(self._bag.first, min(time, self._bag.last))

    def start_clock(self, now: float) -> None:
        """Start the clock where it was stopped; `now` in seconds."""
        if not self._running:
            self._clock_time = now
            self._running = True

    def stop_clock(self, now: float) -> None:
        """Stop the clock; `now` in seconds."""
        if self._running:
            self._bag_time = self.bag_time(now)
            self._running = False

    def next_message(self) -> RawMessage:
        """Play the next message, which is due; there is one."""
        message = self._next
        assert message is not None
        self._next = next(self._messages, None)
        self._position += 1
        self.played += 1
        if self._loop and self.ended:
            self._messages = self._bag.read()
            self._next = next(self._messages)
            self._position = 0
            self._bag_time -= self._round
        return message

    def step(self) -> RawMessage:
        """Play the next message while the clock is stopped, and set the clock to its time, but never back."""
        if self._next is not None:
            self._bag_time = max(self._bag_time, self._next.log_time)
        return self.next_message()


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
            message = playback.step()
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
