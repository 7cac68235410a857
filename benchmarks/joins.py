# SPDX-License-Identifier: Apache-2.0
"""A node that joins a running rig, receives both streams and leaves: `visit`."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.executors import SingleThreadedExecutor

from abrace_interfaces.msg import BraceCommand, Response
from abrace_node.transport import KEPT_STREAM_QOS

if TYPE_CHECKING:
    from collections.abc import Callable

    from running_graph import Graph

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


if __name__ == "__main__":
    join(sys.argv[2])
