# SPDX-License-Identifier: Apache-2.0
"""When a test may begin: the nodes report whom they have found, and who is missing or too many is named."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.qos import DurabilityPolicy, QoSProfile

from abrace.nodes.graph_monitor import GraphMonitor
from abrace_core import RunFailed
from abrace_interfaces.msg import Response
from abrace_node.node import served_subscriptions

if TYPE_CHECKING:
    from collections.abc import Iterator

EXPECTED = {
    "plant": {"subscribers of response": 2, "publishers of brace_command": 1},
    "logger": {"messages of response": 1},
}
READY = {name: {entry: str(count) for entry, count in entries.items()} for name, entries in EXPECTED.items()}
PATIENCE = 60.0


class Reports:
    """What nodes report, and a monitor that has heard it."""

    def __init__(self, graph: Any, monitor: GraphMonitor) -> None:
        self.graph, self.monitor = graph, monitor
        # the graph's own subscription and the monitor's
        self._publisher = graph.publisher(DiagnosticArray, "/diagnostics", subscribers=2)
        self.looks = 0

    def say(self, **changed: dict[str, str]) -> None:
        """All nodes report that they are ready, but for what is `changed`."""
        for node, values in READY.items():
            pairs = [KeyValue(key=key, value=value) for key, value in {**values, **changed.get(node, {})}.items()]
            status = DiagnosticStatus(name=f"{self.graph.namespace[1:]}/{node}: state", values=pairs)
            self._publisher.publish(DiagnosticArray(status=[status]))
        expected = {node: {**values, **changed.get(node, {})} for node, values in READY.items()}
        self.graph.until(lambda: self.monitor.spin_once() or self.monitor.values == expected, "the monitor to hear it")

    def look(self) -> None:
        """A look of the monitor; at the fifth the nodes say that they are ready."""
        self.looks += 1
        if self.looks == 5:
            self.say()


@pytest.fixture
def reports(graph: Any) -> Iterator[Reports]:
    with GraphMonitor(graph.namespace, ()) as monitor:
        yield Reports(graph, monitor)


@pytest.mark.parametrize(
    ("node", "entry"),
    [
        ("plant", "subscribers of response"),
        ("plant", "publishers of brace_command"),
        ("logger", "messages of response"),
    ],
)
def test_a_test_begins_once_everything_is_there_and_no_sooner(reports: Reports, node: str, entry: str):
    reports.say(**{node: {entry: str(EXPECTED[node][entry] - 1)}})
    reports.monitor.wait_until_matched(EXPECTED, PATIENCE, reports.look)
    assert reports.looks == 5


def test_all_who_are_missing_are_named(reports: Reports):
    reports.say(plant={"subscribers of response": "1"}, logger={"messages of response": "none yet"})
    message = (
        "nodes did not find each other within 0.2 s: plant has 1 of 2 subscribers of response; "
        "logger has 0 of 1 messages of response"
    )
    with pytest.raises(RunFailed, match=f"^{message}$"):
        reports.monitor.wait_until_matched(EXPECTED, 0.2, lambda: None)
    absent = {"ground_motion": {"publishers of response": 1}}
    with pytest.raises(RunFailed, match="ground_motion has 0 of 1 publishers of response"):
        reports.monitor.wait_until_matched(absent, 0.2, lambda: None)


def test_one_publisher_too_many_is_refused_at_once(reports: Reports):
    reports.say(plant={"publishers of brace_command": "2"})
    message = (
        f"plant has 2 publishers of brace_command in namespace {reports.graph.namespace}, expected 1: other nodes run"
    )
    with pytest.raises(RunFailed, match=re.escape(message)):
        reports.monitor.wait_until_matched(EXPECTED, PATIENCE, reports.look)
    assert reports.looks == 1


def test_a_viewer_that_has_matched_does_not_stand_for_a_partner_that_has_not(reports: Reports):
    graph, monitor = reports.graph, reports.monitor
    graph.node.create_publisher(Response, "response", 10)
    for _ in range(3):
        graph.listen(Response, "response")
    # such a publisher cannot serve it
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    graph.listen(Response, "response", latched)

    def found() -> bool:
        monitor.spin_once()
        return len(served_subscriptions(monitor._node, "response")) == 3

    graph.until(found, "the monitor to find them")
    reports.say(plant={"subscribers of response": "2"})
    with pytest.raises(RunFailed, match=r"plant has 2 of 3 subscribers of response$"):
        monitor.wait_until_matched(EXPECTED, 0.2, lambda: None)
    reports.say(plant={"subscribers of response": "3"})
    monitor.wait_until_matched(EXPECTED, PATIENCE, lambda: None)


@pytest.mark.parametrize("there", ["plant", "campaign", "sensor_bridge"])
def test_a_rig_or_a_campaign_that_is_there_is_named_with_its_domain(graph: Any, domain: int, there: str):
    with GraphMonitor(graph.namespace, (), "campaign") as monitor:
        rclpy.create_node("logger", namespace=graph.namespace, context=graph.node.context)
        rclpy.create_node("plant", namespace="/another", context=graph.node.context)
        monitor.expect_no_rig(0.5)
        node = rclpy.create_node(there, namespace=graph.namespace, context=graph.node.context)
        node.create_publisher(Response, "response", 10)
        message = f"namespace {graph.namespace} of ROS domain {domain} has {there} already, expected no rig and no "
        with pytest.raises(RunFailed, match=f"^{message}campaign there: end it, or take another ROS_DOMAIN_ID or "):
            monitor.expect_no_rig(PATIENCE)
        node.destroy_node()
