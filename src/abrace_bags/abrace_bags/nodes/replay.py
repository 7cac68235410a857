# SPDX-License-Identifier: Apache-2.0
"""The node `replay`: publishes a bag's messages again, unchanged, by the clock or in lockstep.

abrace run abrace_bags replay --ros-args -p bag:=bags/first -p topics:=[response] -p lockstep:=true
"""

from __future__ import annotations

import sys
import time

from rclpy.clock import Clock, ClockType
from rclpy.exceptions import NameValidationException
from rclpy.publisher import Publisher

from abrace_bags.nodes.endpoint import message_class, qos_profile
from abrace_bags.playback import (
    COMMAND_TOPIC,
    Answers,
    BagPlayback,
    bag_to_replay,
    check_type,
    replayed_qos,
    response_topic,
    sibling_topic,
)
from abrace_bags.raw import RawMessage
from abrace_bags.run import RESPONSE_TYPE
from abrace_bags.topics import RecordedTopic
from abrace_core import AbraceError
from abrace_core.files.progress import Step
from abrace_interfaces.msg import BraceCommand
from abrace_node.node import DISPLAY_PERIOD, AbraceNode, RCLError, endpoint_names, rcl_message
from abrace_node.parameters import Parameter
from abrace_node.process import run
from abrace_node.transport import KEPT_STREAM_QOS

PARAMETERS = [
    Parameter("bag", "", "bag to replay: a directory or a file", required=True),
    Parameter(
        "topics",
        [],
        "topics to replay, full names or unique endings; empty: all except hidden ones and those that command a rig",
        element=str,
    ),
    Parameter("rate", 1.0, "speed, bag time over real time; not in lockstep", minimum=0.001, maximum=1e6),
    Parameter("start_offset", 0.0, "s after the first of the messages, where to begin", minimum=0.0, maximum=1e9),
    Parameter("duration", 0.0, "s of the bag to replay; 0: to the end", minimum=0.0, maximum=1e9),
    Parameter("lockstep", False, "publish a response as soon as a brace_command has answered the previous one"),
    Parameter("lockstep_timeout", 10.0, "seconds without an answer that end a lockstep run", minimum=0.1),
]

SHOW_PERIOD = 0.1
"""Seconds between two updates of the progress line."""
FOUND_TIME = 1.0
"""Seconds within which a commander that has been found has found this node as well: its answer would be lost before."""
BATCH = 50
"""Messages published in a row of those that are due; services are answered after them."""


