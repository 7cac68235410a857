# SPDX-License-Identifier: Apache-2.0
"""The base class of all nodes: live parameters, diagnostics, spinning, the end of the process."""

from __future__ import annotations

import contextlib
import inspect
import os
import re
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from functools import partial, wraps
from pathlib import Path
from types import FrameType
from typing import Any, cast

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import LoggingSeverity
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.time_source import CLOCK_TOPIC
from rclpy.topic_endpoint_info import TopicEndpointInfo

from abrace_core import AbraceError
from abrace_node.parameters import Parameter, as_given, declare, parameter_help, refuse_unknown_types
from abrace_node.threads import GuardedExecutor

RCLError = rclpy_implementation.RCLError

UNFORESEEN = Exception, SystemExit
"""What a callback may raise; the others belong to the interpreter."""

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


UNKNOWN = "_NODE_NAME_UNKNOWN_"
"""The middleware's name of a node that has left, or whose name it has not received yet, or after a lost connection."""


def endpoint_names(endpoints: Sequence[TopicEndpointInfo]) -> set[str]:
    """Full names of the endpoints' nodes, without those that have no name."""
    return {
        f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"
        for endpoint in endpoints
        if endpoint.node_name != UNKNOWN
    }


def served_subscriptions(node: Node, topic: str) -> list[TopicEndpointInfo]:
    """Subscriptions to a topic that its publishers can serve, as far as `node` has discovered them."""
    publishers = node.get_publishers_info_by_topic(topic)
    return [
        one
        for one in node.get_subscriptions_info_by_topic(topic)
        if any(
            each.topic_type == one.topic_type
            and qos_check_compatible(each.qos_profile, one.qos_profile)[0] != QoSCompatibility.ERROR
            for each in publishers
        )
    ]


def misfits(node: Node, stream: Publisher | Subscription) -> list[str]:
    """Why others on the topic of this `stream` of a `node` are not connected with it: type or QoS; none: all fit."""
    topic, publishes = stream.topic_name, isinstance(stream, Publisher)
    if publishes:
        known, matched, who = node.count_subscribers(topic), stream.get_subscription_count(), "subscriber"
    else:
        known, matched, who = node.count_publishers(topic), stream.get_publisher_count(), "publisher"
    if known <= matched:
        return []  # so it costs next to nothing where all fit
    found = []
    infos = node.get_subscriptions_info_by_topic if publishes else node.get_publishers_info_by_topic
    for other in infos(topic):
        ends = (stream.qos_profile, other.qos_profile) if publishes else (other.qos_profile, stream.qos_profile)
        fits, reason = qos_check_compatible(*ends)
        wanted = "/".join((stream.msg_type.__module__.split(".")[0], "msg", stream.msg_type.__name__))
        name = "".join(endpoint_names([other])) or "of unknown name"
        if other.topic_type != wanted:
            found.append(f"{who} {name} of {topic} does not fit: type {other.topic_type}, expected {wanted}")
        elif fits == QoSCompatibility.ERROR:
            why = reason.removeprefix("ERROR: ").rstrip("; ").lower()
            found.append(f"{who} {name} of {topic} does not fit: QoS ({why})")
    return found


def rcl_message(error: Exception) -> str:
    """The message of an rcl error in one line, without its prefixes, positions in its source and its lexer's words."""
    text = re.sub(
        r", at \S+:\d+|failed to initialize (rcl|logging): |\. Error: (Expected lexeme|error not set).*",
        "",
        " ".join(str(error).split()),
    )
    if folder := re.fullmatch(r"Failed to create log directory '(.*)': (\d+)", text):
        return f"log directory {folder[1]}: {os.strerror(int(folder[2]))}, expected ROS_LOG_DIR to name one"
    return text


def what_and_where(error: BaseException) -> str:
    """An `error` in one line; with the place in the code where it was raised, unless it is an AbraceError."""
    if isinstance(error, AbraceError):
        return str(error)
    what = " ".join(f"{type(error).__name__}: {error}".split())
    for place in traceback.extract_tb(error.__traceback__)[-1:]:
        return f"{what} ({Path(place.filename).name}, line {place.lineno}, in {place.name})"
    return what


