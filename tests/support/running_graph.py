# SPDX-License-Identifier: Apache-2.0
"""The real nodes as processes of their own over real DDS, beside a node of whoever watches or drives them.

For the tests in `tests/graph` and for `make verify`. Nothing here waits for a time to pass: `Graph.until` waits for a
condition, with a deadline that a healthy machine never comes near.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from isolation import own_shared_memory
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.experimental import EventsExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from abrace.processes.group import NodeProcess, ProcessGroup, find_executable
from abrace.processes.parameter_file import parameter_file
from abrace_core.files.installed import find_file
from abrace_interfaces.msg import BraceCommand, Response
from abrace_node.transport import profile

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from rclpy.client import Client
    from rclpy.node import Node
    from rclpy.publisher import Publisher
    from rclpy.task import Future

PATIENCE = 60.0
PATIENT = {
    "plant": {"command_timeout": 10.0, "late_limit": 1000, "lockstep_timeout": PATIENCE},
    "sensor_bridge": {"command_timeout": 0.1, "late_limit": 100},
}
"""Long time limits of a rig: a machine that stands still for a moment is no fault."""
PACKAGES = {
    "plant": "abrace_plant",
    "sensor_bridge": "abrace_plant",
    "ground_motion": "abrace_plant",
    "logger": "abrace_bags",
    "replay": "abrace_bags",
    "excitation": "abrace_sysid",
    "controller": "abrace_lqg",
    "supervisor": "abrace",
    "viewer": "abrace_bringup",
    "operator": "abrace_bringup",
}
COMMANDS = {"ground_motion": "ground_motion", "excitation": "brace_command", "controller": "brace_command"}
"""The topic on which each of these nodes commands a rig."""
SLOW = 100.0
"""Samples a second that a busy machine keeps up with."""
SIGNALS = ("excitation", "ground_motion")
"""Nodes whose signal begins by a goal."""
RIGS = ("plant", "sensor_bridge")
STALLS = ("no response for more than ", "samples lost before sample ")
"""In the fault of who commands a rig by the clock on a computer that stands still for a moment."""
STREAMING = ("plant", "sensor_bridge", "ground_motion", "excitation", "controller")
TRANSITIONS = {
    "configure": Transition.TRANSITION_CONFIGURE,
    "activate": Transition.TRANSITION_ACTIVATE,
    "deactivate": Transition.TRANSITION_DEACTIVATE,
    "cleanup": Transition.TRANSITION_CLEANUP,
    "shutdown": Transition.TRANSITION_ACTIVE_SHUTDOWN,
}
LEADS_TO = {
    "configure": "inactive",
    "activate": "active",
    "deactivate": "inactive",
    "cleanup": "unconfigured",
    "shutdown": "finalized",
}
STREAM = QoSProfile(depth=50_000, reliability=ReliabilityPolicy.RELIABLE)
"""What a busy machine lets wait is kept: a lockstep rig does not wait for who only listens."""
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def may_have_priority() -> bool:
    """Whether a process of ours may have a real-time priority."""
    tried = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(20))"
    return subprocess.run([sys.executable, "-c", tried], stderr=subprocess.DEVNULL, check=False).returncode == 0


def stamp(message: Any) -> int:
    """The time in a message's header [ns]."""
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


