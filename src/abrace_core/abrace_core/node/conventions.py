"""What all nodes share: QoS, live parameters, diagnostics, the end of the process."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
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

ACKNOWLEDGEMENT_TIMEOUT = Duration(seconds=0.5)
"""How long a node that ends waits until its subscribers have what it published."""

DIAGNOSTICS = "/diagnostics"
"""Where monitors look for every node's state; absolute, so that they find it whatever the rig's namespace is."""

DISPLAY_PERIOD = 0.02
"""Seconds of wall time between messages for viewers."""

STREAM_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
"""Of the rig's subscriptions to `brace_command` and `ground_motion`: of late messages only the last ones matter."""
KEPT_STREAM_QOS = QoSProfile(depth=5000, reliability=ReliabilityPolicy.RELIABLE)
"""Of the publishers of streams and of the subscriptions that must not miss a sample: ten seconds are kept.

With ten samples kept, a logger that a busy machine delayed by some milliseconds lost samples of a lockstep run, and a
commander that joined a running rig lost samples one time in two: the 50 to 80 samples that are published during
discovery arrive all at once.
"""
TRANSIENT_LOCAL_QOS = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)


def rcl_message(error: Exception) -> str:
    """The message of an rcl error in one line, without the positions in rcl's source."""
    return re.sub(r", at \S+:\d+", "", " ".join(str(error).split()))


class AbraceNode(Node):
    """A node with abrace's conventions: checked parameters, diagnostics, an exit code.

    Parameters
    ----------
    name
        The node's name.
    table
        Its parameters; their values are attributes of `parameters`.
    """

    due: float | None = None
    """When `tick` is to be called [s, monotonic]; None: not at all."""
    exit_code: int | None = None
    """Of the process, once the node has finished."""

    def __init__(self, name: str, table: Sequence[Parameter]) -> None:
        Node.__init__(self, name)
        self.parameters = declare(self, table)
        self._live = {parameter.name: parameter for parameter in table if parameter.live}
        self.add_on_set_parameters_callback(self._on_set_parameters)
        self.ended = Future()
        self._endpoint_counts: list[tuple[str, Callable[[], int]]] = []
        self._publishers_of_streams: list[Publisher] = []
        self._diagnostics = self.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
        self.create_timer(1.0, self.publish_diagnostics, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _on_set_parameters(self, given: list[RosParameter]) -> SetParametersResult:
        try:
            for parameter in given:
                if parameter.name in self._live:
                    value = self._live[parameter.name].check(parameter)
                    self.parameter_changed(parameter.name, value)
                    setattr(self.parameters, parameter.name, value)
        except AbraceError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def parameter_changed(self, name: str, value: Any) -> None:
        """Make use of a live parameter's new `value`, or refuse it with an AbraceError."""

    def publish_on(self, message_type: type, topic: str, qos: QoSProfile) -> Publisher:
        """Create a publisher whose number of subscribers is in the diagnostics, and that is flushed at the end."""
        publisher = self.create_publisher(
            message_type, topic, qos, event_callbacks=PublisherEventCallbacks(matched=self._on_matched)
        )
        self._endpoint_counts.append((f"subscribers of {topic}", publisher.get_subscription_count))
        self._publishers_of_streams.append(publisher)
        return publisher

    def subscribe_to(
        self, message_type: type, topic: str, callback: Callable, qos: QoSProfile, *, raw: bool = False
    ) -> Subscription:
        """Create a subscription whose number of publishers is in the diagnostics."""
        events = SubscriptionEventCallbacks(matched=self._on_matched)
        subscription = self.create_subscription(message_type, topic, callback, qos, raw=raw, event_callbacks=events)
        self._endpoint_counts.append((f"publishers of {topic}", subscription.get_publisher_count))
        return subscription

    def _on_matched(self, status: object) -> None:
        self.publish_diagnostics()

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """(fault or None, message, values) of the node, for its diagnostics."""
        return None, "running", {}

    def publish_diagnostics(self) -> None:
        """Publish the node's state on `/diagnostics`, under its full name."""
        fault, message, values = self.diagnose()
        values.update((name, count()) for name, count in self._endpoint_counts)
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

    def tick(self) -> None:
        """Override; called when `due` has passed."""

    def finish(self, exit_code: int, message: str) -> None:
        """End the process after this callback."""
        self.exit_code = exit_code
        self.ended.set_result(None)
        print(f"{self.get_name()}: {message}", file=sys.stderr if exit_code else sys.stdout, flush=True)

    def close(self) -> None:
        """Override to close files before the node is destroyed."""

    def flush_publishers(self) -> None:
        """Wait until subscribers have acknowledged what was published: a destroyed publisher sends nothing more."""
        for publisher in self._publishers_of_streams:
            publisher.wait_for_all_acked(ACKNOWLEDGEMENT_TIMEOUT)
