"""What every node shares: parameters from one table, QoS, diagnostics, life cycle, clean shutdown, exit codes.

This is the one module of a library that imports rclpy. A node's module holds its parameter table, its callbacks and

    def main() -> int:
        return run(MyNode)

Exit codes: 0 done or stopped by a person, 1 something failed while running, 2 something that was given is wrong (one
line says what, where, and what was expected).
"""

from __future__ import annotations

import gc
import os
import re
import signal
import sys
import time
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType, SimpleNamespace
from typing import Any, Protocol

import rclpy
from ament_index_python.packages import get_package_share_directory
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.exceptions import InvalidParameterException
from rclpy.experimental import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.logging import LoggingSeverity, get_logger_effective_level, set_logger_level
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.task import Future
from rclpy.utilities import remove_ros_args

from abrace_core.errors import AbraceError

RCLError = rclpy_implementation.RCLError

LONGEST_WAIT = 0.1
"""Seconds that the executor may wait at a time. An untimed wait of the events executor never returns to Python."""

EVENTS_WHEN_LATE = 3
"""Callbacks that may come between two ticks of a node that is late: it has to hear of the answers to catch up."""

LONGEST_HANDOVER = Duration(seconds=0.5)
"""How long a node that ends waits for those who still have to take what it published."""

STREAM_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
"""How the rig takes `brace_command` and `ground_motion`: of late ones the last will do."""
KEPT_STREAM_QOS = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)
"""How they are published, and taken by those who must not miss one: ten seconds are kept for a reader that is late.

With ten kept, a logger that a busy machine held up for some milliseconds lost samples of a lockstep run, and a
commander that joined a running rig lost samples one time in two: what is published while the two become acquainted,
some 50 to 80 samples, arrives all at once.
"""
LATCHED_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)

_TYPES = {
    bool: RosParameter.Type.BOOL,
    int: RosParameter.Type.INTEGER,
    float: RosParameter.Type.DOUBLE,
    str: RosParameter.Type.STRING,
}
_ARRAY_TYPES = {
    bool: RosParameter.Type.BOOL_ARRAY,
    int: RosParameter.Type.INTEGER_ARRAY,
    float: RosParameter.Type.DOUBLE_ARRAY,
    str: RosParameter.Type.STRING_ARRAY,
}
_EMPTY_LISTS = (RosParameter.Type.BYTE_ARRAY, RosParameter.Type.NOT_SET)
"""What ROS takes an empty list for."""
_EXAMPLES = {bool: "true", int: "3", float: "3.0", str: "text"}