class Graph:
    """Nodes in a namespace, and the tests' own node among them."""

    def __init__(self, namespace: str, folder: Path, context: rclpy.Context, processes: ProcessGroup) -> None:
        self.namespace = namespace
        self.folder = folder
        self.processes = processes
        with profile(streams=False):  # so that nodes that start later discover this one at once
            self.node: Node = rclpy.create_node("test", namespace=namespace, context=context)
        self.executor = EventsExecutor(context=context)
        self.executor.add_node(self.node)
        self.started: dict[str, NodeProcess] = {}
        self.executables: set[str] = set()
        """Of all nodes that have been started."""
        self.by_the_clock = False
        """Whether time is the subject: rigs have their default time limits, and who streams a real-time priority."""
        self.may_end: set[str] = set()
        """Names of nodes that may end while we wait."""
        self._clients: dict[str, Client] = {}
        self.statuses: dict[str, DiagnosticStatus] = {}
        """The last diagnostics of each node, by its name."""
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            namespace, _, name = status.name.partition(":")[0].rpartition("/")
            if f"/{namespace}" == self.namespace:
                self.statuses[name] = status

    def slow_rig(self) -> str:
        """A file of the paper's rig with SLOW samples a second, for tests by the clock of which speed is no subject."""
        file = self.folder / "slow.yaml"
        text = find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig").read_text()
        file.write_text(re.sub(r"(?m)^sample_rate:.*$", f"sample_rate: {SLOW}", text))
        return str(file)

    def start(
        self,
        executable: str,
        *arguments: str | Path,
        name: str = "",
        **parameters: Any,
    ) -> NodeProcess:
        """Start a node with parameters and further ROS arguments; `name`: the executable's by default."""
        name = name or executable
        self.executables.add(executable)
        if executable in STREAMING:
            timing = {"thread_priority": 50} if self.by_the_clock else PATIENT.get(executable, {})
            button = {"stop_heartbeat": 600.0} if executable == "sensor_bridge" else {}  # no test has a button for long
            parameters = {**timing, **button, **parameters}
        command: list[str | Path] = [find_executable(PACKAGES[executable], executable)]
        command += ["--ros-args", "-r", f"__ns:={self.namespace}"]
        if name != executable:
            command += ["-r", f"__node:={name}"]
        if parameters:
            command += ["--params-file", parameter_file(self.folder / f"{name}.yaml", parameters)]
        log = self.folder / f"{name}.log"
        process = self.processes.start(name, [*command, *arguments], log)
        self.started[name] = process
        if executable in STREAMING:
            self._client(ChangeState, f"{name}/change_state")
            self._client(GetState, f"{name}/get_state")
            self._client(Trigger, f"{name}/clear_fault")
        if executable in SIGNALS:
            self._client(Trigger, f"{name}/play")
        return process

    def _client(self, service_type: type, service: str) -> Client:
        """The client of a service, made when its node starts: a server drops answers to a newly discovered client."""
        if service not in self._clients:
            self._clients[service] = self.node.create_client(service_type, service)
        return self._clients[service]

    def until(self, holds: Callable[[], Any], what: str, patience: float = PATIENCE) -> Any:
        """Spin until `holds()`; fail when it does not within `patience`, or when a node has died."""
        began = time.monotonic()
        while not (answer := holds()):
            waited = time.monotonic() - began
            assert waited < patience, f"waited {waited:.0f} s for {what}; {self.reported()}"
            self.executor.spin_once(timeout_sec=0.02)
            for process in self.started.values():
                if process.returncode is not None and process.name not in self.may_end:
                    raise process.died()
        return answer

    def reported(self) -> str:
        """The diagnostics of each node, and the exit codes and output of those that have ended."""
        said = [f"{name}: {status.message}" for name, status in self.statuses.items()]
        ended = {name: process.returncode for name, process in self.started.items() if process.returncode is not None}
        return "; ".join(
            [*said, *(f"{name} ended with {code}: {self.output_of(name)[-3:]}" for name, code in ended.items())]
        )

    def ended(self, name: str, patience: float = PATIENCE) -> int:
        """Wait for the end of a node; returns its exit code."""
        self.may_end.add(name)
        process = self.started[name]
        self.until(lambda: process.returncode is not None, f"{name} to end", patience)
        assert process.returncode is not None
        return process.returncode

    def stop(self, name: str) -> int:
        """Stop a node with SIGINT; returns its exit code."""
        self.may_end.add(name)
        process = self.processes.stop(name)
        self.until(lambda: process.returncode is not None, f"{name} to end")
        assert process.returncode is not None
        return process.returncode

    def kill(self, name: str) -> None:
        """End a node with SIGKILL, and remove its files in shared memory."""
        process = self.started[name]
        left = own_shared_memory(process.group)
        os.kill(process.group, signal.SIGKILL)
        assert self.ended(name) == -signal.SIGKILL
        for file in left:
            file.unlink(missing_ok=True)

    def output_of(self, name: str) -> list[str]:
        """The lines that a node has printed."""
        return self.started[name].log_file.read_text().splitlines()

    def listen(self, message_type: type, topic: str, qos: QoSProfile = STREAM) -> list[Any]:
        """Subscribe; returns the list to which messages are appended."""
        messages: list[Any] = []
        self.node.create_subscription(message_type, topic, messages.append, qos)
        return messages

    def publisher(self, message_type: type, topic: str, qos: QoSProfile = STREAM, subscribers: int = 1) -> Publisher:
        """A publisher with that many subscribers matched."""
        publisher = self.node.create_publisher(message_type, topic, qos)
        self.until(lambda: publisher.get_subscription_count() >= subscribers, f"subscribers of {topic}")
        return publisher

    def values(self, name: str) -> dict[str, str]:
        """The values in a node's last diagnostics."""
        status = self.statuses.get(name)
        return {entry.key: entry.value for entry in status.values} if status else {}

    def until_matched(self, name: str, **counts: int) -> None:
        """Wait until a node reports its matched partners: `response=2` means two on the topic `response`."""

        def matched() -> bool:
            values = self.values(name)
            return all(
                int(values.get(f"{side} of {topic}", 0)) >= count
                for topic, count in counts.items()
                for side in ("publishers", "subscribers")
                if f"{side} of {topic}" in values
            ) and all(any(f"{side} of {topic}" in values for side in ("publishers", "subscribers")) for topic in counts)

        self.until(matched, f"{name} to match {counts}")

    def run_to_the_end(self) -> None:
        """Begin the test of `plant`, which is unconfigured, once all are matched; at its end stop the others."""
        others = [name for name in self.started if name != "plant"]
        inputs = [COMMANDS[name] for name in others if name in COMMANDS]
        assert self.change_state("plant", "configure")
        self.until_matched("plant", response=len(others), **dict.fromkeys(inputs, 1))
        for name in others:
            own = {COMMANDS[name]: 1 + ("logger" in others)} if name in COMMANDS else dict.fromkeys(inputs, 1)
            self.until_matched(name, response=1, **own)
        self.may_end.add("plant")
        assert self.change_state("plant", "activate")
        self.play(*(name for name in others if name in SIGNALS))
        assert self.ended("plant") == 0, self.output_of("plant")
        for name in others:
            assert self.stop(name) == 0, self.output_of(name)

    def until_fault(self, name: str, reason: str) -> None:
        """Wait until a node reports a fault with these words, at level ERROR."""

        def reported() -> bool:
            status = self.statuses.get(name)
            return (
                status is not None
                and status.level == DiagnosticStatus.ERROR
                and status.message.startswith("fault: ")
                and reason in status.message
            )

        self.until(reported, f"{name} to report a fault: {reason}")

    def until_well(self, name: str) -> None:
        """Wait until a node's next diagnostics, which have to report no fault."""
        self.statuses.pop(name, None)
        self.until(lambda: name in self.statuses, f"diagnostics of {name}")
        status = self.statuses[name]
        assert status.level == DiagnosticStatus.OK, status.message

    def ask(self, service_type: type, service: str, request: Any) -> Future:
        """Call a service once it is there; its response is the future's result."""
        client = self._client(service_type, service)
        self.until(client.service_is_ready, f"service {service}")
        return client.call_async(request)

    def call(self, service_type: type, service: str, request: Any) -> Any:
        """Call a service and wait for its response."""
        answer = self.ask(service_type, service, request)
        self.until(answer.done, f"an answer of {service}")
        return answer.result()

    def change_state(self, name: str, transition: str) -> bool:
        """Take a life cycle node through a transition; whether it went.

        Where a server dropped its answer to a client that it hardly knew, the state tells; else it is asked again. Of a
        busy node the first request may then have had its effect, and the second one none.
        """
        request = ChangeState.Request(transition=Transition(id=TRANSITIONS[transition]))
        begin, again = time.monotonic(), False
        while True:
            asked, answer = time.monotonic(), self.ask(ChangeState, f"{name}/change_state", request)
            self.until(lambda: answer.done() or time.monotonic() > asked + 6, f"an answer of {name}")  # noqa: B023
            if answer.done():
                result = answer.result()
                assert result is not None
                return bool(result.success) or (again and self.state(name) == LEADS_TO[transition])
            if self.state(name) == LEADS_TO[transition]:
                return True
            again = True
            assert time.monotonic() < begin + PATIENCE, f"no answer of {name} to {transition}; {self.reported()}"

    def state(self, name: str) -> str:
        """A life cycle node's state; the request is repeated if a server dropped its answer to a new client."""
        answers: list[Future] = []

        def answered() -> Any:
            if not answers or time.monotonic() > asked + 5 * len(answers):
                answers.append(self.ask(GetState, f"{name}/get_state", GetState.Request()))
            return next((answer for answer in answers if answer.done()), None)

        asked = time.monotonic()
        return str(self.until(answered, f"the state of {name}").result().current_state.label)

    def play(self, *names: str) -> None:
        """Have the signals of these nodes play, each as soon as it is accepted: when the rig is running."""
        asked: dict[str, Future] = {}

        def play() -> bool:
            for name in names:
                answer = asked.get(name)
                if answer is None or (answer.done() and not answer.result().success):
                    self._clear_stall()
                    asked[name] = self.ask(Trigger, f"{name}/play", Trigger.Request())
            return all(answer.done() and answer.result().success for answer in asked.values())

        self.until(play, f"{names} to play")

    def _clear_stall(self) -> None:
        """Clear, as a person does, who has stopped since this computer stood still; the rig after its commanders."""
        running = [name for name, process in self.started.items() if process.returncode is None]
        said = {name: self.statuses[name].message for name in running if name in self.statuses}
        stalled = [name for name, message in said.items() if any(text in message for text in STALLS)]
        for name in sorted(stalled, key=lambda name: name in RIGS):
            self.clear_fault(name)

    def clear_fault(self, name: str) -> Trigger.Response:
        """Call a node's clear_fault."""
        return self.call(Trigger, f"{name}/clear_fault", Trigger.Request())

    def clear_any_fault(self, name: str) -> None:
        """Clear the fault of a rig, if it has one, as a person does: again until rest has been measured."""

        def cleared() -> bool:
            answer = self.clear_fault(name)
            return answer.success or answer.message.startswith("no fault")

        self.until(cleared, f"{name} to be cleared")

    def emergency_stop(self) -> Callable[[bool], None]:
        """A stop button: a transient local publisher of emergency_stop, matched with the plant."""
        publisher = self.publisher(Bool, "emergency_stop", LATCHED)
        return lambda pressed: publisher.publish(Bool(data=pressed))

    def close(self) -> None:
        """Remove the tests' node from the graph."""
        self.executor.shutdown()
        self.node.destroy_node()


