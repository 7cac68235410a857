"""Nodes that join a running rig: a rig by the clock and its commander, while others come and go. For `make soak`.

faults           how often the rig did so without a command for `command_timeout`, 0.02 s by default, that it let go
longest_hold_ms  the longest time for which one command was in force; each command is another force

python benchmarks/joins.py COUNT
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from functools import partial
from typing import TYPE_CHECKING, Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from isolation import isolated
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import Trigger

from abrace.processes.group import find_executable
from abrace_core.node import DIAGNOSTICS, KEPT_STREAM_QOS
from abrace_core.wire import Responses
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


class Watch(Node):
    """Watches the rig, and clears its faults."""

    def __init__(self) -> None:
        super().__init__("watch")
        self._responses = Responses()
        self._command = 0.0
        self._held = 0
        self.longest = self.faults = self.driven = 0
        self.faulty = False
        self.clear = self.node.create_client(Trigger, "plant/clear_fault")
        self.listen(Response, "response", self._on_response, raw=False)
        self.listen(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, raw=False)

    def _on_response(self, response: Response) -> None:
        (command,) = response.command
        same = command == self._command and command != 0.0
        self._held = self._held + 1 if same else 1
        self._command = command
        self.driven += command != 0.0
        self.longest = max(self.longest, self._held)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "plant: state":
                fault = status.level == DiagnosticStatus.ERROR
                if fault and not self.faulty:
                    self.faults += 1
                    print(f"join: {status.message}", file=sys.stderr)
                self.faulty = fault

    def recover(self) -> None:
        """Have the rig driven again."""
        while self.faulty:
            answer = self.clear.call_async(Trigger.Request())
            self.until(answer.done)
            self.faulty = not answer.result().success
        driven = self.driven
        self.until(lambda: self.driven > driven + ENOUGH or self.faulty)


def join() -> None:
    """Come, receive both streams, leave."""
    node = Node("viewer")
    counts = dict.fromkeys((Response, BraceCommand), 0)

    def count(message_type: type) -> Callable[[Any], None]:
        def received(_: bytes) -> None:
            counts[message_type] += 1

        return received

    for message_type, topic in ((Response, "response"), (BraceCommand, "brace_command")):
        node.listen(message_type, topic, count(message_type))
    node.until(lambda: min(counts.values()) >= ENOUGH)
    node.close()


def _ended(process: subprocess.Popen[bytes]) -> bool:
    return process.poll() is not None


def joins(count: int = JOINS) -> dict[str, Any]:
    """So many joins, one after another; call it on a domain of one's own."""
    commands = [find_executable("abrace_plant", "plant"), find_executable("abrace_sysid", "excitation")]
    priority = ["--ros-args", "-p", "thread_priority:=50"]
    processes = [subprocess.Popen([str(command), *priority]) for command in commands]
    watch = Watch()
    try:
        watch.until(lambda: watch.driven > ENOUGH)
        while watch.faulty:
            watch.recover()
        watch.faults = watch.longest = 0
        for _ in range(count):
            joining = subprocess.Popen([sys.executable, __file__, "join"])
            watch.until(partial(_ended, joining))
            if joining.returncode:
                raise subprocess.CalledProcessError(joining.returncode, "join")
            watch.recover()
        return {"joins": count, "faults": watch.faults, "longest_hold_ms": SAMPLE_PERIOD_MS * watch.longest}
    finally:
        for process in processes:
            process.terminate()
            process.wait()
        watch.close()


def main() -> None:
    """Measure and print."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with isolated():
        print(json.dumps(joins(int(sys.argv[1]) if sys.argv[1:] else JOINS), indent=1))


if __name__ == "__main__":
    if sys.argv[1:2] == ["join"]:
        join()
    else:
        main()