def clearing(node: Node) -> str:
    """The instruction for clearing a latched fault of a node that has the service `~/clear_fault`."""
    return f"remove its cause, then: abrace clear {node.get_fully_qualified_name()}"


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
    """When `tick` is to be called [s, monotonic]; None: not at all. Call `wake` after setting it in another thread."""
    streams = False
    """Whether its messages must never be delayed: then it has two threads, and streams.xml is its DDS profile."""
    exit_code: int | None = None
    """Exit code of the process, once the node has finished."""
    stopped_exit_code = 0
    """Exit code of an offline node whose `work` a signal has interrupted."""
    error: BaseException | None = None
    """The first exception of a callback, a task or a thread: see `fail`."""
    reported_fault: str | None = None
    """The fault that was last logged and published."""
    life_cycle = ""
    """State of a life cycle node, for its diagnostics."""
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
        self.woken = Future()
        Node.__init__(self, name, context=context)
        refuse_unknown_types(self)
        self.parameters = declare(self, table)
        self._live = {parameter.name: parameter for parameter in table if parameter.live}
        self._changes: dict[str, tuple[Any, Callable[[], None]]] = {}
        self.add_pre_set_parameters_callback(self._typed)
        self.add_on_set_parameters_callback(self._on_set_parameters)
        self.add_post_set_parameters_callback(self._on_parameters_set)
        self._endpoint_counts: list[tuple[str, Callable[[], int]]] = []
        self._streams: list[Publisher | Subscription] = []
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
        deleted = RosParameter.Type.NOT_SET  # rclpy refuses to
        return [
            self._live[one.name].typed(one) if one.name in self._live and one.type_ != deleted else one for one in given
        ]

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
        self._streams.append(publisher)
        return publisher

    def subscribe_to(
        self, message_type: type, topic: str, callback: Callable, qos: QoSProfile, *, raw: bool = False
    ) -> Subscription:
        """Create a subscription; the diagnostics show its number of publishers."""
        subscription = self.create_subscription(message_type, topic, callback, qos, raw=raw)
        self._endpoint_counts.append((f"publishers of {topic}", subscription.get_publisher_count))
        self._streams.append(subscription)
        return subscription

    def finds_commander(self, samples: Publisher, answers: Subscription) -> bool:
        """Whether one node gets the `samples` and publishes `answers`; others, such as a logger, may get them, too.

        Each subscriber that is known has to be matched: which of them are is not told, and what is published before
        a subscriber is matched is lost to it.
        """
        getting = served_subscriptions(self, samples.topic_name)
        answering = self.get_publishers_info_by_topic(answers.topic_name)
        return (
            not endpoint_names(getting).isdisjoint(endpoint_names(answering))
            and samples.get_subscription_count() >= len(getting)
            and answers.get_publisher_count() > 0
        )

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
        message = "; ".join([message, *(text for stream in self._streams for text in misfits(self, stream))])
        values.update((name, count()) for name, count in self._endpoint_counts)
        if self.life_cycle:
            values["life cycle"] = self.life_cycle
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
        """Publish the diagnostics and log the `fault`, by `defer`, if it is new or cleared since the last report."""
        if fault != self.reported_fault and not self._diagnostics_due:
            self._diagnostics_due = True
            self.defer(self.publish_diagnostics)

    def defer(self, act: Callable[[], object]) -> None:
        """Call `act` where it does not delay the loop; a node with one thread calls it at once."""
        act()

    def _log_fault(self, fault: str | None) -> None:
        if fault:
            self.get_logger().error(f"fault: {fault}{self.remedy and '; '}{self.remedy}")
        else:
            self.get_logger().info(f"fault cleared: {self.reported_fault}")
        self.reported_fault = fault

    @contextlib.contextmanager
    def spinning(self) -> Iterator[GuardedExecutor]:
        """Gives the executor that the main thread is to spin."""
        executor = GuardedExecutor(self)
        self.executor = executor
        try:
            yield executor
        finally:
            self.executor = None  # type: ignore[assignment]
            executor.shutdown()

    def catching(self, act: Callable[..., Any], otherwise: Any = None) -> Callable[..., Any]:
        """`act`, a function or a coroutine function, for a callback: it passes an exception to `fail`.

        It then returns `otherwise`.
        """

        @wraps(act)
        def call(*arguments: Any) -> Any:
            try:
                return act(*arguments)
            except UNFORESEEN as error:
                self.fail(error)
                return otherwise

        @wraps(act)
        async def wait(*arguments: Any) -> Any:
            try:
                return await act(*arguments)
            except UNFORESEEN as error:
                self.fail(error)
                return otherwise

        caught: Any = wait if inspect.iscoroutinefunction(act) else call
        caught.catches = True
        return cast("Callable[..., Any]", caught)

    def fail(self, error: BaseException) -> None:
        """Take the course of every exception in a callback, a task or a thread; from any thread.

        What the node drives comes to rest along its ramp, one line says what was raised and where, and the process ends
        with code 1. While it comes to rest, further exceptions are only logged with `--log-level debug`.
        """
        with self.lock:
            first, self.error = self.error is None, self.error or error
            if first:
                self.protect(what_and_where(error))
        logger = self.get_logger()
        if first:
            logger.fatal(what_and_where(error))
            self.wake()
        if logger.is_enabled_for(LoggingSeverity.DEBUG):  # a loop that ramps to zero has no time to format it
            logger.debug("".join(traceback.format_exception(error)).rstrip())

    def protect(self, cause: str) -> None:
        """Override to bring what the node drives to rest because of this `cause`; called with the lock."""

    def await_observer(self, stopped: Callable[[], bool]) -> None:
        """Override to wait until `ros2 launch` receives the node's states, or `stopped`; called before it spins."""

    def autostart(self) -> None:
        """Override to start without a command; called once, unless a signal came before."""

    def tick(self) -> None:
        """Override; called with the lock when `due` has passed."""

    def run_tick(self) -> None:
        """Call `tick` with the lock, if it is still due."""
        with self.lock:
            if self.due is not None:
                self.tick()

    def wake(self) -> None:
        """Wake the loop, so that it checks at once whether to go on and when `tick` is due; from any thread."""
        self.woken.set_result(None)

    @property
    def at_rest(self) -> bool:
        """Whether the process may end."""
        return True

    def begin_shutdown(self) -> float:
        """Begin to come to rest, after a signal; returns the seconds that this may take before the process ends."""
        return 0.0

    def ended_before_rest(self) -> None:
        """Override to report that the process ends although the node has not come to rest in time."""

    def finish(self, exit_code: int, message: str) -> None:
        """End the process after this callback; `message` is its result on standard output, or logged as an error."""
        self.exit_code = exit_code
        self.wake()
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
