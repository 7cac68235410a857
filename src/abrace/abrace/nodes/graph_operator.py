# SPDX-License-Identifier: Apache-2.0
"""What an operator does on the running graph: hears every node's reports, presses stop, calls services.

For the `abrace` command (`operator_commands`), and for the page in a browser (node `operator` of abrace_bringup).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.client import Client
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from abrace.report.node_table import NodeReport, NodeReports
from abrace_core import AbraceError
from abrace_core.files.suggestion import did_you_mean
from abrace_node.node import DIAGNOSTICS

STOP_TOPIC = "/emergency_stop"
STOP_PERIOD = 0.1
"""Seconds after which a stop button repeats itself."""
PATIENCE = 5.0
"""Seconds in which nodes have to be found, and to answer."""
TRIES = 4
"""Of having an answer within that time."""
LISTEN = 2.0
"""Seconds of listening for nodes, at least; every one reports once a second."""

_INACTIVE, _ACTIVE = "inactive", "active"
"""States of the life cycle, by rclpy's labels."""


class Refused(AbraceError):  # noqa: N818
    """A node refused a request; the message is its reason."""


class StopButton:
    """One of the laboratory's stop buttons.

    Its `node` publishes, now and every `STOP_PERIOD`, whether it is `pressed`, which is called in any thread.
    """

    def __init__(self, node: Node, publisher: Publisher, pressed: Callable[[], bool]) -> None:
        self._publisher, self._pressed = publisher, pressed
        # a `false` that was true a moment ago must not come after the `true`
        self._lock = threading.Lock()
        self._repeated = node.create_timer(STOP_PERIOD, self.publish)

    def publish(self) -> None:
        """Publish whether it is pressed, now; from any thread."""
        with self._lock:
            self._publisher.publish(Bool(data=self._pressed()))

    def rest(self) -> None:
        """Repeat it no more."""
        self._repeated.cancel()


