# SPDX-License-Identifier: Apache-2.0
"""The node `logger`: records topics, without deserialising, to an MCAP bag that the standard tools read.

abrace run abrace_bags logger --ros-args -p output:=bags/first -p topics:=[response,brace_command]
"""

from __future__ import annotations

import contextlib
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import rclpy
from rclpy.clock import Clock, ClockType
from std_srvs.srv import Trigger

from abrace_bags import BagWriter
from abrace_bags.mcap.attachments import file_attachments
from abrace_bags.metadata import installed_versions
from abrace_bags.nodes.endpoint import Publisher, publishers_of
from abrace_bags.nodes.raw_subscription import DEPTH, RawSubscription
from abrace_bags.recording import SAMPLE_TYPES, Recording, parse_every, parse_facts
from abrace_bags.run import RESPONSE_TYPE
from abrace_bags.topics import EVERY
from abrace_core import AbraceError
from abrace_core.files.suggestion import expected_of
from abrace_core.safety.wire import LOCKSTEP, Responses
from abrace_node.node import AbraceNode, RCLError, rcl_message
from abrace_node.parameters import Parameter
from abrace_node.process import run

PARAMETERS = [
    Parameter("output", "", "bag (a new directory) to write", required=True),
    Parameter("topics", ["response", "brace_command", "ground_motion", "/diagnostics"], "topics to record, by name"),
    Parameter(
        "every",
        [],
        "topics of which less is recorded, each as topic=n: of n messages that whose sequence n divides; of topics "
        "without one every n-th that comes",
        element=str,
    ),
    Parameter("facts", [], "facts of the run, each as key=value, written into the bag", element=str),
    Parameter("attachments", [], "files of the run that go into the bag: rig, model, controller, record", element=str),
    Parameter("split_size", 2**30, "bytes after which the next file begins; 0: when its index takes 64 MiB", minimum=0),
    Parameter("split_duration", 3600.0, "s after which the next file begins; 0.0: never", minimum=0.0, maximum=1e9),
    Parameter("autostart", True, "record at once; false: wait for `~/start`"),
    Parameter("flush_interval", 0.1, "s between flushes: what a killed logger may lose", minimum=0.01, maximum=10.0),
    Parameter("sync_interval", 0.5, "s between syncs: what a power loss may lose as well", minimum=0.1, maximum=600.0),
    Parameter(
        "lockstep", False, "log times are stamps of the rig's samples, not the clock's; the rig waits for the logger"
    ),
]

SERVICES = ("start", "stop")
"""Each is a method of the node, which returns the answer."""
DISCOVERY_PERIOD = 0.05
"""Seconds between searches for topics that have not appeared yet."""
RECEIVE_PERIOD = 0.005
"""Seconds between polls for messages, which wait in the middleware; a callback for each would cost more."""
MOST_AT_ONCE = 500
"""Messages received of a topic in one turn, so that the logger also answers, and can be stopped, in a flood."""


@dataclass
class Topic:
    """A topic that is being recorded: its subscription, its number in the bag."""

    subscription: RawSubscription
    topic_id: int
    untimed: bool = False
    """Whether messages without a valid time have been reported."""
    last: bytes = b""
    """The last message of the control loop."""


