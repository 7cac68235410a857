# SPDX-License-Identifier: Apache-2.0
"""The campaign's own node in the graph: reads diagnostics, changes the state of life cycle nodes, begins signals."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from abrace.nodes.graph_operator import StopButton
from abrace.report.node_table import NodeReports, count_of
from abrace_core import RunFailed
from abrace_node.node import DIAGNOSTICS, served_subscriptions
from abrace_node.transport import TRANSIENT_LOCAL_QOS, destroy, profile

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from types import TracebackType
    from typing import Self

SPIN_TIMEOUT = 0.05
"""Seconds that one spin waits at most."""
TRANSITIONS = {
    "configure": Transition.TRANSITION_CONFIGURE,
    "activate": Transition.TRANSITION_ACTIVATE,
    "deactivate": Transition.TRANSITION_DEACTIVATE,
}


def expected_matches(inputs: Mapping[str, str], plant: bool = True) -> dict[str, dict[str, int]]:
    """What each node of a test has to find before that begins, for `GraphMonitor.wait_until_matched`.

    `inputs` of the rig, and the node that publishes each. Without `plant` the rig is known by what it publishes alone.
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
    """Watches the nodes of a `namespace` (`/demo`), and no others, through their diagnostics; a context manager.

    It changes the state of the life cycle nodes `driven`, and begins the signals of the nodes `signals`; its own node
    has a `name` and an `enclave` of SROS2.
    """

    def __init__(
        self,
        namespace: str,
        driven: Sequence[str],
        signals: Sequence[str] = (),
        name: str = "monitor",
        enclave: str = "/",
    ) -> None:
        self._namespace = namespace
        self._driven, self._signals = driven, signals
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
        self._play_clients = {name: self._node.create_client(Trigger, f"{name}/play") for name in self._signals}
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

    def expect_no_rig(self, seconds: float) -> None:
        """Look for a rig, or a campaign's node of the same name, in the namespace for so many `seconds`.

        Raises
        ------
        RunFailed
            If there is one.
        """
        deadline, own = time.monotonic() + seconds, (self._name, self._namespace)
        while time.monotonic() < deadline:
            self.spin_once()
            nodes = self._node.get_node_names_and_namespaces()
            nodes.remove(own)
            found = {name for name, space in nodes if space == self._namespace and name in ("plant", self._name)}
            found |= {one.node_name for one in self._node.get_publishers_info_by_topic("response")}
            if found:
                raise RunFailed(
                    f"namespace {self._namespace} of ROS domain {self._context.get_domain_id()} has "
                    f"{' and '.join(sorted(found))} already, expected no rig and no campaign there: end it, or take "
                    "another ROS_DOMAIN_ID or campaign name"
                )

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
        """Whether the user's `node` reports whom it has found in its first diagnostics, as abrace's nodes do.

        They have `timeout` [s]; `check` is called after each spin, and raises when a node has died.
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
        refused. `expected`: by node, by entry of its diagnostics ("subscribers of response"), how many at least; of
        publishers exactly. `check` is called after each spin, for at most `timeout` [s], and raises when a node has
        died.

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
                        count = max(count, len(served_subscriptions(self._node, topic)))
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

    def change_state(self, node: str, transition: str, timeout: float, check: Callable[[], None]) -> None:
        """Take a life cycle node through a transition of TRANSITIONS.

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
        request.transition.id = TRANSITIONS[transition]
        future = client.call_async(request)
        while not future.done():
            self.spin_once()
            check()
            if time.monotonic() > deadline:
                raise RunFailed(f"{node} did not {transition} within {timeout:g} s")
        if not future.result().success:
            raise RunFailed(f"{node} refused to {transition}")

    def play(self, timeout: float, check: Callable[[], None]) -> None:
        """Have all `signals` play, each as soon as its node accepts it: when the rig is running.

        Raises
        ------
        RunFailed
            If one does not within `timeout` [s], with the node's reason.
        """
        deadline, waiting = time.monotonic() + timeout, dict.fromkeys(self._signals, "no answer")
        while not all(client.service_is_ready() for client in self._play_clients.values()):
            self.spin_once()
            check()
            if time.monotonic() > deadline:
                raise RunFailed(f"{' or '.join(waiting)} does not offer to play within {timeout:g} s")
        while waiting:
            asked = {node: self._play_clients[node].call_async(Trigger.Request()) for node in waiting}
            while not all(answer.done() for answer in asked.values()) and time.monotonic() < deadline:
                self.spin_once()
                check()
            for node, answer in asked.items():
                if answer.done() and answer.result().success:
                    del waiting[node]
                elif answer.done():
                    waiting[node] = answer.result().message
            if waiting and time.monotonic() > deadline:
                reasons = "; ".join(f"{node}: {reason}" for node, reason in waiting.items())
                raise RunFailed(f"not playing within {timeout:g} s: {reasons}")
            time.sleep(SPIN_TIMEOUT if waiting else 0.0)


def repeat_as_stop_button(monitor: GraphMonitor) -> None:
    """Make a `monitor` a stop button that repeats itself while it spins: of a rig that is emulated."""
    publisher = monitor._node.create_publisher(Bool, "emergency_stop", TRANSIENT_LOCAL_QOS)
    StopButton(monitor._node, publisher, lambda: False)
