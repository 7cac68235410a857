# SPDX-License-Identifier: Apache-2.0
"""The node `supervisor`: begins a test when all nodes have found each other, and ends it after its last signal.

abrace run abrace supervisor --ros-args -p inputs:=[brace_command=controller] -p signals:=[ground_motion]

With it `ros2 launch` runs a test as a campaign does: the rig stays inactive until all topics are recorded. Signals are
those of nodes that report `signal` and `elapsed` in their diagnostics: `ground_motion` and `excitation`.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rclpy.task import Future

from abrace.nodes.graph_monitor import GraphMonitor, expected_matches
from abrace_core import AbraceError
from abrace_core.safety.rig_safety import RAMP_TIME
from abrace_node.node import AbraceNode
from abrace_node.parameters import Parameter
from abrace_node.process import run
from abrace_node.threads import LONGEST_WAIT

if TYPE_CHECKING:
    from collections.abc import Iterator

STUCK = 30.0
"""Seconds without progress of a signal that end a test."""
MOST_PROBLEMS = 100
"""Different problems that are kept for the end."""

PARAMETERS = [
    Parameter(
        "inputs",
        [],
        "inputs of the rig and the nodes that publish them: brace_command=controller, ground_motion=ground_motion",
        element=str,
        required=True,
    ),
    Parameter("plant", True, "the rig is the node plant, which is activated; false: the nodes of inputs are, in turn"),
    Parameter("signals", [], "nodes whose signals are played, and waited for; empty: runs until stopped", element=str),
    Parameter("free_decay", 5.0, "s from the end of the last signal to the end of the test", minimum=0.0),
    Parameter("patience", 30.0, "s within which the nodes have to start and find each other", minimum=0.1),
]


class Supervisor(AbraceNode):
    """Activates the inactive nodes, watches the signals, and ends: with code 1 if there was a problem."""

    def __init__(self) -> None:
        super().__init__("supervisor", PARAMETERS)
        given = self.parameters
        pairs = [text.partition("=") for text in given.inputs]
        self.inputs = {topic: node for topic, _, node in pairs}
        if not all(topic and node for topic, _, node in pairs) or len(self.inputs) < len(pairs):
            raise AbraceError(f"parameter inputs: {given.inputs}, expected topic=node, each topic once")
        self.held = ["plant"] if given.plant else list(self.inputs.values())
        self.problems: list[str] = []
        if given.signals:  # the test has an end, and is stopped before it
            self.stopped_exit_code = 130

    def work(self) -> None:
        """Begin, watch and end the test."""
        own = "supervisor_monitor", self.enclave
        watching = GraphMonitor(self.get_namespace(), self.held, self.parameters.signals, *own)
        with self.answering(), watching as self.monitor:
            try:
                self.begin()
                self.watch()
                self.end()
            except AbraceError as error:
                self.finish(1, str(error))
                return
        if self.problems:
            self.finish(1, "; ".join(self.problems))
        else:
            self.finish(0, "the test is over")

    @contextmanager
    def answering(self) -> Iterator[None]:
        """Have a thread answer the node's services, as whoever displays its parameters expects, and report."""
        over = Future()
        with self.spinning() as executor:

            def spin() -> None:
                while not over.done():
                    executor.spin_until_future_complete(over, LONGEST_WAIT)

            thread = threading.Thread(target=spin, name="services")
            thread.start()
            try:
                yield
            finally:
                executor.create_task(over.set_result, None)
                thread.join()

    def fail(self, error: BaseException) -> None:
        """End `work` as well: a service has failed."""
        super().fail(error)
        os.kill(os.getpid(), signal.SIGTERM)

    def note_faults(self) -> None:
        """Keep the faults that nodes report, for the end: a person may clear them, and the test go on."""
        for node, fault in self.monitor.faults.items():
            self.note(f"{node}: {fault}")

    def note(self, problem: str) -> None:
        """Keep a problem for the end, one of the first MOST_PROBLEMS."""
        if problem not in self.problems and len(self.problems) < MOST_PROBLEMS:
            self.problems.append(problem)

    @property
    def enclave(self) -> str:
        """The node's own, of SROS2, by its argument `--enclave`."""
        itself = self.get_name(), self.get_namespace()
        nodes = self.get_node_names_and_namespaces_with_enclaves()
        return next(enclave for name, namespace, enclave in nodes if (name, namespace) == itself)

    def begin(self) -> None:
        """Configure the inactive nodes, activate them once all nodes are matched, and have the signals play."""
        monitor, patience = self.monitor, self.parameters.patience
        for node in self.held:
            monitor.wait_until_heard(node, patience, self.note_faults)
            monitor.change_state(node, "configure", patience, self.note_faults)
        monitor.wait_until_matched(expected_matches(self.inputs, self.parameters.plant), patience, self.note_faults)
        for node in self.held:
            monitor.change_state(node, "activate", patience, self.note_faults)
        monitor.play(patience, self.note_faults)
        print(f"supervisor: all nodes have found each other; {' and '.join(self.held)} activated", flush=True)

    def watch(self) -> None:
        """Wait for the end of every signal, and of the free decay after them; without a signal, for ever."""
        waiting = list(self.parameters.signals)
        while not waiting:
            self.monitor.spin_once()
        news = time.monotonic()
        elapsed = dict.fromkeys(waiting, "")
        while waiting:
            self.monitor.spin_once()
            self.note_faults()
            for node in list(waiting):
                values = self.monitor.values.get(node, {})
                if values.get("elapsed", "") != elapsed[node]:
                    elapsed[node], news = values.get("elapsed", ""), time.monotonic()
                if values.get("signal") == "cancelled":
                    self.note(f"{node}: cancelled after {elapsed[node]} s")
                if values.get("signal") in ("over", "cancelled"):
                    waiting.remove(node)
            if time.monotonic() > news + STUCK:
                raise AbraceError(
                    f"{', '.join(waiting)}: the signal has made no progress for {STUCK:g} s, is the rig running?"
                )
        print(f"supervisor: the signal is over, {self.parameters.free_decay:g} s of free decay follow", flush=True)
        self.spin(self.parameters.free_decay)

    def spin(self, duration: float) -> None:
        """Let so many seconds pass, and note faults."""
        end = time.monotonic() + duration
        while time.monotonic() < end:
            self.monitor.spin_once()
            self.note_faults()

    def end(self) -> None:
        """Deactivate what was activated, the last one first; where that is not the rig, its force goes to zero."""
        for node in reversed(self.held):
            self.monitor.change_state(node, "deactivate", self.parameters.patience, self.note_faults)
        if not self.parameters.plant:
            self.spin(2 * RAMP_TIME)


def main() -> int:
    """Entry point."""
    return run(Supervisor)