class Logger(AbraceNode):
    """Records every message of its topics as it comes from the wire.

    Its subscriptions belong to a hidden node; `tick` receives their messages.
    """

    def __init__(self) -> None:
        super().__init__("logger", PARAMETERS)
        given = self.parameters
        self.facts = parse_facts(given.facts)
        try:
            self.given_names = {self.resolve_topic_name(topic): topic for topic in given.topics if topic}
        except RCLError as error:
            raise AbraceError(f"parameter topics: {given.topics}, {rcl_message(error)}") from error
        if not self.given_names:
            raise AbraceError("parameter topics: no topic, expected names")
        self.every = self.read_every()
        self.facts |= {f"{EVERY}{name}": str(number) for name, number in self.every.items()}
        self.attachments = file_attachments([Path(path) for path in given.attachments])
        self.topics: dict[str, Topic] = {}
        self.errors: dict[str, str] = {}
        # of topics that can't be recorded, how many publishers and which types they had
        self.refused: dict[str, tuple[int, list[str]]] = {}
        self.recording: Recording | None = None
        self.bags = 0
        self.matched = 0
        self.input = rclpy.create_node(
            f"_{self.get_name()}_input",
            namespace=self.get_namespace(),
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        for name in SERVICES:
            self.create_service(Trigger, f"~/{name}", partial(self.answer, getattr(self, name)))
        self.create_timer(DISCOVERY_PERIOD, self.discover, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.due = time.monotonic()

    def read_every(self) -> dict[str, int]:
        """Of how many messages of a topic one is recorded, by its whole name; of others all are."""
        found = {}
        for topic, number in parse_every(self.parameters.every).items():
            try:
                name = self.resolve_topic_name(topic)
            except RCLError as error:
                raise AbraceError(f"parameter every: {topic!r}, {rcl_message(error)}") from error
            if name not in self.given_names:
                expected = expected_of(topic, list(self.given_names.values()))
                raise AbraceError(f"parameter every: {topic} is not among the topics, {expected}")
            found[name] = number
        return found

    def autostart(self) -> None:
        """Record at once, if the parameter `autostart` is true."""
        if self.parameters.autostart:
            self.start()

    def discover(self) -> None:
        """Subscribe to topics that have appeared, and again where a publisher offers a weaker QoS than those before."""
        if self.recording is None or self.exit_code is not None:
            return
        found = dict(self.get_topic_names_and_types())
        for name in sorted(found.keys() & self.given_names.keys()):
            topic = self.topics.get(name)
            state = (self.count_publishers(name), found[name])
            known = topic is not None and topic.subscription.count_publishers() == state[0]
            if self.refused.get(name) == state or (known and len(found[name]) == 1):
                continue
            publishers = publishers_of(self, name)
            if not publishers:
                continue
            try:
                if topic is None:
                    self.record(name, publishers)
                else:
                    topic.subscription.follow(publishers)
            except AbraceError as error:
                self.refused[name] = state
                self.report(name, error)
        matched = sum(topic.subscription.count_publishers() for topic in self.topics.values())
        if matched != self.matched:
            self.matched = matched
            self.publish_diagnostics()

    def record(self, name: str, publishers: list[Publisher]) -> None:
        """Subscribe to a topic."""
        subscription = RawSubscription(self.input, name, publishers, self.parameters.lockstep, self.every.get(name, 1))
        definition = subscription.definition
        offers = [publisher.qos for publisher in publishers]
        topic_id = self.open_recording().add_topic(
            name, definition.type_name, definition.text, definition.type_hash, *offers
        )
        self.topics[name] = Topic(subscription, topic_id)

    def report(self, name: str, error: AbraceError) -> None:
        """Report a topic that can't be recorded, now and at the end; the others are still recorded."""
        if self.errors.get(name) == str(error):
            return
        self.errors[name] = str(error)
        self.publish_diagnostics()

    def tick(self) -> None:
        """Receive messages."""
        self.due = time.monotonic() + RECEIVE_PERIOD
        if self.recording is None:
            return
        try:
            self.recording.check()
            for topic in self.topics.values():
                if self.receive(topic, MOST_AT_ONCE) == MOST_AT_ONCE:
                    self.due = time.monotonic()
        except AbraceError as error:
            self.finish(1, str(error))

    def receive(self, topic: Topic, most: int) -> int:
        """Receive a topic's messages that have come, `most` of them; returns how many those were."""
        recording = self.open_recording()
        of_loop = topic.subscription.definition.type_name in SAMPLE_TYPES
        write = partial(self.write_once, topic) if of_loop else partial(recording.write, topic.topic_id)
        received = topic.subscription.receive(most, write)
        if not topic.untimed and topic.topic_id in recording.untimed:
            topic.untimed = True
            name = topic.subscription.topic
            self.get_logger().warning(f"{name}: messages without a valid time, the logger gives them its own")
        return received

    def write_once(self, topic: Topic, payload: bytes, received: int, published: int) -> None:
        """Record a message, as in `Recording.write`, but in lockstep none that is the one before said again.

        A rig in lockstep says its first sample again until it is answered; by the clock equal answers are of two nodes.
        """
        if payload != topic.last or not self.in_lockstep():
            topic.last = payload
            self.open_recording().write(topic.topic_id, payload, received, published)

    def in_lockstep(self) -> bool:
        """Whether the last response, if one is recorded, is of a rig in lockstep; otherwise the parameter."""
        for topic in self.topics.values():
            if topic.subscription.definition.type_name == RESPONSE_TYPE and topic.last:
                with contextlib.suppress(AbraceError):
                    return bool(Responses().unpack(topic.last)[1].flags & LOCKSTEP)
        return bool(self.parameters.lockstep)

    def open_recording(self) -> Recording:
        """What is being recorded."""
        if self.recording is None:
            raise AbraceError("nothing is being recorded, expected ~/start before")
        return self.recording

    def answer(self, service: Callable[[], str], _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Call a service's method, and answer with what it returns or why it can't be done."""
        try:
            response.message, response.success = service(), True
        except AbraceError as error:
            response.message, response.success = str(error), False
        self.publish_diagnostics()
        return response

    def start(self) -> str:
        """Open the bag, or after a stop the next one."""
        if self.recording is not None:
            raise AbraceError("a bag is being recorded already")
        given = self.parameters
        directory = Path(given.output)
        if self.bags:
            directory = directory.with_name(f"{directory.name}_{self.bags + 1}")
        records = {
            "abrace_versions": installed_versions(),
            "abrace_logger": {parameter.name: json.dumps(getattr(given, parameter.name)) for parameter in PARAMETERS},
        }
        bag = BagWriter(
            directory,
            self.facts,
            records=records,
            attachments=self.attachments,
            split_size=given.split_size,
            split_duration=given.split_duration,
        )
        self.recording = Recording(
            bag, given.flush_interval, sync_interval=given.sync_interval, lockstep=given.lockstep
        )
        self.bags += 1
        return f"recording {directory}"

    def stop(self) -> str:
        """Receive the last messages and close the bag; the node stays, for another start."""
        recording = self.open_recording()
        for topic in self.topics.values():
            self.receive(topic, DEPTH)
        not_received = {topic.topic_id: topic.subscription.lost for topic in self.topics.values()}
        self.recording = None
        # before the bag is closed, which may take a while: what comes meanwhile would be kept in memory
        for topic in self.topics.values():
            topic.subscription.close()
        self.topics = {}
        bag = recording.close(not_received)
        counts = {self.given_names[name]: one for name, one in bag.contents().items()}
        lost = ", ".join(f"{one.lost} of {name}" for name, one in counts.items() if one.lost)
        if lost:
            self.get_logger().error(f"lost {lost}")
        messages = ", ".join(f"{one.messages} of {name}" for name, one in counts.items())
        return f"wrote {bag.directory}: {messages or 'nothing came'}"

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `/diagnostics`."""
        values: dict[str, object] = {}
        recording = self.recording
        dropped, untimed = (recording.dropped, recording.untimed) if recording else ({}, {})
        if recording:
            values["file"] = recording.file
        for name, topic in self.topics.items():
            shown = self.given_names[name]
            values[f"publishers of {shown}"] = topic.subscription.count_publishers()
            values[f"messages of {shown}"] = topic.subscription.kept
            values[f"lost of {shown}"] = topic.subscription.lost + dropped.get(topic.topic_id, 0)
            if topic.topic_id in untimed:
                values[f"without a valid time of {shown}"] = untimed[topic.topic_id]
        missing = sorted(given for name, given in self.given_names.items() if name not in self.topics)
        if missing:
            values["not seen yet"] = ", ".join(missing)
        fault = "the disk is too slow, messages are dropped" if dropped else None
        if self.errors:
            fault = "; ".join([*self.errors.values(), *([fault] if fault else [])])
        return fault, "recording" if recording else "stopped", values

    def close(self) -> None:
        """Receive the last messages and close the bag."""
        try:
            if self.recording is not None:
                print(f"logger: {self.stop()}", flush=True)
        except AbraceError:
            if self.exit_code is None:
                raise
        finally:
            self.input.destroy_node()
        if self.errors:
            raise AbraceError(f"{len(self.errors)} topics not recorded as requested: {', '.join(self.errors)}")


def main() -> int:
    """Entry point."""
    return run(Logger)


if __name__ == "__main__":
    sys.exit(main())
