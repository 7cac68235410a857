"""The node `logger`: records topics, raw, to an MCAP bag that the standard tools read."""

from __future__ import annotations

import importlib
import sys
import time
from dataclasses import dataclass

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from abrace_core.bag import BagWriter, message_definition, offered_qos
from abrace_core.errors import AbraceError
from abrace_core.node import AbraceNode, Parameter, RCLError, rcl_message, run

PARAMETERS = [
    Parameter("output", "", "bag (a new directory) to write", required=True),
    Parameter(
        "topics", ["response", "brace_command", "ground_motion", "diagnostics"], "topics to record", required=True
    ),
    Parameter("facts", [], "facts of the run, each as key=value, written into the bag", element=str),
    Parameter("flush_interval", 0.1, "s between flushes: what a killed logger may lose", minimum=0.01, maximum=10.0),
]

LOOK_FOR_TOPICS = 0.05
"""Seconds between looks for topics that have not appeared yet."""
TAKE_PERIOD = 0.005
"""Seconds between looks for messages, which the middleware has taken in; a callback for each would cost more."""
DEPTH = 5000
"""Messages that may wait for the logger on each topic: ten seconds of samples."""


@dataclass
class Recorded:
    """A topic that is being recorded.

    Parameters
    ----------
    subscription
        Whose messages are taken here, not by an executor.
    topic_id
        In the bag.
    publishers
        The most that there were at a time.
    count
        Messages written.
    last
        The middleware's number of the last message; 0: none yet.
    skipped
        Numbers of the middleware left out.
    """

    subscription: Subscription
    topic_id: int
    publishers: int
    count: int = 0
    last: int = 0
    skipped: int = 0

    @property
    def lost(self) -> int:
        """Messages lost, where one publisher alone has numbered them."""
        return self.skipped if self.publishers == 1 else 0


class Logger(AbraceNode):
    """Writes every message of its topics as it came from the wire.

    Its subscriptions belong to a hidden node that no executor turns: `tick` takes what has come.
    """

    def __init__(self) -> None:
        super().__init__("logger", PARAMETERS)
        given = self.parameters
        facts = dict(_fact(text) for text in given.facts)
        self.recorded: dict[str, Recorded] = {}
        self.matched = 0
        try:
            self.missing = {self.resolve_topic_name(topic): topic for topic in given.topics}
        except RCLError as error:
            raise AbraceError(f"parameter topics: {given.topics}, {rcl_message(error)}") from error
        self.bag = BagWriter(given.output, facts)
        self.input = rclpy.create_node(
            f"_{self.get_name()}_input",
            namespace=self.get_namespace(),
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(LOOK_FOR_TOPICS, self.look_for_topics, clock=steady)
        self.create_timer(given.flush_interval, self.flush, clock=steady)
        self.due = time.monotonic()

    def look_for_topics(self) -> None:
        """Subscribe to the topics that have appeared."""
        for name, given_name in list(self.missing.items()):
            publishers = self.get_publishers_info_by_topic(name)
            if publishers:
                del self.missing[name]
                try:
                    self.record(name, given_name, publishers)
                except AbraceError as error:
                    self.finish(1, str(error))
        matched = 0
        for topic in self.recorded.values():
            publishers = topic.subscription.get_publisher_count()
            topic.publishers = max(topic.publishers, publishers)
            matched += publishers
        if matched != self.matched:
            self.matched = matched
            self.publish_diagnostics()

    def record(self, name: str, given_name: str, publishers: list[TopicEndpointInfo]) -> None:
        """Subscribe to a topic as its publishers offer it."""
        types = {publisher.topic_type for publisher in publishers}
        if len(types) > 1:
            raise AbraceError(f"topic {name}: has the types {', '.join(sorted(types))}, expected one")
        definition = message_definition(types.pop())
        package, _, type_name = definition.type_name.split("/")
        message_type = getattr(importlib.import_module(f"{package}.msg"), type_name)
        offered = [publisher.qos_profile for publisher in publishers]
        reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in offered)
        kept = all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in offered)
        qos = QoSProfile(
            depth=DEPTH,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if kept else DurabilityPolicy.VOLATILE,
        )
        topic_id = self.bag.add_topic(
            name, definition.type_name, definition.text, definition.type_hash, offered_qos(offered[0])
        )
        subscription = self.input.create_subscription(message_type, name, _never_called, qos, raw=True)
        self.recorded[given_name] = Recorded(subscription, topic_id, len(publishers))

    def tick(self) -> None:
        """Write what has come."""
        self.due = time.monotonic() + TAKE_PERIOD
        try:
            for topic in self.recorded.values():
                self.take(topic)
        except AbraceError as error:
            self.finish(1, str(error))

    def take(self, topic: Recorded) -> None:
        """Write a topic's messages that have come."""
        write, topic_id, message_type = self.bag.write, topic.topic_id, topic.subscription.msg_type
        handle = topic.subscription.handle
        with handle:
            while (taken := handle.take_message(message_type, True)) is not None:
                payload, info = taken
                write(topic_id, payload, info["received_timestamp"], info["source_timestamp"])
                topic.count += 1
                number = info["publication_sequence_number"]
                if topic.last and number > topic.last + 1:
                    topic.skipped += number - topic.last - 1
                topic.last = number

    def flush(self) -> None:
        """Make everything so far outlive this process."""
        try:
            self.bag.flush()
        except AbraceError as error:
            self.finish(1, str(error))

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `diagnostics`."""
        values: dict[str, object] = {}
        for name, topic in self.recorded.items():
            values[f"publishers of {name}"] = topic.subscription.get_publisher_count()
            values[f"messages of {name}"] = topic.count
            values[f"lost of {name}"] = topic.lost
        if self.missing:
            values["not seen yet"] = ", ".join(sorted(self.missing.values()))
        return None, "recording", values

    def closing(self) -> None:
        """Take what is still there and close the bag."""
        if self.exit_code is None:
            self.tick()
        self.bag.close()
        self.input.destroy_node()
        counts = ", ".join(f"{topic.count} of {name}" for name, topic in self.recorded.items())
        lost = ", ".join(f"{topic.lost} of {name}" for name, topic in self.recorded.items() if topic.lost)
        print(f"logger: wrote {self.parameters.output}: {counts or 'nothing came'}", flush=True)
        if lost:
            print(f"logger: LOST {lost}", file=sys.stderr, flush=True)


def _never_called(message: bytes) -> None:
    """The callback that a subscription has to have."""


def _fact(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not (key and equals):
        raise AbraceError(f"parameter facts: {text!r}, expected key=value")
    return key, value


def main() -> int:
    """Entry point."""
    return run(Logger)
