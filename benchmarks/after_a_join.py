# SPDX-License-Identifier: Apache-2.0
"""What joins cost an hour later: a stream of 1.8 million messages, in whose first half minute nodes join and leave.

Whether a join leaves something behind is chance: in one of two runs with ten joins none did, so there are thirty.

The messages are published faster than a rig's, up to as many as a rig takes in an hour at 500 Hz; then at 500 Hz:

publisher, subscriber  share of a processor
publish_us             time in `publish`: median, 99.9 % and worst

with the QoS of a rig's streams, and, as a peer, with the same QoS without a lifespan. For `make soak`.

python benchmarks/after_a_join.py MESSAGES
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import rclpy
from isolation import isolated
from logger_endurance import cpu_seconds
from rclpy.experimental import EventsExecutor
from std_msgs.msg import Int64

from abrace_core.node import KEPT_STREAM_QOS, published_stream_qos
from abrace_core.node.transport import profile

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rclpy.publisher import Publisher
    from rclpy.qos import QoSProfile

HOUR = 1_800_000
RATE, FAST = 500.0, 15_000.0
"""Messages a second: of a rig, and as fast as a subscriber acknowledges."""
MEASURED = 2500
SHOWN = 100_000
"""Messages after which the progress is shown."""
TOPIC = "after_a_join"
JOINS = 30
STAYS = 0.5
"""Seconds for which a node that joins stays."""


def subscriber(seconds: float) -> None:
    """Receive the stream for so many seconds."""
    rclpy.init()
    with profile(streams=True):
        node = rclpy.create_node(f"subscriber_{os.getpid()}")
    node.create_subscription(Int64, TOPIC, lambda _: None, KEPT_STREAM_QOS, raw=True)
    executor = EventsExecutor()
    executor.add_node(node)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.1)
    node.destroy_node()
    rclpy.try_shutdown()


def publish(publisher: Publisher, count: int, rate: float) -> np.ndarray:
    """Publish so many messages; returns the time (count,) [s] in `publish`."""
    begin, message, took = time.monotonic(), Int64(), np.empty(count)
    for number in range(count):
        before = time.perf_counter()
        publisher.publish(message)
        took[number] = time.perf_counter() - before
        if (wait := begin + number / rate - time.monotonic()) > 0:
            time.sleep(wait)
    return took


@contextlib.contextmanager
def process(seconds: float) -> Iterator[subprocess.Popen[bytes]]:
    """A subscriber in a process of its own."""
    with subprocess.Popen([sys.executable, __file__, "subscriber", str(seconds)]) as running:
        try:
            yield running
        finally:
            running.kill()


def stream(qos: QoSProfile, messages: int) -> dict[str, Any]:
    """A stream with this QoS, measured at its end."""
    context = rclpy.Context()
    context.init()
    with profile(streams=True):
        node = rclpy.create_node("publisher", context=context)
    publisher = node.create_publisher(Int64, TOPIC, qos)
    with process(3600.0) as stays:
        while publisher.get_subscription_count() < 1:
            time.sleep(0.01)
        for _ in range(JOINS):
            with process(STAYS) as joins:
                while joins.poll() is None:
                    publish(publisher, 100, RATE)
        for done in range(0, messages, SHOWN):
            print(f"{done} of {messages} messages", end="\r", file=sys.stderr, flush=True)
            publish(publisher, min(SHOWN, messages - done), FAST)
        begin, used, ours = time.monotonic(), cpu_seconds(stays.pid), time.process_time()
        took = 1e6 * publish(publisher, MEASURED, RATE)
        elapsed = time.monotonic() - begin
        found = {
            "publisher": (time.process_time() - ours) / elapsed,
            "subscriber": (cpu_seconds(stays.pid) - used) / elapsed,
            "publish_us": np.quantile(took, [0.5, 0.999, 1.0]).tolist(),
        }
    node.destroy_node()
    context.try_shutdown()
    return found


def after_a_join(messages: int = HOUR) -> dict[str, Any]:
    """Both streams, one after the other, with so many messages after the joins; call it on a domain of one's own."""
    found: dict[str, Any] = {"messages": messages}
    return found | {
        "with_a_lifespan": stream(published_stream_qos(), messages),
        "without_a_lifespan": stream(KEPT_STREAM_QOS, messages),
    }


def main() -> None:
    """Measure and print."""
    with isolated():
        print(json.dumps(after_a_join(int(sys.argv[1]) if sys.argv[1:] else HOUR), indent=1))


if __name__ == "__main__":
    if sys.argv[1:2] == ["subscriber"]:
        subscriber(float(sys.argv[2]))
    else:
        main()
