# SPDX-License-Identifier: Apache-2.0
"""The campaign's own node in the graph: it reads diagnostics and changes the state of life cycle nodes."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.qos import QoSCompatibility, qos_check_compatible
from rclpy.signals import SignalHandlerOptions

from abrace.report.node_table import NodeReports, count_of
from abrace_core.errors import RunFailed
from abrace_core.node import DIAGNOSTICS
from abrace_core.node.leaving import destroy
from abrace_core.node.transport import profile

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from types import TracebackType
    from typing import Self

SPIN_TIMEOUT = 0.05
"""Seconds that one spin waits at most."""
TRANSITIONS = {
    Transition.TRANSITION_CONFIGURE: "configure",
    Transition.TRANSITION_ACTIVATE: "activate",
    Transition.TRANSITION_DEACTIVATE: "deactivate",
}


def expected_matches(inputs: Mapping[str, str], plant: bool = True) -> dict[str, dict[str, int]]:
    """What each node of a test has to find before that begins, for `GraphMonitor.wait_until_matched`.

    Parameters
    ----------
    inputs
        The topics that the rig obeys, and the node that publishes each.
    plant
        Whether the rig is the node `plant`; otherwise it is known by what it publishes alone.
    """
    expected = {"logger": {f"publishers of {topic}": 1 for topic in ("response", *inputs)}}
    if plant:
        expected["plant"] = {
            "subscribers of response": len(inputs) + 1,
            **{f"publishers of {topic}": 1 for topic in inputs},
        }
    else:
        # that rig already samples, and does not report whom it has found: samples before the first one received are not
        # recorded
        expected["logger"]["messages of response"] = 1
    for topic, node in inputs.items():
        expected[node] = {"publishers of response": 1, f"subscribers of {topic}": 2}
    return expected


class GraphMonitor:
    """Watches the nodes of a namespace, and no others, through their diagnostics; a context manager.

    Parameters
    ----------
    namespace
        Of the nodes, as `/demo`.
    driven
        Names of the life cycle nodes whose state it changes.
    name
        Of its node.
    enclave
        Of SROS2, whose keys it uses.
    """

    def __init__(self, namespace: str, driven: Sequence[str], name: str = "campaign", enclave: str = "/") -> None:
        self._namespace = namespace
        self._driven = driven
        self._name = name
        self._enclave = enclave
        self.reports = NodeReports()
        """What each node has reported last, by its name in the namespace."""

    @property
    def values(self) -> dict[str, Mapping[str, str]]:
        """Values of each node's last diagnostics, by node name."""
        return {name: report.values for name, report in self.reports.items()}

    @property
    def faults(self) -> dict[str, str]:
        """The fault that each node reports that has one."""
        return {name: report.message for name, report in self.reports.items() if report.failed}

    def __enter__(self) -> Self:
        self._context = rclpy.Context()
        with profile(streams=False):  # nodes that start after us find us at once
            self._context.init(args=["--ros-args", "--enclave", self._enclave])
            rclpy.signals.install_signal_handlers(SignalHandlerOptions.NO)
            self._node = rclpy.create_node(
                self._name, namespace=self._namespace, context=self._context, start_parameter_services=False
            )
        self._executor = rclpy.executors.SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        # a server drops its answers to a client that it has not discovered yet: made before the nodes start, or
        # `wait_until_heard` comes first
        self._state_clients = {
            name: self._node.create_client(ChangeState, f"{name}/change_state") for name in self._driven
        }
        # after the clients: whose diagnostics come has discovered those before
        self._node.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, 50)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown()
        destroy(self._node)
        self._context.try_shutdown()

    def _on_diagnostics(self, array: DiagnosticArray) -> None:
        for status in array.status:
            namespace, _, name = status.name.partition(":")[0].rpartition("/")
            if f"/{namespace}" != self._namespace:
                continue
            values = {pair.key: pair.value for pair in status.values}
            self.reports.keep(name, status.message, status.level == DiagnosticStatus.ERROR, values, time.monotonic())

    def spin_once(self) -> None:
        """Receive diagnostics and answers of services."""
        self._executor.spin_once(timeout_sec=SPIN_TIMEOUT)

    def wait_until_heard(self, node: str, timeout: float, check: Callable[[], None]) -> None:
        """Wait for the diagnostics of a node that may have started before us.

        Raises
        ------
        RunFailed
            If none come within `timeout` [s].
        """
        deadline = time.monotonic() + timeout
        while node not in self.values:
            self.spin_once()
            check()
            if time.monotonic() > deadline:
                raise RunFailed(f"no diagnostics of {node} in namespace {self._namespace} within {timeout:g} s")

    def tells_partners(self, node: str, timeout: float, check: Callable[[], None]) -> bool:
        """Whether a node of the user's reports in its diagnostics whom it has found, as abrace's nodes do.

        Parameters
        ----------
        node
            Its name.
        timeout
            Seconds in which its first diagnostics are waited for.
        check
            Called after each spin; raises when a node has died.
        """
        deadline = time.monotonic() + timeout
        while node not in self.values and time.monotonic() < deadline:
            self.spin_once()
            check()
        return any(key.startswith(("publishers of ", "subscribers of ")) for key in self.values.get(node, ()))

    def wait_until_matched(
        self, expected: Mapping[str, Mapping[str, int]], timeout: float, check: Callable[[], None]
    ) -> None:
        """Wait until every node reports that its publishers and subscribers are matched, and messages come.

        Further subscribers, such as viewers and `ros2 bag record`, are welcome, and waited for; further publishers are
        refused.

        Parameters
        ----------
        expected
            By node, by entry of its diagnostics ("subscribers of response"): how many at least; of publishers exactly.
        timeout
            Seconds.
        check
            Called after each spin; raises when a node has died.

        Raises
        ------
        RunFailed
            If some are missing after `timeout`, naming them; if there are more publishers than expected.
        """
        deadline = time.monotonic() + timeout
        while True:
            self.spin_once()
            check()
            missing = []
            for node, entries in expected.items():
                for entry, count in entries.items():
                    found = count_of(self.values.get(node, {}).get(entry, "")) or 0
                    side, _, topic = entry.partition(" of ")
                    if side == "subscribers":
                        # a count does not tell whose: where a viewer has matched, a partner may be missing
                        count = max(count, self._listeners(topic))
                    elif side == "publishers" and found > count:
                        raise RunFailed(
                            f"{node} has {found} {entry} in namespace {self._namespace}, expected {count}: "
                            "other nodes run there"
                        )
                    if found < count:
                        missing.append(f"{node} has {found} of {count} {entry}")
            if not missing:
                return
            if time.monotonic() > deadline:
                raise RunFailed(f"nodes did not find each other within {timeout:g} s: {'; '.join(missing)}")

    def _listeners(self, topic: str) -> int:
        """Subscriptions to a topic that its publisher can serve, those of viewers included."""
        offered = [endpoint.qos_profile for endpoint in self._node.get_publishers_info_by_topic(topic)]
        asked = [endpoint.qos_profile for endpoint in self._node.get_subscriptions_info_by_topic(topic)]
        return sum(any(qos_check_compatible(one, qos)[0] != QoSCompatibility.ERROR for one in offered) for qos in asked)

    def change_state(self, node: str, transition: int, timeout: float, check: Callable[[], None]) -> None:
        """Take a life cycle node through a transition.

        Raises
        ------
        RunFailed
            If it refuses or does not answer in time.
        """
        client = self._state_clients[node]
        deadline = time.monotonic() + timeout
        while not client.service_is_ready():
            self.spin_once()
            check()
            if time.monotonic() > deadline:
                raise RunFailed(f"{node} does not offer its life cycle within {timeout:g} s")
        request = ChangeState.Request()
        request.transition.id = transition
        future = client.call_async(request)
        while not future.done():
            self.spin_once()
            check()
            if time.monotonic() > deadline:
                raise RunFailed(f"{node} did not {TRANSITIONS[transition]} within {timeout:g} s")
        if not future.result().success:
            raise RunFailed(f"{node} refused to {TRANSITIONS[transition]}")

    def configure(self, node: str, timeout: float, check: Callable[[], None]) -> None:
        """Configure a life cycle node."""
        self.change_state(node, Transition.TRANSITION_CONFIGURE, timeout, check)

    def deactivate(self, node: str, timeout: float, check: Callable[[], None]) -> None:
        """Deactivate a life cycle node."""
        self.change_state(node, Transition.TRANSITION_DEACTIVATE, timeout, check)

    def activate(self, node: str, timeout: float, check: Callable[[], None]) -> None:
        """Activate a life cycle node."""
        self.change_state(node, Transition.TRANSITION_ACTIVATE, timeout, check)
