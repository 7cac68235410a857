"""The node `logger`: records topics, raw, to an MCAP bag that the standard tools read."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_srvs.srv import Trigger

from abrace_bags import BagWriter, offered_qos
from abrace_bags.mcap.attachments import file_attachments
from abrace_bags.nodes.raw_subscription import DEPTH, RawSubscription
from abrace_bags.snapshot import Snapshot
from abrace_bags.topic_choice import TopicChoice
from abrace_bags.versions import installed_versions
from abrace_bags.writing_thread import WritingThread
from abrace_core.errors import AbraceError
from abrace_core.node import AbraceNode, Parameter, RCLError, rcl_message, run

PARAMETERS = [
    Parameter("output", "", "bag (a new directory) to write", required=True),
    Parameter("topics", ["response", "brace_command", "ground_motion", "diagnostics"], "topics to record, by name"),
    Parameter("pattern", "", "regular expression: topics are recorded too in whose full names it is found"),
    Parameter("all", False, "record all topics but hidden ones"),
    Parameter("facts", [], "facts of the run, each as key=value, written into the bag", element=str),
    Parameter("attachments", [], "files of the run that go into the bag: rig, model, controller, record", element=str),
    Parameter("compression", "zstd", "of each chunk", choices=("zstd", "lz4", "none")),
    Parameter("split_size", 0, "bytes after which the next file begins; 0: one file", minimum=0),
    Parameter("split_duration", 0.0, "s after which the next file begins; 0: one file", minimum=0.0, maximum=1e9),
    Parameter("snapshot", 0.0, "s to keep in memory, written on `~/snapshot` alone; 0: all", minimum=0.0, maximum=1e6),
    Parameter("autostart", True, "record at once; false: wait for `~/start`"),
    Parameter("flush_interval", 0.1, "s between flushes: what a killed logger may lose", minimum=0.01, maximum=10.0),
]

LOOK_FOR_TOPICS = 0.05
"""Seconds between looks for topics that have not appeared yet."""
TAKE_PERIOD = 0.005
"""Seconds between looks for messages, which the middleware has taken in; a callback for each would cost more."""
MOST_AT_ONCE = 500
"""Messages taken of a topic before the others' turn: in a flood, too, the logger answers and can be stopped."""


@dataclass
class Recorded:
    """A topic that is being recorded.

    Parameters
    ----------
    subscription
        Where its messages come from.
    topic_id
        In the bag.
    count
        Messages taken for the bag.
    """

    subscription: RawSubscription
    topic_id: int
    count: int = 0


