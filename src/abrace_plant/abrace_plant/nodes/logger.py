"""The node `logger`: records topics, raw, to an MCAP bag that the standard tools read."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from abrace_core.bag import BagWriter, message_definition, offered_qos
from abrace_core.errors import AbraceError
from abrace_core.node import AbraceNode, Parameter, run

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
DEPTH = 1000
"""Messages that may wait for the logger on each topic: two seconds of samples."""


class Logger(AbraceNode):
    """Writes every message of its topics as it came from the wire."""

    def __init__(self) -> None:
        super().__init__("logger", PARAMETERS)
        given = self.parameters
        facts = dict(_fact(text) for text in given.facts)
        self.bag = BagWriter(given.output, facts)
        self.counts: dict[str, int] = {}
        self.missing = {self.resolve_topic_name(topic): topic for topic in given.topics}
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(LOOK_FOR_TOPICS, self.look_for_topics, clock=steady)
        self.create_timer(given.flush_interval, self.flush, clock=steady)

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
        self.counts[given_name] = 0
        self.subscribe_to(message_type, given_name, self.writer(topic_id, given_name), qos, raw=True)

    def writer(self, topic_id: int, name: str) -> Callable[[bytes], None]:
        """The callback that writes a topic's messages.

        Its one argument is the message: with a second one, for the times of the middleware, the events executor of
        rclpy 7.1 breaks. So a message's log time and publish time are both its arrival here.
        """
        write, counts, now = self.bag.write, self.counts, time.time_ns

        def on_message(payload: bytes) -> None:
            arrival = now()
            try:
                write(topic_id, payload, arrival, arrival)
            except AbraceError as error:
                self.finish(1, str(error))
            counts[name] += 1

        return on_message

    def flush(self) -> None:
        """Make everything so far outlive this process."""
        try:
            self.bag.flush()
        except AbraceError as error:
            self.finish(1, str(error))

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `diagnostics`."""
        values: dict[str, object] = {f"messages of {name}": count for name, count in self.counts.items()}
        if self.missing:
            values["not seen yet"] = ", ".join(sorted(self.missing.values()))
        return None, "recording", values

    def closing(self) -> None:
        """Close the bag."""
        self.bag.close()
        counts = ", ".join(f"{count} of {name}" for name, count in self.counts.items())
        print(f"logger: wrote {self.parameters.output}: {counts or 'nothing came'}", flush=True)


def _fact(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not (key and equals):
        raise AbraceError(f"parameter facts: {text!r}, expected key=value")
    return key, value


def main() -> int:
    """Entry point."""
    return run(Logger)
