"""The commands of an operator, for machines without `ros2`: status, stop, clear and set on the running graph."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import get_parameter_value
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from yaml import YAMLError

from abrace.report.node_table import NodeReport, node_table
from abrace_core.errors import AbraceError
from abrace_core.node import DIAGNOSTICS, TRANSIENT_LOCAL_QOS, RCLError, rcl_message
from abrace_core.node.transport import profile
from abrace_core.safety.stop_senders import UNNAMED
from abrace_core.suggestion import did_you_mean

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType
    from typing import Self

    from rclpy.client import Client

STOP_TOPIC = "/emergency_stop"
PATIENCE = 5.0
"""Seconds in which nodes have to be found, and to answer."""
LISTEN = 2.0
"""Seconds of listening for nodes, at least; every one reports once a second."""
NAMING = 2.5
"""Seconds in which a rig may learn who pressed."""
REFRESH = 0.5
"""Seconds between tables on a terminal."""


class Operator:
    """A node of its own in the running graph; a context manager."""

    def __init__(self) -> None:
        self.reports: dict[str, NodeReport] = {}
        """What each node has reported last, by its full name."""

    def __enter__(self) -> Self:
        self._context = rclpy.Context()
        try:
            with profile(streams=True):  # what is lost on the way is sent again at once
                self._context.init()
                self.node = rclpy.create_node("operator", context=self._context, start_parameter_services=False)
        except RCLError as error:
            raise AbraceError(f"ROS: {rcl_message(error)}") from error
        rclpy.signals.install_signal_handlers(SignalHandlerOptions.NO)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.node.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, 100)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        now = time.monotonic()
        for status in array.status:
            name, _, what = status.name.partition(":")
            if what.strip() == "state":
                values = {pair.key: pair.value for pair in status.values}
                before = self.reports.get(f"/{name}")
                failed = status.level != DiagnosticStatus.OK
                self.reports[f"/{name}"] = NodeReport.after(before, status.message, failed, values, now)

    def spin(self, seconds: float, until: Callable[[], Any] = bool) -> bool:
        """Receive for so many seconds, or until what is asked for holds; returns whether it does."""
        deadline = time.monotonic() + seconds
        while not until():
            if time.monotonic() >= deadline:
                return False
            self._executor.spin_once(timeout_sec=0.05)
        return True

    def hear_all(self) -> None:
        """Listen until everyone who reports has done so twice, which tells rates, or patience is at an end."""
        self.spin(LISTEN)
        self.spin(PATIENCE, self._heard_all)

    def _heard_all(self) -> bool:
        endpoints = self.node.get_publishers_info_by_topic(DIAGNOSTICS)
        names = [f"{one.node_namespace.rstrip('/')}/{one.node_name}" for one in endpoints]
        return bool(names) and all(name in self.reports and self.reports[name].count > 1 for name in names)

    def full_name(self, given: str) -> str:
        """The full name of a node, `given` as that or as its last part.

        Raises
        ------
        AbraceError
            If there is none of that name, or several.
        """

        def found() -> list[str]:
            nodes = self.node.get_node_names_and_namespaces()
            names = {f"{space.rstrip('/')}/{name}" for name, space in nodes} - {"/operator"}
            return sorted(name for name in names if name == given or name.endswith(f"/{given.lstrip('/')}"))

        self.spin(PATIENCE, found)
        names = found()
        if len(names) == 1:
            return names[0]
        if names:
            raise AbraceError(f"node {given}: several, expected one of {', '.join(names)}")
        self.hear_all()
        near = did_you_mean(given.rpartition("/")[2], [name.rpartition("/")[2] for name in self.reports])
        expected = " or ".join(sorted(self.reports)) or "one that runs"
        raise AbraceError(f"node {given}: not found, expected {expected}{near}")

    def call(self, service_type: type, service: str, request: Any) -> Any:
        """Call a service; returns its answer.

        Raises
        ------
        AbraceError
            If nobody offers it, or answers.
        """
        client: Client = self.node.create_client(service_type, service)
        if not self.spin(PATIENCE, client.service_is_ready):
            raise AbraceError(f"service {service}: not offered, expected a node that has it")
        # a server drops its answers to a client that it has not discovered yet
        asked = client.call_async(request)
        for _ in range(3):
            if self.spin(PATIENCE / 4, asked.done):
                return asked.result()
            asked = client.call_async(request)
        if self.spin(PATIENCE / 4, asked.done):
            return asked.result()
        raise AbraceError(f"service {service}: no answer within {PATIENCE:g} s")


def status() -> int:
    """Print what every node reports, on a terminal until Ctrl-C; returns the exit code: 1 where one has a fault."""
    live = sys.stdout.isatty()
    with Operator() as operator:
        operator.hear_all()
        while True:
            text = node_table(operator.reports, time.monotonic())
            print(f"\x1b[2J\x1b[H{text}" if live else text, flush=True)
            if not live:
                return int(any(report.failed for report in operator.reports.values()))
            operator.spin(REFRESH)


def stop() -> int:
    """Press the stop button of the whole laboratory; returns the exit code: 1 if no rig has said that it stops."""
    with Operator() as operator:
        button = operator.node.create_publisher(Bool, STOP_TOPIC, TRANSIENT_LOCAL_QOS)
        button.publish(Bool(data=True))
        repeated = operator.node.create_timer(0.1, lambda: button.publish(Bool(data=True)))

        def stopped() -> list[str]:
            return sorted(name for name, report in operator.reports.items() if report.stopped)

        listening = operator.spin(PATIENCE, lambda: stopped() and stopped() == rigs(operator))
        # who left before its name was heard would stay a node of unknown name
        operator.spin(NAMING, lambda: not any(UNNAMED in report.stopped for report in operator.reports.values()))
        repeated.cancel()
        for name in stopped():
            print(f"{name}: stop {operator.reports[name].stopped}")
        missing = sorted(set(rigs(operator)) - set(stopped()))
        for name in missing:
            print(f"{name}: has not said that it stops", file=sys.stderr)
        if not stopped():
            print("no rig has said that it stops; press the stop button of the hardware", file=sys.stderr)
        return int(not listening)


def rigs(operator: Operator) -> list[str]:
    """Full names of the nodes that listen to the stop button."""
    listening = operator.node.get_subscriptions_info_by_topic(STOP_TOPIC)
    return sorted({f"{one.node_namespace.rstrip('/')}/{one.node_name}" for one in listening})


def clear(node: str) -> int:
    """Clear the latched fault of a `node`; returns the exit code: 1 if that is refused."""
    with Operator() as operator:
        name = operator.full_name(node)
        answer = operator.call(Trigger, f"{name}/clear_fault", Trigger.Request())
    print(f"{name}: {answer.message}", file=sys.stdout if answer.success else sys.stderr)
    return int(not answer.success)


def set_parameter(node: str, parameter: str, value: str) -> int:
    """Set a `parameter` of a `node` to a `value`, written as in YAML; returns the exit code: 1 if that is refused."""
    wrong = AbraceError(f"value {value}: expected a number, a text, true or false, or a list of them")
    try:
        given = get_parameter_value(value)
    except YAMLError as error:
        raise wrong from error
    if not isinstance(given.string_value, str):  # rclpy takes a mapping for a text
        raise wrong
    with Operator() as operator:
        name = operator.full_name(node)
        request = SetParameters.Request(parameters=[Parameter(name=parameter, value=given)])
        (result,) = operator.call(SetParameters, f"{name}/set_parameters", request).results
    if result.successful:
        print(f"{name}: {parameter} is {value}")
        return 0
    print(f"{name}: {parameter}: refused: {result.reason}", file=sys.stderr)
    return 1
