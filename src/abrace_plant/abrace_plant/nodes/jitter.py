# SPDX-License-Identifier: Apache-2.0
"""The node `jitter`: the timing of a running rig's samples, compared with a bare timer and a bare echo.

abrace run abrace_plant jitter --ros-args -p duration:=60 -p output:=results/jitter
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from std_msgs.msg import Int64

from abrace_core.drawing import save_figure
from abrace_core.errors import AbraceError
from abrace_core.files import write_text
from abrace_core.node import KEPT_STREAM_QOS, AbraceNode, Parameter, real_time, run
from abrace_core.wire import Responses
from abrace_interfaces.msg import Response
from abrace_plant.live.jitter import Arrivals, Jitter, as_json, bare_timer
from abrace_plant.live.jitter_figure import jitter_figure

PARAMETERS = [
    Parameter("duration", 30.0, "s, of each of the three measurements", minimum=0.1),
    Parameter("patience", 10.0, "s to wait for the rig's first sample", minimum=0.1),
    Parameter("output", "results/jitter", "folder for jitter.json and jitter.png", required=True),
    *real_time.PARAMETERS,
]
SETTLE = 0.5
"""Seconds that are not measured after nodes have found each other: earlier messages arrive all at once, and the first
message to a node may be delayed."""
ECHO = "import sys; from abrace_plant.nodes.jitter import answer; answer(*sys.argv[1:])"
"""The process of its own that answers."""


class JitterNode(AbraceNode):
    """Measures and ends."""

    def __init__(self) -> None:
        super().__init__("jitter", PARAMETERS)

    def work(self) -> None:
        """Measure rig, timer and echo one after the other, print, write, draw."""
        given = self.parameters
        real_time.apply(given, self.get_logger().warning)
        self.executor_of_work = EventsExecutor()
        self.executor_of_work.add_node(self)
        rig, period = self.rig()
        found = {"rig": rig, "timer": bare_timer(period, given.duration), "echo": self.echo(period)}
        settings = {parameter.name: getattr(given, parameter.name) for parameter in real_time.PARAMETERS}
        print(
            f"{'us':6s} {'events':>8s} {'missed':>7s} {'median':>9s} {'99 %':>9s} {'99.9 %':>9s} {'99.99 %':>9s} worst"
        )
        for name, one in found.items():
            events, missed, *quantiles = one.statistics().values()
            print(f"{name:6s} {events:8d} {missed:7d} " + " ".join(f"{value:9.1f}" for value in quantiles))
        output = Path(given.output)
        content = as_json(found, period, settings)
        write_text(output / "jitter.json", json.dumps(content, indent=1) + "\n")
        save_figure(jitter_figure(content), output / "jitter.png")
        print(f"wrote {output}")

    def spin_until(self, over: Callable[[], object], deadline: float) -> None:
        """Spin until it is over or the deadline [s, monotonic] has passed."""
        while not over() and time.monotonic() < deadline:
            self.executor_of_work.spin_once(timeout_sec=min(0.1, max(0.0, deadline - time.monotonic())))

    def rig(self) -> tuple[Jitter, float]:
        """Receive the samples of the rig that runs."""
        responses, received, stamps, sequences = Responses(), list[int](), list[int](), list[int]()

        def on_response(payload: bytes) -> None:
            now = time.monotonic_ns()
            try:
                stamp, head, _ = responses.unpack(payload)
            except AbraceError:
                return  # of whoever else publishes there
            received.append(now)
            stamps.append(stamp)
            sequences.append(head.sequence)

        subscription = self.create_subscription(Response, "response", on_response, KEPT_STREAM_QOS, raw=True)
        patience = self.parameters.patience
        self.spin_until(lambda: received, time.monotonic() + patience)
        if not received:
            raise AbraceError(f"no sample on {subscription.topic_name} within {patience:g} s, expected a running rig")
        self.spin_until(lambda: False, time.monotonic() + SETTLE)
        for values in (received, stamps, sequences):
            values.clear()
        self.spin_until(lambda: False, time.monotonic() + self.parameters.duration)
        self.destroy_subscription(subscription)
        return Arrivals(received, stamps, sequences).jitter()

    def echo(self, period: float) -> Jitter:
        """Round trips of a number to another process and back, one in each period."""
        name = self.get_fully_qualified_name()
        answers: list[int] = []
        publisher = self.create_publisher(Int64, f"{name}/asked", KEPT_STREAM_QOS)
        subscription = self.create_subscription(
            Int64, f"{name}/answered", lambda message: answers.append(message.data), KEPT_STREAM_QOS
        )
        with subprocess.Popen([sys.executable, "-c", ECHO, name]) as answering:
            try:
                deadline = time.monotonic() + self.parameters.patience
                self.spin_until(
                    lambda: publisher.get_subscription_count() and subscription.get_publisher_count(), deadline
                )
                while not answers and time.monotonic() < deadline:
                    # what is published before both have found each other is lost
                    publisher.publish(Int64(data=-1))
                    self.spin_until(lambda: answers, min(deadline, time.monotonic() + 0.1))
                times = []
                settling, count = (max(1, round(span / period)) for span in (SETTLE, self.parameters.duration))
                for number in range(settling + count):
                    begin = time.perf_counter()
                    publisher.publish(Int64(data=number))
                    self.spin_until(
                        lambda number=number: answers and answers[-1] == number,  # type: ignore[misc]
                        time.monotonic() + self.parameters.patience,
                    )
                    if not answers or answers[-1] != number:
                        raise AbraceError("the echo's process does not answer")
                    taken = time.perf_counter() - begin
                    times.append(taken)
                    time.sleep(max(0.0, period - taken))
            finally:
                answering.terminate()
        return Jitter(np.array(times[settling:]))


def answer(name: str) -> None:
    """Answer every number until this process is ended."""
    rclpy.init(args=[])
    node = rclpy.create_node(f"_{name.rpartition('/')[2]}_echo", start_parameter_services=False)
    publisher = node.create_publisher(Int64, f"{name}/answered", KEPT_STREAM_QOS)
    node.create_subscription(Int64, f"{name}/asked", publisher.publish, KEPT_STREAM_QOS)
    executor = EventsExecutor()
    executor.add_node(node)
    with contextlib.suppress(ExternalShutdownException):
        while rclpy.ok():
            executor.spin_once(timeout_sec=0.1)


def main() -> int:
    """Entry point."""
    return run(JitterNode)
