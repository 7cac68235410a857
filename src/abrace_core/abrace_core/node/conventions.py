"""What every node does alike: QoS, parameters that may change, diagnostics, the end of the process."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.task import Future

from abrace_core.errors import AbraceError
from abrace_core.node.parameters import Parameter, declare

RCLError = rclpy_implementation.RCLError

LONGEST_HANDOVER = Duration(seconds=0.5)
"""How long a node that ends waits for those who still have to take what it published."""

LOOK_PERIOD = 0.02
"""Seconds of wall time between messages that are only looked at."""

STREAM_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
"""How the rig takes `brace_command` and `ground_motion`: of late ones the last will do."""
KEPT_STREAM_QOS = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)
"""How they are published, and taken by those who must not miss one: ten seconds are kept for a reader that is late.

With ten kept, a logger that a busy machine held up for some milliseconds lost samples of a lockstep run, and a
commander that joined a running rig lost samples one time in two: what is published while the two become acquainted,
some 50 to 80 samples, arrives all at once.
"""
LATCHED_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def rcl_message(error: Exception) -> str:
    """What rcl says of a mistake: one line, without the places in its source."""
    return re.sub(r", at \S+:\d+", "", " ".join(str(error).split()))


class Conventions:
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
        """Publish the state of this `node` once a second from here on."""
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


class AbraceNode(Conventions, Node):
    """A plain node with abrace's conventions; `parameters` holds the values of its table."""

    def __init__(self, name: str, table: Sequence[Parameter]) -> None:
        Node.__init__(self, name)
        self.parameters = declare(self, table)
        self.follow_parameters(self, table, self.parameters)
        self.start_diagnostics(self)
