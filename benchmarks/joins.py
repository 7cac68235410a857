# SPDX-License-Identifier: Apache-2.0
"""Nodes that join a running rig: a rig by the clock and its commander, while others come and go. For `make soak`.

faults           joins at which the rig, with a `command_timeout` of 0.02 s as by default, let its braces go
while_stalled    of them: the machine itself stalled for 1 ms or more during the join (machine_stalls.py)
longest_hold_ms  the longest time for which one command was in force; each command is another force
found_ms, found_ms_worst  from when a node has joined until it receives the rig's samples: median and worst
found_ms_last_ten         median of the last ten: joins leave nothing behind that delays the next ones

python benchmarks/joins.py COUNT
"""

from __future__ import annotations

import json
import os
import statistics
import sys
import time
from typing import TYPE_CHECKING, Any

import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from isolation import isolated
from machine_stalls import MachineStalls
from rclpy.executors import SingleThreadedExecutor
from running_graph import STREAM, Graph, graph_of_its_own

from abrace_core.node import KEPT_STREAM_QOS
from abrace_interfaces.msg import BraceCommand, Response

if TYPE_CHECKING:
    from collections.abc import Callable

JOINS = 100
SAMPLE_PERIOD_MS = 2.0
ENOUGH = 50
"""Messages of each stream that a node receives before it leaves."""


class Node:
    """A node with a participant of its own."""

    def __init__(self, name: str) -> None:
        self.context = rclpy.Context()
        self.context.init()
        self.node = rclpy.create_node(name, context=self.context, start_parameter_services=False)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)

    def listen(self, message_type: type, topic: str, callback: Callable[[Any], object], raw: bool = True) -> None:
        """Subscribe."""
        self.node.create_subscription(message_type, topic, callback, KEPT_STREAM_QOS, raw=raw)

    def until(self, holds: Callable[[], Any]) -> None:
        """Spin until `holds()`."""
        while not holds():
            self.executor.spin_once(timeout_sec=0.1)

    def close(self) -> None:
        """Leave the graph."""
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


def join(namespace: str) -> None:
    """Come, receive both streams, leave; print the time [ms] until the first sample."""
    begin = time.monotonic()
    node = Node("viewer")
    counts = dict.fromkeys((Response, BraceCommand), 0)

    def count(message_type: type) -> Callable[[Any], None]:
        def received(_: bytes) -> None:
            counts[message_type] += 1

        return received

    for message_type, topic in ((Response, "response"), (BraceCommand, "brace_command")):
        node.listen(message_type, f"{namespace}/{topic}", count(message_type))
    node.until(lambda: counts[Response])
    print(1e3 * (time.monotonic() - begin))
    node.until(lambda: min(counts.values()) >= ENOUGH)
    node.close()


def visit(graph: Graph) -> float:
    """Let a process come into a graph, receive both streams, and leave; returns the time [ms] to its first sample."""
    command = [sys.executable, __file__, "join", graph.namespace]
    viewer = graph.processes.start("viewer", command, graph.folder / "viewer.log")
    graph.until(lambda: viewer.returncode is not None, "the viewer to leave", 60.0)
    graph.processes.stop("viewer")
    assert viewer.returncode == 0, viewer.last_lines()
    return float(viewer.last_lines()[-1])


class DrivenRig:
    """A rig by the clock whose braces an `excitation` drives."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.held = self.longest = self.driven = 0
        self.found: list[float] = []
        self.command = 0.0
        graph.by_the_clock = True
        graph.node.create_subscription(Response, "response", self._on_response, STREAM)
        graph.start("plant")
        graph.start("excitation", rms=3000.0, duration=3600.0)
        self.recover()

    def _on_response(self, response: Response) -> None:
        (command,) = response.command
        self.held = self.held + 1 if command == self.command != 0.0 else 1
        self.driven = self.driven + 1 if command else 0
        self.command = command
        self.longest = max(self.longest, self.held)

    @property
    def fault(self) -> str:
        """That the rig reports; empty: none."""
        status = self.graph.statuses.get("plant")
        return status.message if status is not None and status.level == DiagnosticStatus.ERROR else ""

    def recover(self) -> None:
        """Have the braces driven, again if need be."""
        graph = self.graph
        while True:
            graph.until(lambda: self.driven > ENOUGH or self.fault, "the braces to be driven")
            if not self.fault:
                return
            assert graph.change_state("excitation", "deactivate")
            graph.clear_fault("excitation")
            graph.until(lambda: graph.clear_fault("plant").success, "the rig to be cleared")
            graph.until(lambda: not self.fault, "the rig to be well")
            assert graph.change_state("excitation", "activate")

    def joined(self) -> str:
        """Let a node come and leave; the rig's fault meanwhile."""
        self.found.append(visit(self.graph))
        # a fault is reported at once, but not before the force is let go
        driven = self.driven
        self.graph.until(lambda: self.driven > driven + ENOUGH or self.fault, "the braces to be driven")
        return self.fault


def joins(count: int = JOINS) -> dict[str, Any]:
    """So many joins, one after another; call it on a domain of one's own."""
    with graph_of_its_own("/joins") as graph, MachineStalls() as stalls:
        rig = DrivenRig(graph)
        rig.longest = faults = stalled = 0
        for number in range(1, count + 1):
            began = time.monotonic()
            if fault := rig.joined():
                faults += 1
                longest = max(stalls.since(began), default=0.0)
                stalled += longest > 0
                print(f"join {number}: {fault}; the machine stalled for {1e3 * longest:.1f} ms", file=sys.stderr)
                rig.recover()
            print(f"join {number} of {count}: {faults} faults", end="\r", file=sys.stderr, flush=True)
        return {
            "joins": count,
            "faults": faults,
            "while_stalled": stalled,
            "longest_hold_ms": SAMPLE_PERIOD_MS * rig.longest,
            "found_ms": statistics.median(rig.found),
            "found_ms_worst": max(rig.found),
            "found_ms_last_ten": statistics.median(rig.found[-10:]),
        }


def main() -> None:
    """Measure and print."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with isolated():
        print(json.dumps(joins(int(sys.argv[1]) if sys.argv[1:] else JOINS), indent=1))


if __name__ == "__main__":
    if sys.argv[1:2] == ["join"]:
        join(sys.argv[2])
    else:
        main()