class Replay(AbraceNode):
    """Publishes raw messages when they are due, or in lockstep when the last sample has been answered."""

    def __init__(self) -> None:
        super().__init__("replay", PARAMETERS)
        given = self.parameters
        bag = bag_to_replay(given.bag, given.topics, given.start_offset, given.duration)
        self.playback = BagPlayback(bag, given.rate)
        answered = response_topic(bag) if given.lockstep else ""
        self.outputs = {name: self.output(topic) for name, topic in bag.topics.items()}
        for warning in bag.warnings:
            self.get_logger().warning(warning)
        self.responses = [self.outputs[name] for name, topic in bag.topics.items() if topic.type_name == RESPONSE_TYPE]
        self.answers: Answers | None = None
        if given.lockstep:
            self.answers = Answers(answered)
            self.samples = self.outputs[answered]
            topic = sibling_topic(self.samples.topic_name, COMMAND_TOPIC)
            self.commands = self.subscribe_to(BraceCommand, topic, self.on_command, KEPT_STREAM_QOS, raw=True)
        self.create_timer(SHOW_PERIOD, self.show, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.progress = Step(f"replay {given.bag}", sys.stderr, time.monotonic)
        self.began: float | None = None
        self.found: float | None = None
        self.due = time.monotonic()

    def output(self, topic: RecordedTopic) -> Publisher:
        """The publisher of a topic, with the recorded QoS."""
        check_type(topic)
        message_type = message_class(topic.name, topic.type_name)
        qos = replayed_qos(topic.qos, KEPT_STREAM_QOS.depth)
        try:
            return self.publish_on(message_type, topic.name, qos_profile(qos))
        except (RCLError, NameValidationException) as error:
            raise AbraceError(f"bag {self.parameters.bag}: topic {topic.name}: {rcl_message(error)}") from error

    def tick(self) -> None:
        """Play messages that are due; in lockstep the first sample, or end if an answer is overdue."""
        if self.answers is None:
            self.play_due()
        elif self.answers.missing is not None:
            self.due = None
            self.finish(
                1,
                f"no answer to sample {self.answers.missing} on {self.commands.topic_name} within "
                f"{self.parameters.lockstep_timeout:g} s (lockstep_timeout)",
            )
        elif self.began is None and not self.is_met():
            self.due = time.monotonic() + DISPLAY_PERIOD
        else:
            self.check_for_rig()
            if self.exit_code is None:
                self.play_sample()

    def is_met(self) -> bool:
        """Whether a commander has been there for FOUND_TIME."""
        now = time.monotonic()
        self.found = (self.found or now) if self.finds_commander(self.samples, self.commands) else None
        return self.found is not None and now >= self.found + FOUND_TIME

    def check_for_rig(self) -> None:
        """End if a rig publishes on a topic of samples that is replayed: answers to these would move the rig."""
        for output in self.responses:
            if self.exit_code is None and self.count_publishers(output.topic_name) > 1:
                others = endpoint_names(self.get_publishers_info_by_topic(output.topic_name))
                others.discard(self.get_fully_qualified_name())
                self.due = None
                self.finish(
                    1,
                    f"{output.topic_name} is published by {', '.join(sorted(others)) or 'another node'} as well, "
                    "expected a name (-r) or a ROS_DOMAIN_ID that no rig has",
                )

    def play_due(self) -> None:
        """Publish the messages that are due. Time begins here; otherwise a late first tick would be a burst."""
        self.began = self.began or time.monotonic()
        for _ in range(BATCH):
            self.due = self.playback.due(self.began)
            if self.due is None or self.due > time.monotonic():
                break
            self.publish(self.playback.next_message())
        self.end_at_the_last()

    def play_sample(self) -> None:
        """Publish all messages up to the next sample and the sample, and wait for the answer to it."""
        assert self.answers is not None
        self.began = self.began or time.monotonic()
        try:
            for message in self.answers.next_messages(self.playback):
                self.publish(message)
        except AbraceError as error:
            self.finish(1, f"bag {self.parameters.bag}: {error}")
            return
        self.due = time.monotonic() + self.parameters.lockstep_timeout
        if self.answers.missing is None:
            self.end_at_the_last()

    def publish(self, message: RawMessage) -> None:
        """Publish a message as it was recorded; end if the middleware refuses it."""
        if self.exit_code is not None:
            return
        try:
            self.outputs[message.topic].publish(message.payload)
        except RCLError as error:
            why = f"a message of {len(message.payload)} bytes can't be published: {rcl_message(error)}"
            self.finish(1, f"bag {self.parameters.bag}: topic {message.topic}: {why}")

    def on_command(self, payload: bytes) -> None:
        """A command answers a sample."""
        assert self.answers is not None
        try:
            answered = self.answers.receive(payload)
        except AbraceError as error:
            self.finish(1, f"{self.commands.topic_name}: {error}")
            return
        if answered and self.playback.ended:
            self.end_at_the_last()
        elif answered:
            self.play_sample()

    def end_at_the_last(self) -> None:
        """End when everything has been played."""
        if self.playback.ended and self.began is not None and self.exit_code is None:
            self.due = None
            seconds = time.monotonic() - self.began
            self.finish(0, f"done: {self.playback.played} messages in {seconds:.2f} s")

    def show(self) -> None:
        """Show the progress, and check that no rig publishes on the same topics."""
        self.check_for_rig()
        self.progress.update(self.playback.fraction, f"{self.playback.played} messages")

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `/diagnostics`."""
        message = "waiting for the controller" if self.began is None else "playing"
        return None, message, {"played": self.playback.played, "fraction": round(self.playback.fraction, 4)}

    def close(self) -> None:
        """Show how it ended, with the count of the last message."""
        self.progress.update(self.playback.fraction, f"{self.playback.played} messages")
        self.progress.close("done in" if self.exit_code == 0 else "failed after" if self.exit_code else "stopped after")


def main() -> int:
    """Entry point."""
    return run(Replay)
