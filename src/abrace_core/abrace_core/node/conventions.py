# SPDX-License-Identifier: Apache-2.0
"""The conventions of all nodes: QoS, live parameters, diagnostics, the end of the process."""

from __future__ import annotations

import contextlib
import inspect
import os
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from types import FrameType
from typing import Any, cast

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.executors import Executor
from rclpy.experimental import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.time_source import CLOCK_TOPIC

from abrace_core.errors import AbraceError
from abrace_core.node import transport
from abrace_core.node.parameters import Parameter, as_given, declare, parameter_help, refuse_unknown_types

RCLError = rclpy_implementation.RCLError

ACKNOWLEDGEMENT_TIMEOUT = 4.0
"""Seconds that an ending node waits for its subscribers to acknowledge its messages. On a busy machine the last ones
may get lost; they are sent again once the subscriber answers the middleware's heartbeat, every 3 s."""

DIAGNOSTICS = "/diagnostics"
"""Topic of every node's state; absolute, as monitors expect it, so that it does not depend on the rig's namespace."""

MATCH_PERIOD = 0.05
"""Seconds between checks of the numbers of matched publishers and subscribers. rclpy's own matched event crashes a node
that destroys its endpoints while the event arrives, as clean-up does."""

DISPLAY_PERIOD = 0.02
"""Seconds of wall time between messages for viewers."""

STREAM_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
"""QoS of the rig's subscriptions to `brace_command` and `ground_motion`: only the newest late messages matter."""
KEPT_STREAM_QOS = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)
"""QoS of subscriptions that must not miss a sample, and, with a lifespan, of the publishers of streams.

With a depth of ten, a logger that a busy machine delayed by some milliseconds lost samples of a lockstep run, and a
commander that joined a running rig lost samples one time in two: the 50 to 80 samples that are published during
discovery arrive all at once.
"""
_LIFESPAN = Duration(seconds=10)
"""For which a publisher keeps what a subscriber has not acknowledged; at 500 Hz as many as KEPT_STREAM_QOS keeps.

When a node joins, Fast DDS 2.14 may keep for ever some messages that all others acknowledge just then
(`StatefulWriter::check_acked_status` takes the new reader for one that has acknowledged all). With each heartbeat it
lists, and each subscriber goes through, the sequence numbers from the oldest of them to the present one
(`add_gaps_for_holes_in_history_`). Without a lifespan that took 80 % of a processor at either end after an hour.
"""
LOCKSTEP_STREAM_QOS = QoSProfile(history=HistoryPolicy.KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)
"""QoS of the samples of a lockstep run: none is overwritten; the rig keeps all and waits for slow subscribers."""

TRANSIENT_LOCAL_QOS = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)


def published_stream_qos(depth: int = KEPT_STREAM_QOS.depth) -> QoSProfile:
    """QoS of the publishers of streams: KEPT_STREAM_QOS, and a lifespan except in a lockstep run, which waits."""
    profile = QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE)
    if not transport.is_lockstep():
        profile.lifespan = _LIFESPAN
    return profile


def rcl_message(error: Exception) -> str:
    """The message of an rcl error in one line, without the positions in rcl's source and its prefixes."""
    text = re.sub(r", at \S+:\d+|failed to initialize (rcl|logging): ", "", " ".join(str(error).split()))
    if folder := re.fullmatch(r"Failed to create log directory '(.*)': (\d+)", text):
        return f"log directory {folder[1]}: {os.strerror(int(folder[2]))}, expected ROS_LOG_DIR to name one"
    return text


def clearing(node: Node) -> str:
    """The instruction for clearing a latched fault of a node that has the service `~/clear_fault`."""
    service = node.resolve_service_name("~/clear_fault")
    return f"remove its cause, then: ros2 service call {service} std_srvs/srv/Trigger"


def _description(node: type, name: str, table: Sequence[Parameter]) -> str:
    text = sys.modules[node.__module__].__doc__ or ""
    about, _, further = text.partition("\n\n")
    package = node.__module__.partition(".")[0]
    program = f"python {sys.argv[0]}" if package == "__main__" else f"ros2 run (or abrace run) {package} {name}"
    usage = f"{program} --ros-args -p NAME:=VALUE ..."
    example = next((line for line in further.splitlines() if line.startswith("abrace run ")), "")
    example = example or f"{program} --ros-args -p {as_given(table[0])}"
    return f"{about}\n\n{usage}\nexample: {example}\n\n{parameter_help(table)}"


class Described(Exception):  # noqa: N818
    """Raised instead of creating a node, if `--help` was given; its text is the node's description."""