class GraphOperator:
    """An operator in the running graph.

    `receive` lets its `node` receive for a moment, spins it, or waits while another thread does.
    """

    def __init__(self, node: Node, receive: Callable[[], object]) -> None:
        self.node = node
        self._receive = receive
        self._clients: dict[str, Client] = {}
        self.reports = NodeReports()
        """What each node has reported last, by its full name."""
        node.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, 100)

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            self.reports.note(status, time.monotonic())

    def wait(self, seconds: float, until: Callable[[], Any] = bool) -> bool:
        """Receive for so many seconds, or until the condition holds; returns whether it does."""
        deadline = time.monotonic() + seconds
        while not until():
            if time.monotonic() >= deadline:
                return False
            self._receive()
        return True

    def hear_all(self) -> None:
        """Listen until everyone who reports has done so twice, which tells rates, or patience is at an end."""
        self.wait(LISTEN)
        self.wait(PATIENCE, self._heard_all)

    def _heard_all(self) -> bool:
        endpoints = self.node.get_publishers_info_by_topic(DIAGNOSTICS)
        names = {_full_name(one) for one in endpoints} - {self.node.get_fully_qualified_name()}
        return bool(names) and all(name in self.reports and _tells_rate(self.reports[name]) for name in names)

    def full_name(self, given: str) -> str:
        """The full name of a node, `given` as that or as its last part.

        Raises
        ------
        AbraceError
            If there is none of that name, or several.
        """

        def found() -> list[str]:
            nodes = self.node.get_node_names_and_namespaces()
            names = {f"{space.rstrip('/')}/{name}" for name, space in nodes} - {self.node.get_fully_qualified_name()}
            return sorted(name for name in names if name == given or name.endswith(f"/{given.lstrip('/')}"))

        self.wait(PATIENCE, found)
        names = found()
        if len(names) == 1:
            return names[0]
        if names:
            raise AbraceError(f"node {given}: several, expected one of {', '.join(names)}")
        self.hear_all()
        near = did_you_mean(given.rpartition("/")[2], [name.rpartition("/")[2] for name in self.reports])
        expected = " or ".join(sorted(self.reports)) or "one that runs"
        raise AbraceError(f"node {given}: not found, expected {expected}{near}")

    def rigs(self) -> list[str]:
        """Full names of the nodes that listen to the stop button."""
        return _names(self.node.get_subscriptions_info_by_topic(STOP_TOPIC))

    def publishers(self, topic: str) -> list[str]:
        """Full names of the nodes that publish a `topic`."""
        return _names(self.node.get_publishers_info_by_topic(self.node.resolve_topic_name(topic)))

    def client(self, service_type: type, service: str) -> Client:
        """The client of a service.

        A server drops its answers to a client that it has not discovered yet: what is to be called at once needs one
        that has been there for a while.
        """
        if service not in self._clients:
            self._clients[service] = self.node.create_client(service_type, service)
        return self._clients[service]

    def call(self, service_type: type, service: str, request: Any, tries: int = TRIES) -> Any:
        """Call a service; returns its answer. What must not be done twice takes one of `tries`.

        Raises
        ------
        AbraceError
            If no node offers it, or none answers.
        """
        client = self.client(service_type, service)
        if not self.wait(PATIENCE, client.service_is_ready):
            raise AbraceError(f"service {service}: not offered, expected a node that has it")
        for _ in range(tries):
            asked = client.call_async(request)
            if self.wait(PATIENCE / tries, asked.done):
                return asked.result()
        raise AbraceError(f"service {service}: no answer within {PATIENCE:g} s")

    def trigger(self, service: str, tries: int = 1) -> str:
        """Call a service of type std_srvs/Trigger, at most `tries` times; returns what it answers.

        Raises
        ------
        Refused
            If it refuses, with its reason.
        AbraceError
            If it does not answer.
        """
        answer = self.call(Trigger, service, Trigger.Request(), tries)
        if not answer.success:
            raise Refused(answer.message)
        return str(answer.message)

    def state(self, node: str) -> str:
        """The state of a life cycle `node`, as rclpy calls it."""
        return str(self.call(GetState, f"{node}/get_state", GetState.Request()).current_state.label)

    def arm(self, node: str) -> str:
        """Configure a life cycle `node`, if it is not yet, and activate it.

        Raises
        ------
        Refused
            If it does not get there.
        """
        state = self.state(node)
        if state == _ACTIVE:
            return "armed already"
        if state != _INACTIVE:
            self._change_state(node, Transition.TRANSITION_CONFIGURE, _INACTIVE)
        self._change_state(node, Transition.TRANSITION_ACTIVATE, _ACTIVE)
        return "armed"

    def disarm(self, node: str) -> str:
        """Deactivate a life cycle `node`; it comes to rest first.

        Raises
        ------
        Refused
            If it does not get there.
        """
        if self.state(node) != _ACTIVE:
            return "not armed"
        self._change_state(node, Transition.TRANSITION_DEACTIVATE, _INACTIVE)
        return "disarmed"

    def _change_state(self, node: str, transition: int, state: str) -> None:
        """Take a life cycle node through a transition to a `state`, which tells where an answer was dropped."""
        client = self.client(ChangeState, f"{node}/change_state")
        request = ChangeState.Request(transition=Transition(id=transition))
        for _ in range(TRIES):
            asked = client.call_async(request)
            self.wait(PATIENCE / TRIES, asked.done)
            if (found := self.state(node)) == state:
                return
            if asked.done():
                break
        report = self.reports.get(node)
        reason = f": {report.message}" if report and report.failed else "; its log says why"
        raise Refused(f"refused, the node is {found}{reason}")


def _tells_rate(report: NodeReport) -> bool:
    """Whether reports have come that are far enough apart; of a node without samples two do."""
    return report.count > 1 and (report.rate is not None or report.sequence < 0)


def _full_name(endpoint: Any) -> str:
    return f"{endpoint.node_namespace.rstrip('/')}/{endpoint.node_name}"


def _names(endpoints: Iterable[Any]) -> list[str]:
    return sorted(set(map(_full_name, endpoints)))
