# SPDX-License-Identifier: Apache-2.0
"""How late events are: a bare timer and a bare echo beside the bridge, and quantiles of what was measured."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from std_msgs.msg import Int64

from abrace_node.transport import KEPT_STREAM_QOS

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

QUANTILES = {"median_us": 50.0, "p99_us": 99.0, "p999_us": 99.9, "p9999_us": 99.99, "worst_us": 100.0}
PATIENCE = 10.0
"""Seconds within which the echo has to answer."""
SETTLE = 0.5
"""Seconds that are not measured after nodes have discovered each other: the first message to a node may be delayed."""


@dataclass(frozen=True)
class Delays:
    """Deviations of events from when they were due, (events,) [s], and how many events did not come at all."""

    times: NDArray[np.float64]
    missed: int = 0

    def statistics(self) -> dict[str, float]:
        """Number of events, of missed ones, and quantiles [us]; a quantile that few events tell is their worst."""
        values = np.percentile(1e6 * self.times, list(QUANTILES.values()), method="higher").tolist()
        return {"events": len(self.times), "missed": self.missed, **dict(zip(QUANTILES, values, strict=True))}


def bare_timer(period: float, duration: float) -> Delays:
    """How late a thread wakes that only sleeps until each multiple of `period` [s], for `duration` [s]."""
    due = time.monotonic() + period
    late = np.empty(max(1, round(duration / period)))
    for k in range(len(late)):
        time.sleep(max(0.0, due - time.monotonic()))
        now = time.monotonic()
        late[k] = now - due
        due = max(due + period, now)
    return Delays(late)


class Listener(Node):
    """A bare node with an executor of its own."""

    def __init__(self, name: str) -> None:
        super().__init__(name, start_parameter_services=False)
        self.own_executor = EventsExecutor()
        self.own_executor.add_node(self)

    def spin_until(self, over: Callable[[], object], deadline: float) -> None:
        """Spin until it is over or the deadline [s, monotonic] has passed."""
        while not over() and time.monotonic() < deadline:
            self.own_executor.spin_once(timeout_sec=min(0.1, max(0.0, deadline - time.monotonic())))

    def echo(self, period: float, duration: float) -> Delays:
        """Round trips of a number to another process and back, one in each `period` [s], for `duration` [s]."""
        name = self.get_fully_qualified_name()
        answers: list[int] = []
        publisher = self.create_publisher(Int64, f"{name}/asked", KEPT_STREAM_QOS)
        subscription = self.create_subscription(
            Int64, f"{name}/answered", lambda message: answers.append(message.data), KEPT_STREAM_QOS
        )
        with subprocess.Popen([sys.executable, __file__, name]) as answering:
            try:
                deadline = time.monotonic() + PATIENCE
                self.spin_until(
                    lambda: publisher.get_subscription_count() and subscription.get_publisher_count(), deadline
                )
                while not answers and time.monotonic() < deadline:
                    # what is published before both have discovered each other is lost
                    publisher.publish(Int64(data=-1))
                    self.spin_until(lambda: answers, min(deadline, time.monotonic() + 0.1))
                times = []
                settling, count = (max(1, round(span / period)) for span in (SETTLE, duration))
                for number in range(settling + count):
                    begin = time.perf_counter()
                    publisher.publish(Int64(data=number))
                    self.spin_until(
                        lambda number=number: answers and answers[-1] == number,  # type: ignore[misc]
                        time.monotonic() + PATIENCE,
                    )
                    if not answers or answers[-1] != number:
                        raise RuntimeError("the echo's process does not answer")
                    taken = time.perf_counter() - begin
                    times.append(taken)
                    time.sleep(max(0.0, period - taken))
            finally:
                answering.terminate()
        return Delays(np.array(times[settling:]))


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


if __name__ == "__main__":
    answer(sys.argv[1])