@dataclass(frozen=True)
class Parameter:
    """One row of a node's parameter table.

    Parameters
    ----------
    name
        As in `-p name:=value`.
    default
        Its type is the parameter's type; a list for an array.
    description
        What it is, with its unit.
    minimum, maximum
        Range of a number, or of each number of an array.
    choices
        The values that a text, or each text of an array, may have; empty: any.
    element
        Type of an array's elements, for arrays that are empty by default.
    required
        Whether an empty value is refused.
    live
        Whether it may be changed while the node runs; its new value then comes to `Node.parameter_changed`.
    """

    name: str
    default: bool | int | float | str | list
    description: str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    element: type | None = None
    required: bool = False
    live: bool = False

    @property
    def _element(self) -> type:
        if not isinstance(self.default, list):
            return type(self.default)
        return self.element or type(self.default[0])

    @property
    def _may_be_empty(self) -> bool:
        return isinstance(self.default, list) and (self.default == [] or self._element is str)

    @property
    def ros_type(self) -> RosParameter.Type:
        """The ROS parameter type."""
        return (_ARRAY_TYPES if isinstance(self.default, list) else _TYPES)[self._element]

    def expected(self) -> str:
        """What a value has to be, in words."""
        kind = {bool: "true or false", int: "a whole number", float: "a number with a decimal point", str: "a text"}
        text = (
            kind[self._element] if not isinstance(self.default, list) else f"a list like [{_EXAMPLES[self._element]}]"
        )
        if self.choices:
            text += f" out of {', '.join(choice or 'an empty text' for choice in self.choices)}"
        if self.minimum is not None and self.maximum is not None:
            text += f" from {self.minimum} to {self.maximum}"
        elif self.minimum is not None:
            text += f", at least {self.minimum}"
        if self.required:
            text += ", not empty"
        return text

    def descriptor(self) -> ParameterDescriptor:
        """The descriptor that ROS tools show."""
        descriptor = ParameterDescriptor(
            description=self.description,
            read_only=not self.live,
            additional_constraints=self.expected(),
            # rclpy takes an empty list for one of bytes; `check` looks at the type of what comes later
            dynamic_typing=self.default == [],
        )
        low = self.minimum if self.minimum is not None else -sys.float_info.max
        high = self.maximum if self.maximum is not None else sys.float_info.max
        if (self.minimum, self.maximum) != (None, None) and not isinstance(self.default, list):
            if self._element is float:
                descriptor.floating_point_range = [FloatingPointRange(from_value=float(low), to_value=float(high))]
            else:
                bounds = IntegerRange(from_value=int(max(low, -(2**63))), to_value=int(min(high, 2**63 - 1)), step=0)
                descriptor.integer_range = [bounds]
        return descriptor

    def check(self, given: RosParameter) -> Any:
        """The value given, if it is one that the node can use; one value where a list is meant is a list of one.

        Raises
        ------
        AbraceError
            If it has another type or is out of range.
        """
        value, fits = given.value, given.type_ == self.ros_type
        if isinstance(self.default, list) and given.type_ == _TYPES[self._element]:
            value, fits = [value], True
        if self._may_be_empty and not value and given.type_ in _EMPTY_LISTS:
            value, fits = [], True
        if not fits or not self.holds(value):
            raise AbraceError(f"parameter {self.name}: {given.value!r}, expected {self.expected()}")
        return list(value) if isinstance(value, (list, tuple, array)) else value

    def holds(self, value: Any) -> bool:
        """Whether a value of the right type is one that the node can use."""
        if self.required and not value:
            return False
        values = value if isinstance(self.default, list) else [value]
        if self._element is str:
            return not self.choices or all(entry in self.choices for entry in values)
        low = self.minimum if self.minimum is not None else -float("inf")
        high = self.maximum if self.maximum is not None else float("inf")
        return all(low <= entry <= high and abs(entry) != float("inf") for entry in values)


def declare(node: Node, table: Sequence[Parameter]) -> SimpleNamespace:
    """Declare the table's parameters on the node and return their values.

    Raises
    ------
    AbraceError
        For a value of the wrong type or out of range, and for a parameter that the node does not have.
    """
    values = SimpleNamespace()
    given = node._parameter_overrides
    known = {parameter.name for parameter in table} | set(node._parameters)
    for name in given:
        if name not in known and not name.startswith("qos_overrides."):
            names = ", ".join(sorted(parameter.name for parameter in table))
            raise AbraceError(f"parameter {name}: unknown, {node.get_name()} has {names}")
    for parameter in table:
        value = parameter.check(given.get(parameter.name) or RosParameter(parameter.name, value=parameter.default))
        ros_value = RosParameter(parameter.name, parameter.ros_type, value).value
        try:
            node.declare_parameter(parameter.name, ros_value, parameter.descriptor(), ignore_override=True)
        except InvalidParameterException as error:
            raise AbraceError(f"parameter {parameter.name}: {value!r}, expected {parameter.expected()}") from error
        setattr(values, parameter.name, value)
    return values


def find_file(name: str, package: str, folder: str, ending: str, kind: str) -> Path:
    """A file by its path, or by its name among those that a package installs.

    Raises
    ------
    AbraceError
        If there is neither; says which names there are.
    """
    if name.endswith(ending) or "/" in name:
        if not Path(name).is_file():
            raise AbraceError(f"{kind} file {name}: no such file")
        return Path(name)
    installed = Path(get_package_share_directory(package)) / folder
    path = installed / f"{name}{ending}"
    if not path.is_file():
        names = ", ".join(sorted(entry.name.removesuffix(ending) for entry in installed.glob(f"*{ending}")))
        raise AbraceError(f"{kind} {name!r}: unknown, expected a file ending in {ending} or one of {names}")
    return path