class Logger(AbraceNode):
    """Writes every message of its topics as it came from the wire.

    Its subscriptions belong to a hidden node: `tick` takes what has come.
    """

    def __init__(self) -> None:
        super().__init__("logger", PARAMETERS)
        given = self.parameters
        facts = [_fact(text) for text in given.facts]
        self.facts = dict(facts)
        if len(self.facts) < len(facts):
            raise AbraceError(f"parameter facts: {given.facts}, expected each key once")
        try:
            self.given_names = {self.resolve_topic_name(topic): topic for topic in given.topics if topic}
        except RCLError as error:
            raise AbraceError(f"parameter topics: {given.topics}, {rcl_message(error)}") from error
        self.choice = TopicChoice(frozenset(self.given_names), given.pattern, given.all)
        self.attachments = file_attachments([Path(path) for path in given.attachments])
        self.recorded: dict[str, Recorded] = {}
        self.complaints: dict[str, str] = {}
        # of topics that can't be recorded, how many publishers and which types were there
        self.refused: dict[str, tuple[int, list[str]]] = {}
        self.writing: WritingThread | None = None
        self.snapshot: Snapshot | None = None
        self.paused = False
        self.bags = 0
        self.matched = 0
        self.input = rclpy.create_node(
            f"_{self.get_name()}_input",
            namespace=self.get_namespace(),
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        for name in ("start", "stop", "pause", "resume", "split", "snapshot"):
            self.create_service(Trigger, f"~/{name}", getattr(self, f"on_{name}"))
        self.create_timer(LOOK_FOR_TOPICS, self.look_for_topics, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.due = time.monotonic()
        if given.autostart:
            self.start()

    def start(self) -> Path:
        """Open the bag, or after a stop the next one."""
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
            compression=given.compression,
            split_size=given.split_size,
            split_duration=given.split_duration,
        )
        self.writing = WritingThread(bag, given.flush_interval)
        self.snapshot = Snapshot(given.snapshot) if given.snapshot else None
        self.bags += 1
        self.paused = False
        return directory

    def stop(self) -> str:
        """Take what is still there and close the bag; returns what there is to say of it."""
        writing = self.open_bag()
        try:
            self.take_all()
            with writing.bag() as bag:
                directory = bag.directory
                for topic in self.recorded.values():
                    bag.add_lost(topic.topic_id, topic.subscription.lost)
            writing.close()
            tallies = bag.tallies()
        finally:
            self.writing = None
            for topic in self.recorded.values():
                topic.subscription.close()
            self.recorded = {}
        shown = {self.given_names.get(name, name): tally for name, tally in tallies.items()}
        lost = ", ".join(f"{tally.lost} of {name}" for name, tally in shown.items() if tally.lost)
        if lost:
            print(f"logger: LOST {lost}", file=sys.stderr, flush=True)
        counts = ", ".join(f"{tally.messages} of {name}" for name, tally in shown.items())
        return f"wrote {directory}: {counts or 'nothing came'}"

    def open_bag(self) -> WritingThread:
        """What writes the bag."""
        if self.writing is None:
            raise AbraceError("nothing is being recorded, expected ~/start before")
        return self.writing

    def look_for_topics(self) -> None:
        """Subscribe to topics that have appeared, and anew to those that offer less than before."""
        if self.writing is None or self.exit_code is not None:
            return
        there = dict(self.get_topic_names_and_types())
        for name in sorted(self.choice.of(there)):
            topic = self.recorded.get(name)
            seen = (self.count_publishers(name), there[name])
            known = topic is not None and topic.subscription.count_publishers() == seen[0]
            if self.refused.get(name) == seen or (known and len(there[name]) == 1):
                continue
            publishers = self.get_publishers_info_by_topic(name)
            if not publishers:
                continue
            try:
                if topic is None:
                    self.record(name, publishers)
                else:
                    taken = topic.subscription.follow(publishers, self.writer(topic))
                    topic.count += taken if self.wants(topic) else 0
            except AbraceError as error:
                self.refused[name] = seen
                self.complain(name, error)
        matched = sum(topic.subscription.count_publishers() for topic in self.recorded.values())
        if matched != self.matched:
            self.matched = matched
            self.publish_diagnostics()

    def complain(self, name: str, error: AbraceError) -> None:
        """Tell of a topic that can't be recorded, at once and at the end; the others are recorded all the same."""
        if self.complaints.get(name) == str(error):
            return
        self.complaints[name] = str(error)
        print(f"logger: {error}", file=sys.stderr, flush=True)
        self.publish_diagnostics()

    def record(self, name: str, publishers: list[TopicEndpointInfo]) -> None:
        """Subscribe to a topic."""
        subscription = RawSubscription(self.input, name, publishers)
        definition = subscription.definition
        offered = [offered_qos(publisher.qos_profile) for publisher in publishers]
        with self.open_bag().bag() as bag:
            topic_id = bag.add_topic(name, definition.type_name, definition.text, definition.type_hash, *offered)
        self.recorded[name] = Recorded(subscription, topic_id)

    def tick(self) -> None:
        """Take what has come."""
        self.due = time.monotonic() + TAKE_PERIOD
        if self.writing is None:
            return
        try:
            self.writing.check()
            for topic in self.recorded.values():
                if self.take(topic, MOST_AT_ONCE) == MOST_AT_ONCE:
                    self.due = time.monotonic()
        except AbraceError as error:
            self.finish(1, str(error))

    def take_all(self) -> None:
        """Take all that has come."""
        for topic in self.recorded.values():
            self.take(topic, DEPTH)

    def take(self, topic: Recorded, most: int) -> int:
        """Take a topic's messages that have come, `most` of them; returns how many those were."""
        taken = topic.subscription.take(most, self.writer(topic))
        if self.wants(topic):
            topic.count += taken
        return taken

    def wants(self, topic: Recorded) -> bool:
        """Whether what comes is recorded: while the logger pauses only what holds on."""
        return not self.paused or topic.subscription.latched

    def writer(self, topic: Recorded) -> Callable[[bytes, int, int], None]:
        """Where a topic's messages go."""
        if not self.wants(topic):
            return _leave_out
        to = self.open_bag() if self.snapshot is None else self.snapshot
        return partial(to.write, topic.topic_id)

    def on_start(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Open a bag."""

        def step() -> str:
            if self.writing is not None:
                raise AbraceError("a bag is being recorded already")
            return f"recording {self.start()}"

        return self.answer(response, step)

    def on_stop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Close the bag; the node stays, for another start."""
        return self.answer(response, self.stop)

    def on_pause(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Leave out what comes from here on."""

        def step() -> str:
            self.open_bag()
            self.take_all()
            self.paused = True
            return "paused"

        return self.answer(response, step)

    def on_resume(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Record again."""

        def step() -> str:
            writing = self.open_bag()
            if self.paused:
                self.take_all()
                self.paused = False
                if self.snapshot is not None:
                    self.snapshot.interrupt()
                with writing.bag() as bag:
                    bag.interrupt()
            return "recording"

        return self.answer(response, step)

    def on_split(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Go on in the next file."""

        def step() -> str:
            writing = self.open_bag()
            self.take_all()
            with writing.bag() as bag:
                bag.split()
                return f"recording {bag.file}"

        return self.answer(response, step)

    def on_snapshot(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Write what is in memory."""

        def step() -> str:
            if self.snapshot is None:
                raise AbraceError("parameter snapshot is 0: everything is written at once")
            writing = self.open_bag()
            self.take_all()
            with writing.bag() as bag:
                return f"wrote {self.snapshot.hand_to(bag)} messages to {bag.file}"

        return self.answer(response, step)

    def answer(self, response: Trigger.Response, step: Callable[[], str]) -> Trigger.Response:
        """Answer a service with what a step says, or why it was not taken."""
        try:
            response.message, response.success = step(), True
        except AbraceError as error:
            response.message, response.success = str(error), False
        self.publish_diagnostics()
        return response

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `diagnostics`."""
        values: dict[str, object] = {}
        overflowed = self.writing.overflowed if self.writing else {}
        for name, topic in self.recorded.items():
            shown = self.given_names.get(name, name)
            values[f"publishers of {shown}"] = topic.subscription.count_publishers()
            values[f"messages of {shown}"] = topic.count
            values[f"lost of {shown}"] = topic.subscription.lost + overflowed.get(topic.topic_id, 0)
        missing = sorted(given for name, given in self.given_names.items() if name not in self.recorded)
        if missing:
            values["not seen yet"] = ", ".join(missing)
        fault = "the disk is too slow, messages are left out" if overflowed else None
        if self.complaints:
            fault = "; ".join([*self.complaints.values(), *([fault] if fault else [])])
        return fault, "stopped" if self.writing is None else "paused" if self.paused else "recording", values

    def close(self) -> None:
        """Take what is still there and close the bag."""
        try:
            if self.writing is not None:
                print(f"logger: {self.stop()}", flush=True)
        except AbraceError:
            if self.exit_code is None:
                raise
        finally:
            self.input.destroy_node()
        if self.complaints:
            raise AbraceError(f"{len(self.complaints)} topics not recorded as asked: {', '.join(self.complaints)}")


def _leave_out(payload: bytes, arrived: int, published: int) -> None:
    """Takes what is not recorded."""


def _fact(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not (key and equals):
        raise AbraceError(f"parameter facts: {text!r}, expected key=value")
    return key, value


def main() -> int:
    """Entry point."""
    return run(Logger)


if __name__ == "__main__":
    sys.exit(main())
