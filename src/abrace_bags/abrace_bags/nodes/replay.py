"""The node `replay`: publishes a bag's messages again as they came from the wire, by the clock or in lockstep."""

from __future__ import annotations

import importlib
import sys
import time

from builtin_interfaces.msg import Time
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.exceptions import NameValidationException
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from rosgraph_msgs.msg import Clock as ClockMessage
from std_srvs.srv import SetBool, Trigger

from abrace_bags.playback import (
    COMMAND_TOPIC,
    RESPONSE_TYPE,
    Answers,
    BagPlayback,
    beside,
    check_type,
    excerpt,
    response_topic,
    without_commands,
)
from abrace_bags.qos import RecordedQos
from abrace_bags.raw import RawMessage, RecordedTopic, read_raw
from abrace_core.errors import AbraceError
from abrace_core.node import DISPLAY_PERIOD, KEPT_STREAM_QOS, AbraceNode, Parameter, RCLError, rcl_message, run
from abrace_core.progress import Step
from abrace_interfaces.msg import BraceCommand

PARAMETERS = [
    Parameter("bag", "", "bag to replay: a directory or a file", required=True),
    Parameter("topics", [], "topics to replay, whole names or ends of them; empty: all that no rig obeys", element=str),
    Parameter("rate", 1.0, "bag time over time; not in lockstep", minimum=0.001, maximum=1e6),
    Parameter("loop", False, "begin again at the end"),
    Parameter("start_offset", 0.0, "s after the first of the messages, where to begin", minimum=0.0, maximum=1e9),
    Parameter("duration", 0.0, "s of the bag to replay; 0: to the end", minimum=0.0, maximum=1e9),
    Parameter("clock", False, "publish /clock: the bag's time, 50 times a second"),
    Parameter("start_paused", False, "wait for ~/pause or ~/step"),
    Parameter("lockstep", False, "publish the next response as soon as a brace_command has answered the last"),
    Parameter("lockstep_timeout", 10.0, "seconds without an answer that end a lockstep run", minimum=0.1),
]

SHOW_PERIOD = 0.1
"""Seconds between two looks at the progress."""
BATCH = 50
"""Messages published in a row of those that are due; services are heard after them."""
CLOCK = "/clock"
CLOCK_END = 2**31 * 10**9
"""Its seconds have 31 bits [ns]."""
UNKNOWN = "_NODE_NAME_UNKNOWN_"
"""Name of a node of which no more than a topic has been discovered."""