def rcl_message(error: Exception) -> str:
    """What rcl says of a mistake: one line, without the places in its source."""
    return re.sub(r", at \S+:\d+", "", " ".join(str(error).split()))


class Watched(Protocol):
    """What `run` needs of a node."""

    due: float | None
    exit_code: int | None
    ended: Future

    def tick(self) -> None:
        """Called when `due` [s, monotonic] has come."""

    def closing(self) -> None:
        """Called before the node is destroyed, whatever ended it."""


class _Conventions:
    """Diagnostics, ending and ticking, for both kinds of node."""

    due: float | None = None
    exit_code: int | None = None

    def follow_parameters(self, node: Node, table: Sequence[Parameter], values: SimpleNamespace) -> None:
        """From here on, live parameters may be changed: checked, told to `parameter_changed`, kept in `values`."""
        live = {parameter.name: parameter for parameter in table if parameter.live}

        def on_set(parameters: list[RosParameter]) -> SetParametersResult:
            try:
                for given in parameters:
                    if given.name in live:
                        value = live[given.name].check(given)
                        self.parameter_changed(given.name, value)
                        setattr(values, given.name, value)
            except AbraceError as error:
                return SetParametersResult(successful=False, reason=str(error))
            return SetParametersResult(successful=True)

        node.add_on_set_parameters_callback(on_set)

    def parameter_changed(self, name: str, value: Any) -> None:
        """Make use of a live parameter's new `value`, or refuse it with an AbraceError."""

    def start_diagnostics(self, node: Node) -> None:
        self.ended = Future()
        self._endpoints: list[tuple[str, Callable[[], int]]] = []
        self._published: list[Publisher] = []
        self._diagnostics = node.create_publisher(DiagnosticArray, "diagnostics", 10)
        self._status_name = f"{node.get_fully_qualified_name().lstrip('/')}: state"
        self._hardware_id = node.get_name()
        self._node_clock = node.get_clock()
        node.create_timer(1.0, self.publish_diagnostics, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def publish_on(self, message_type: type, topic: str, qos: QoSProfile) -> Publisher:
        """A publisher whose number of matched subscribers stands in the diagnostics."""
        node: Any = self
        publisher = node.create_publisher(
            message_type, topic, qos, event_callbacks=PublisherEventCallbacks(matched=self._matched)
        )
        self._endpoints.append((f"subscribers of {topic}", publisher.get_subscription_count))
        self._published.append(publisher)
        return publisher

    def hand_over(self) -> None:
        """Wait until what was published has arrived: a publisher that goes takes along what has not."""
        for publisher in self._published:
            publisher.wait_for_all_acked(LONGEST_HANDOVER)

    def subscribe_to(
        self, message_type: type, topic: str, callback: Callable, qos: QoSProfile, *, raw: bool = False
    ) -> Subscription:
        """A subscription whose number of matched publishers stands in the diagnostics."""
        node: Any = self
        subscription = node.create_subscription(
            message_type,
            topic,
            callback,
            qos,
            raw=raw,
            event_callbacks=SubscriptionEventCallbacks(matched=self._matched),
        )
        self._endpoints.append((f"publishers of {topic}", subscription.get_publisher_count))
        return subscription

    def _matched(self, status: object) -> None:
        self.publish_diagnostics()

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """(fault or None, message, values) of the node, for its diagnostics."""
        return None, "running", {}

    def publish_diagnostics(self) -> None:
        """Publish the node's state on `diagnostics`."""
        fault, message, values = self.diagnose()
        values.update((name, count()) for name, count in self._endpoints)
        status = DiagnosticStatus(
            level=DiagnosticStatus.ERROR if fault else DiagnosticStatus.OK,
            name=self._status_name,
            message=f"fault: {fault}" if fault else message,
            hardware_id=self._hardware_id,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = self._node_clock.now().to_msg()
        self._diagnostics.publish(array)

    def finish(self, exit_code: int, message: str) -> None:
        """End the process once the present callback is done."""
        self.exit_code = exit_code
        self.ended.set_result(None)
        if exit_code:
            print(f"{self._hardware_id}: {message}", file=sys.stderr, flush=True)
        else:
            print(f"{self._hardware_id}: {message}", flush=True)

    def tick(self) -> None:
        """Called when `due` has come; nodes with a schedule of their own override it."""

    def closing(self) -> None:
        """Called before the node is destroyed; nodes that hold something open override it."""


class AbraceNode(_Conventions, Node):
    """A plain node with abrace's conventions; `parameters` holds the values of its table."""

    def __init__(self, name: str, table: Sequence[Parameter]) -> None:
        Node.__init__(self, name)
        self.parameters = declare(self, table)
        self.follow_parameters(self, table, self.parameters)
        self.start_diagnostics(self)


AUTOSTART = Parameter("autostart", True, "configure and activate at once; false: wait for life cycle commands")


class AbraceLifecycleNode(_Conventions, LifecycleNode):
    """A node that can move something: it does so only while active.

    Subclasses implement `configure`, `activate` and `deactivate`; an AbraceError in them refuses the transition.
    """

    def __init__(self, name: str, table: Sequence[Parameter]) -> None:
        LifecycleNode.__init__(self, name)
        self.parameters = declare(self, [*table, AUTOSTART])
        self.follow_parameters(self, table, self.parameters)
        self.refusal: AbraceError | None = None
        self.configured = False
        self.active = False
        self.start_diagnostics(self)
        self._standing = {*self.publishers, *self.subscriptions, *self.services}
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state

    def _on_change_state(self, request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
        """Refuse a transition that the present state does not have; rclpy 7.1 would end the process."""
        try:
            return self._change_state(request, response)
        except RCLError:
            response.success = False
            return response

    def configure(self) -> None:
        """Load files, make publishers and subscriptions."""

    def activate(self) -> None:
        """Begin."""

    def deactivate(self) -> None:
        """Stop, smoothly."""

    def cleanup(self) -> None:
        """Undo what `configure` made beside publishers, subscriptions and services."""

    def _transition(self, step: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            step()
        except AbraceError as error:
            self.refusal = error
            if not self.parameters.autostart:
                self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self.get_logger().fatal(f"{type(error).__name__}: {error}")
            raise
        return TransitionCallbackReturn.SUCCESS

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback."""
        result = self._transition(self.configure)
        self.configured = result == TransitionCallbackReturn.SUCCESS
        if not self.configured:
            self._forget()
        return result

    def _forget(self) -> None:
        """Destroy what `configure` made."""
        for publisher in set(self.publishers) - self._standing:
            self.destroy_publisher(publisher)
        for subscription in set(self.subscriptions) - self._standing:
            self.destroy_subscription(subscription)
        for service in set(self.services) - self._standing:
            self.destroy_service(service)
        self._endpoints.clear()
        self._published.clear()

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback."""
        result = self._transition(self.activate)
        self.active = result == TransitionCallbackReturn.SUCCESS
        return LifecycleNode.on_activate(self, state) if self.active else result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback."""
        self.active = False
        self._transition(self.deactivate)
        return LifecycleNode.on_deactivate(self, state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback."""
        self.configured = False
        self.cleanup()
        self._forget()
        return LifecycleNode.on_cleanup(self, state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback: an active node stops as when it is deactivated."""
        if self.active:
            self.on_deactivate(state)
        return LifecycleNode.on_shutdown(self, state)

    def autostart(self) -> None:
        """Configure and activate, where the parameter asks for it."""
        if not self.parameters.autostart:
            return
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != TransitionCallbackReturn.SUCCESS:
                raise self.refusal or AbraceError("could not start; see the log above")


class _Stop(BaseException):
    """Someone asked the process to end."""


_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""SIGHUP: the terminal is gone, as when a connection to the rig's computer breaks."""


class _Signals:
    """A signal of `_ENDING` ends the node: between callbacks while it spins, at once before that.

    A SIGHUP that was ignored when the process started, as by `nohup`, stays ignored.
    """

    def __init__(self) -> None:
        self.spinning = False
        self.stopped = False
        self._terminals = [number for number in (1, 2) if os.isatty(number)]
        for number in _ENDING:
            if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._received)

    def _received(self, number: int, frame: FrameType | None) -> None:
        if number == signal.SIGHUP:
            for terminal in self._terminals:
                # what is still said at the end would fail there, and the end with it
                os.dup2(os.open(os.devnull, os.O_WRONLY), terminal)
        self.stopped = True
        if not self.spinning:
            raise _Stop


def _spin(node: Watched, signals: _Signals) -> int:
    """Turn the events executor until the node or a person ends it."""
    executor = EventsExecutor()
    executor.add_node(node)
    # what stands by now is never looked at by the garbage collector, whose pauses would be late samples
    gc.collect()
    gc.freeze()
    signals.spinning = True
    spin_once = executor.spin_once
    spin, ended = executor.spin_until_future_complete, node.ended
    monotonic = time.monotonic
    try:
        while not signals.stopped and node.exit_code is None:
            due = node.due
            if due is None:
                spin(ended, LONGEST_WAIT)
                continue
            wait = due - monotonic()
            if wait > 0:
                spin(ended, min(wait, LONGEST_WAIT))
            else:
                node.tick()
                if node.due is not None and node.due <= monotonic():
                    for _ in range(EVENTS_WHEN_LATE):
                        spin_once(timeout_sec=0.0)
    finally:
        signals.spinning = False
        executor.remove_node(node)
        executor.shutdown()
    return node.exit_code or 0


def _initialize(arguments: list[str]) -> None:
    """Start rclpy; wrong arguments are told by the AbraceError alone, not by rcl's log as well."""
    set_logger_level("rcl", LoggingSeverity.FATAL)
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        extra = remove_ros_args(arguments)[1:]
    except Exception as error:
        raise AbraceError(f"arguments: {rcl_message(error)}") from error
    if get_logger_effective_level("rcl") == LoggingSeverity.FATAL:
        set_logger_level("rcl", LoggingSeverity.UNSET)
    if extra:
        raise AbraceError(f"argument {extra[0]!r}: unknown, parameters are given as --ros-args -p name:=value")


def _close(node: Any, program: str) -> int:
    """Close what the node holds open and take it out of the graph; returns the exit code of that."""
    exit_code = 0
    if node is not None:
        try:
            node.closing()
            node.hand_over()
        except AbraceError as error:
            print(f"{program}: {error}", file=sys.stderr, flush=True)
            exit_code = 1
        node.destroy_node()
    rclpy.try_shutdown()
    return exit_code


def run(create: Callable[[], Any], arguments: Sequence[str] | None = None) -> int:
    """Run a node to its end and return the process's exit code.

    A node with a method `work` is an offline one: `work` is called once and the process ends.
    """
    signals = _Signals()
    node: Any = None
    arguments = list(sys.argv if arguments is None else arguments)
    program = arguments[0].rsplit("/", 1)[-1]
    try:
        _initialize(arguments)
        node = create()
        if hasattr(node, "work"):
            node.work()
            exit_code = node.exit_code or 0
        else:
            if isinstance(node, AbraceLifecycleNode):
                node.autostart()
            exit_code = _spin(node, signals)
    except AbraceError as error:
        print(f"{program}: {error}", file=sys.stderr, flush=True)
        exit_code = 2
    except _Stop:
        exit_code = 0
    finally:
        for number in _ENDING:
            signal.signal(number, signal.SIG_IGN)
        closing_code = _close(node, program)
    return exit_code or closing_code