@contextlib.contextmanager
def graph_of_its_own(namespace: str) -> Iterator[Graph]:
    """A graph with its own participant and its files in the present folder; no node of it is left afterwards."""
    context = rclpy.Context()
    context.init()
    with ProcessGroup() as processes:
        graph = Graph(namespace, Path.cwd(), context, processes)
        try:
            yield graph
        finally:
            graph.close()
            context.try_shutdown()


class Commander:
    """Commands the braces of a rig in lockstep: answers each sample with a given force."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph
        self.responses: list[Response] = graph.listen(Response, "response")
        self._publisher = graph.publisher(BraceCommand, "brace_command")
        graph.until(lambda: self.responses, "the rig's first sample")

    def send(self, force: Sequence[float], fault: str = "") -> None:
        """Answer the present sample; `fault`: a fault of its own to report."""
        sample = self.responses[-1]
        answer = BraceCommand(run=sample.run, sequence=sample.sequence, force=force, fault=fault)
        self._publisher.publish(answer)

    def answer(self, *forces: Sequence[float]) -> None:
        """Answer one sample with each of these forces."""
        for force in forces:
            more = self._more()
            self.send(force)
            self._graph.until(more, "the next sample")

    def _more(self) -> Callable[[], bool]:
        count = len(self.responses)
        return lambda: len(self.responses) > count

    def hold(self, force: float, samples: int) -> None:
        """Answer a number of samples with one force."""
        self.answer(*[[force]] * samples)

    @property
    def states(self) -> np.ndarray:
        """(samples,) of the rig."""
        return np.array([response.state for response in self.responses])

    @property
    def commands(self) -> np.ndarray:
        """(samples,) [N], the command that acted until each sample."""
        return np.array([response.command[0] for response in self.responses])

    @property
    def forces(self) -> np.ndarray:
        """(samples,) [N], as measured."""
        return np.array([response.force[0] for response in self.responses])