class Replay(AbraceNode):
    """Publishes raw messages when they are due, or when the one before has been answered."""

    def __init__(self) -> None:
        super().__init__("replay", PARAMETERS)
        given = self.parameters
        bag = read_raw(given.bag, given.topics)
        bag = bag if given.topics else without_commands(bag)
        try:
            messages = excerpt(bag.messages, given.start_offset, given.duration)
        except AbraceError as error:
            raise AbraceError("; ".join([f"bag {given.bag}: {error}", *bag.warnings])) from error
        self.playback = BagPlayback(messages, given.rate, given.loop)
        answered = response_topic(bag.topics, messages) if given.lockstep else ""
        if given.clock and CLOCK in bag.topics:
            raise AbraceError(f"parameter clock: {CLOCK} of the bag is replayed, expected one of the two")
        if given.clock and not 0 <= messages[0].log_time <= messages[-1].log_time < CLOCK_END:
            raise AbraceError(f"parameter clock: /clock can't have the times of {given.bag}, expected 1970 to 2038")
        self.outputs = {name: self.output(topic) for name, topic in bag.topics.items()}
        for warning in bag.warnings:
            self.get_logger().warning(warning)
        self.responses = [self.outputs[name] for name, topic in bag.topics.items() if topic.type_name == RESPONSE_TYPE]
        self.answers: Answers | None = None
        if given.lockstep:
            self.answers = Answers(answered)
            self.samples = self.outputs[answered]
            topic = beside(self.samples.topic_name, COMMAND_TOPIC)
            self.commands = self.subscribe_to(BraceCommand, topic, self.on_command, KEPT_STREAM_QOS, raw=True)
        self.create_service(SetBool, "~/pause", self.on_pause)
        self.create_service(Trigger, "~/step", self.on_step)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        if given.clock:
            self.clock_output = self.create_publisher(ClockMessage, CLOCK, 10)
            self.create_timer(DISPLAY_PERIOD, self.publish_clock, clock=steady)
        self.create_timer(SHOW_PERIOD, self.show, clock=steady)
        self.progress = Step(f"replay {given.bag}", sys.stderr, time.monotonic)
        self.paused = given.start_paused
        self.began: float | None = None
        self.go_on()

    def output(self, topic: RecordedTopic) -> Publisher:
        """The publisher of a topic, with the QoS that was offered."""
        try:
            return self.publish_on(message_class(topic), topic.name, qos(topic.qos))
        except (RCLError, NameValidationException) as error:
            raise AbraceError(f"bag {self.parameters.bag}: topic {topic.name}: {rcl_message(error)}") from error

    def go_on(self) -> None:
        """Play from where it stands; while paused, stand."""
        now = time.monotonic()
        if self.paused:
            self.playback.stop_clock(now)
        self.due = None if self.paused else now

    def tick(self) -> None:
        """Messages are due; in lockstep: the first is, or an answer is overdue."""
        if self.answers is None:
            self.play_due()
        elif self.answers.missing is not None:
            self.due = None
            self.finish(
                1,
                f"no answer to sample {self.answers.missing} on {self.commands.topic_name} within "
                f"{self.parameters.lockstep_timeout:g} s (lockstep_timeout)",
            )
        elif self.began is None and not self.matched():
            self.due = time.monotonic() + DISPLAY_PERIOD
        else:
            self.look_for_a_rig()
            if self.exit_code is None:
                self.play_sample()

    def matched(self) -> bool:
        """Whether a node that publishes commands takes the samples; others may take them, too."""
        takers = self.get_subscriptions_info_by_topic(self.samples.topic_name)
        commanders = self.get_publishers_info_by_topic(self.commands.topic_name)
        return not node_names(takers).isdisjoint(node_names(commanders))

    def look_for_a_rig(self) -> None:
        """End beside a rig that publishes samples where ours go: who answers would mix them up, and move the rig."""
        for output in self.responses:
            if self.exit_code is None and self.count_publishers(output.topic_name) > 1:
                others = node_names(self.get_publishers_info_by_topic(output.topic_name))
                others.discard(self.get_fully_qualified_name())
                self.due = None
                self.finish(
                    1,
                    f"{output.topic_name} is published by {', '.join(sorted(others)) or 'another node'} as well, "
                    "expected a name (-r) or a ROS_DOMAIN_ID that no rig has",
                )

    def play_due(self) -> None:
        """Publish what is due by the clock, which starts here: what a late tick missed would come as a burst."""
        now = time.monotonic()
        self.began = self.began or now
        self.playback.start_clock(now)
        for _ in range(BATCH):
            if self.playback.due is None or self.playback.due > time.monotonic():
                break
            self.publish(self.playback.take())
        self.due = self.playback.due
        self.end_at_the_last()

    def play_sample(self) -> None:
        """Publish everything up to and with the next sample, which is then waited for."""
        assert self.answers is not None
        self.began = self.began or time.monotonic()
        try:
            while self.answers.missing is None and not self.playback.ended:
                message = self.playback.take_early()
                self.answers.played(message)
                self.publish(message)
        except AbraceError as error:
            self.finish(1, f"bag {self.parameters.bag}: {error}")
            return
        self.due = time.monotonic() + self.parameters.lockstep_timeout
        if self.answers.missing is None:
            self.end_at_the_last()

    def publish(self, message: RawMessage) -> None:
        """Publish a message as it was recorded; one that the middleware does not take is the end."""
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
            answered = self.answers.take(payload)
        except AbraceError as error:
            self.finish(1, f"{self.commands.topic_name}: {error}")
            return
        if answered and self.playback.ended:
            self.end_at_the_last()
        elif answered and self.paused:
            self.due = None
        elif answered:
            self.play_sample()

    def end_at_the_last(self) -> None:
        """End when everything has been played."""
        if self.playback.ended and self.began is not None and self.exit_code is None:
            self.due = None
            seconds = time.monotonic() - self.began
            self.finish(0, f"done: {self.playback.played} messages in {seconds:.2f} s")

    def on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        """Pause, or go on."""
        waiting = self.answers is not None and self.answers.missing is not None
        self.paused = request.data
        if not waiting:
            self.go_on()
        response.success = True
        response.message = "paused" if self.paused else "playing"
        return response

    def on_step(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Publish the next message; in lockstep everything up to the next sample."""
        refusal = ""
        if not self.paused:
            refusal = "playing, expected to be paused"
        elif self.playback.ended:
            refusal = "the last message has been played"
        elif self.answers is not None and self.answers.missing is not None:
            refusal = f"sample {self.answers.missing} has not been answered"
        elif self.answers is not None and not self.matched():
            refusal = f"no node takes {self.samples.topic_name} and publishes {self.commands.topic_name} yet"
        response.success = not refusal
        response.message = refusal
        if refusal:
            return response
        if self.answers is not None:
            self.play_sample()
        else:
            self.began = self.began or time.monotonic()
            self.publish(self.playback.take_early())
            self.end_at_the_last()
        response.message = f"{self.playback.played} messages played"
        return response

    def publish_clock(self) -> None:
        """Publish the bag's time."""
        seconds, nanoseconds = divmod(self.playback.bag_time(time.monotonic()), 10**9)
        self.clock_output.publish(ClockMessage(clock=Time(sec=seconds, nanosec=nanoseconds)))

    def show(self) -> None:
        """Show how far it is, and see to it that no rig is near."""
        self.look_for_a_rig()
        self.progress.update(self.playback.fraction, f"{self.playback.played} messages")

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `diagnostics`."""
        message = "paused" if self.paused else "waiting for the controller" if self.began is None else "playing"
        return None, message, {"played": self.playback.played, "fraction": round(self.playback.fraction, 4)}

    def close(self) -> None:
        """Say how it ended."""
        self.progress.close("done in" if self.exit_code == 0 else "failed after" if self.exit_code else "stopped after")


def message_class(topic: RecordedTopic) -> type:
    """The installed type of a recorded topic, if it is the same one."""
    check_type(topic)
    package, _, name = topic.type_name.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise AbraceError(f"topic {topic.name}: {topic.type_name} is not installed for Python ({error})") from error


def node_names(endpoints: list[TopicEndpointInfo]) -> set[str]:
    """Full names of the nodes that are known by theirs."""
    return {
        f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"
        for endpoint in endpoints
        if endpoint.node_name != UNKNOWN
    }


def qos(recorded: RecordedQos) -> QoSProfile:
    """The profile that offers what was offered; not latched, more is kept for readers that are late."""
    kept = KEPT_STREAM_QOS.depth
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if recorded.keep_all else HistoryPolicy.KEEP_LAST,
        depth=recorded.depth or kept if recorded.latched else max(recorded.depth, kept),
        reliability=ReliabilityPolicy.RELIABLE if recorded.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if recorded.latched else DurabilityPolicy.VOLATILE,
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC if recorded.manual_liveliness else LivelinessPolicy.AUTOMATIC,
        deadline=Duration(nanoseconds=recorded.deadline),
        lifespan=Duration(nanoseconds=recorded.lifespan),
        liveliness_lease_duration=Duration(nanoseconds=recorded.lease),
    )


def main() -> int:
    """Entry point."""
    return run(Replay)