class AbraceNode(Node):
    """A node with abrace's conventions: checked parameters, diagnostics, an exit code.

    Parameters
    ----------
    name
        The node's name.
    table
        Its parameters; their values are attributes of `parameters`.
    context
        The rclpy context; None: the process's default.
    """

    due: float | None = None
    """When `tick` is to be called [s, monotonic]; None: not at all. Call `rouse` after setting it in another thread."""
    streams = False
    """Whether its messages must never be delayed: then it has two threads, and streams.xml is its DDS profile."""
    exit_code: int | None = None
    """Exit code of the process, once the node has finished."""
    failed = False
    """Whether an error has ended the node's second thread: it comes to rest, then the process ends with that error."""
    reported_fault: str | None = None
    """The fault that was last logged and published."""
    remedy = ""
    """Instruction for clearing the node's faults, for the log."""

    _wrong_times = 0
    """Messages on `/clock` that were ignored."""
    describing = False
    """Whether creating a node raises `Described` instead, for `--help`."""

    def __init__(self, name: str, table: Sequence[Parameter], context: Context | None = None) -> None:
        if AbraceNode.describing:
            raise Described(_description(type(self), name, table))
        self.lock = threading.RLock()
        """Held while `tick` or a change of a parameter acts; see `AbraceLifecycleNode`."""
        self.roused = Future()
        Node.__init__(self, name, context=context)
        refuse_unknown_types(self)
        self.parameters = declare(self, table)
        self._live = {parameter.name: parameter for parameter in table if parameter.live}
        self._changes: dict[str, tuple[Any, Callable[[], None]]] = {}
        self.add_pre_set_parameters_callback(self._typed)
        self.add_on_set_parameters_callback(self._on_set_parameters)
        self.add_post_set_parameters_callback(self._on_parameters_set)
        self._endpoint_counts: list[tuple[str, Callable[[], int]]] = []
        self._partners: list[int] = []
        self._diagnostics_due = False
        self._publishers_of_streams: list[Publisher] = []
        self._diagnostics = self.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self.publish_diagnostics, clock=steady)
        self.create_timer(MATCH_PERIOD, self._look_for_partners, clock=steady)
        self._namesakes = self.create_timer(1.0, self._look_for_namesakes, clock=steady)
        # rclpy looks up the caller of each log message; the first look-up searches all modules for 20 to 50 ms: it is
        # done here, so that the first fault does not delay the loop
        inspect.getframeinfo(cast("FrameType", inspect.currentframe()))

    def _typed(self, given: list[RosParameter]) -> list[RosParameter]:
        return [self._live[one.name].typed(one) if one.name in self._live else one for one in given]

    def _on_set_parameters(self, given: list[RosParameter]) -> SetParametersResult:
        """Check all; nothing is changed before all have been accepted."""
        self._changes = {}
        try:
            for parameter in given:
                if parameter.name in self._live:
                    value = self._live[parameter.name].check(parameter)
                    self._changes[parameter.name] = value, self.prepare_change(parameter.name, value)
        except AbraceError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _on_parameters_set(self, given: list[RosParameter]) -> None:
        """Apply the accepted values."""
        with self.lock:
            for name, (value, change) in self._changes.items():
                setattr(self.parameters, name, value)
                change()
        self._changes = {}

    def prepare_change(self, name: str, value: Any) -> Callable[[], None]:
        """Check a live parameter's new `value`, or refuse it with an AbraceError; returns the function that applies it.

        The function is called with the lock once all parameters that are set together have been accepted; until then
        nothing may change. Long computations belong in this method, which does not block the loop.
        """
        return lambda: None

    def create_subscription(
        self, msg_type: type, topic: str, callback: Callable[[Any], None], qos_profile: QoSProfile | int, **options: Any
    ) -> Subscription:
        """Create a subscription; that of rclpy to the time, for `use_sim_time`, must survive a wrong time."""
        if topic == CLOCK_TOPIC and not options.get("raw"):
            callback = partial(self._set_time, callback)
        return super().create_subscription(msg_type, topic, callback, qos_profile, **options)

    def _set_time(self, set_time: Callable[[Any], None], message: Any) -> None:
        try:
            set_time(message)
        except ValueError:
            self._wrong_times += 1
            if self._wrong_times == 1:
                self.get_logger().error(
                    f"{CLOCK_TOPIC}: time of {message.clock.sec} s, expected 0 or more: this and later ones are ignored"
                )

    def publish_on(self, message_type: type, topic: str, qos: QoSProfile) -> Publisher:
        """Create a publisher that is flushed at the end; the diagnostics show its number of subscribers."""
        publisher = self.create_publisher(message_type, topic, qos)
        self._endpoint_counts.append((f"subscribers of {topic}", publisher.get_subscription_count))
        self._publishers_of_streams.append(publisher)
        return publisher

    def subscribe_to(
        self, message_type: type, topic: str, callback: Callable, qos: QoSProfile, *, raw: bool = False
    ) -> Subscription:
        """Create a subscription; the diagnostics show its number of publishers."""
        subscription = self.create_subscription(message_type, topic, callback, qos, raw=raw)
        self._endpoint_counts.append((f"publishers of {topic}", subscription.get_publisher_count))
        return subscription

    def _look_for_partners(self) -> None:
        partners = [count() for _, count in self._endpoint_counts]
        if partners != self._partners:
            self._partners = partners
            self.publish_diagnostics()

    def _look_for_namesakes(self) -> None:
        """Log, once, that another node has this one's name: each receives the other's requests."""
        if self.get_node_names_and_namespaces().count((self.get_name(), self.get_namespace())) > 1:
            self._namesakes.cancel()
            self.get_logger().error(
                f"another node is called {self.get_fully_qualified_name()}, expected one: end one of them (a "
                "killed node stays visible for 20 s), or start this one with -r __ns:=/other"
            )

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """(fault or None, message, values) of the node, for its diagnostics."""
        return None, "running", {}

    def publish_diagnostics(self) -> None:
        """Publish the node's state on `/diagnostics`, under its full name, and log a new or cleared fault."""
        self._diagnostics_due = False
        fault, message, values = self.diagnose()
        if fault != self.reported_fault:
            self._log_fault(fault)
        values.update((name, count()) for name, count in self._endpoint_counts)
        if self._wrong_times:
            values[f"ignored messages of {CLOCK_TOPIC}"] = self._wrong_times
        status = DiagnosticStatus(
            level=DiagnosticStatus.ERROR if fault else DiagnosticStatus.OK,
            name=f"{self.get_fully_qualified_name().lstrip('/')}: state",
            message=f"fault: {fault}" if fault else message,
            hardware_id=self.get_namespace(),
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)

    def report_fault(self, fault: str | None) -> None:
        """Publish the diagnostics and log the `fault`, by `later`, if it is new or cleared since the last report."""
        if fault != self.reported_fault and not self._diagnostics_due:
            self._diagnostics_due = True
            self.later(self.publish_diagnostics)

    def later(self, act: Callable[[], object]) -> None:
        """Call `act` where it does not delay the loop; a node with one thread calls it at once."""
        act()

    def _log_fault(self, fault: str | None) -> None:
        if fault:
            self.get_logger().error(f"fault: {fault}{self.remedy and '; '}{self.remedy}")
        else:
            self.get_logger().info(f"fault cleared: {self.reported_fault}")
        self.reported_fault = fault

    @contextlib.contextmanager
    def spun(self) -> Iterator[Executor]:
        """Gives the executor that the main thread is to spin."""
        executor = EventsExecutor(context=self.context)
        executor.add_node(self)
        try:
            yield executor
        finally:
            executor.remove_node(self)
            executor.shutdown()

    def autostart(self) -> None:
        """Override to start without a command; called once, unless a signal came before."""

    def tick(self) -> None:
        """Override; called with the lock when `due` has passed."""

    def turn(self) -> None:
        """Call `tick` with the lock, if it is still due."""
        with self.lock:
            if self.due is not None:
                self.tick()

    def rouse(self) -> None:
        """Wake the loop, so that it checks at once whether to go on and when `tick` is due; from any thread."""
        self.roused.set_result(None)

    @property
    def at_rest(self) -> bool:
        """Whether the process may end."""
        return True

    def leave(self) -> float:
        """Begin to come to rest, after a signal; returns the seconds that this may take before the process ends."""
        return 0.0

    def ended_before_rest(self) -> None:
        """Override to report that the process ends although the node is not at rest, as `leave` took too long."""

    def finish(self, exit_code: int, message: str) -> None:
        """End the process after this callback; `message` is its result on standard output, or logged as an error."""
        self.exit_code = exit_code
        self.rouse()
        if exit_code:
            self.get_logger().error(message)
        else:
            print(f"{self.get_name()}: {message}", flush=True)

    def close(self) -> None:
        """Override to close files before the node is destroyed."""

    def flush_publishers(self) -> None:
        """Wait until subscribers have acknowledged all messages: a destroyed publisher does not resend any."""
        deadline = time.monotonic() + ACKNOWLEDGEMENT_TIMEOUT
        for publisher in self._publishers_of_streams:
            publisher.wait_for_all_acked(Duration(seconds=max(0.0, deadline - time.monotonic())))
