"""A bare echo: one process publishes a Response, the other answers with a BraceCommand; nothing else.

The peer of the lockstep graph: what DDS, rclpy and two processes cost for the same messages on the same machine.

python benchmarks/echo.py answer | ask COUNT
"""

from __future__ import annotations

import contextlib
import sys
import time
from array import array

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor

from abrace_core.node import STREAM_QOS
from abrace_interfaces.msg import BraceCommand, Response


def answer() -> None:
    """Answer every Response until the asking process ends this one."""
    node = rclpy.create_node("echo_answer")
    publisher = node.create_publisher(BraceCommand, "brace_command", STREAM_QOS)
    command = BraceCommand(force=array("d", [0.0]))

    def on_response(response: Response) -> None:
        command.header.stamp = response.header.stamp
        command.sequence = response.sequence
        publisher.publish(command)

    node.create_subscription(Response, "response", on_response, STREAM_QOS)
    executor = EventsExecutor()
    executor.add_node(node)
    with contextlib.suppress(ExternalShutdownException):
        while rclpy.ok():
            executor.spin_once(timeout_sec=0.1)


def ask(count: int) -> None:
    """Make `count` round trips and print how many a second."""
    node = rclpy.create_node("echo_ask")
    publisher = node.create_publisher(Response, "response", STREAM_QOS)
    message = Response(displacement=array("d", [0.0] * 3), acceleration=array("d", [0.0] * 3))
    message.braces = [1]
    message.stroke = message.force = message.command = array("d", [0.0])
    answered = 0

    def on_command(_: BraceCommand) -> None:
        nonlocal answered
        answered += 1
        if answered < count:
            message.sequence = answered
            publisher.publish(message)

    subscription = node.create_subscription(BraceCommand, "brace_command", on_command, STREAM_QOS)
    executor = EventsExecutor()
    executor.add_node(node)
    while not (publisher.get_subscription_count() and subscription.get_publisher_count()):
        executor.spin_once(timeout_sec=0.1)
    settled = time.monotonic() + 1.0
    while time.monotonic() < settled:
        executor.spin_once(timeout_sec=0.1)
    begin = time.perf_counter()
    publisher.publish(message)
    while answered < count:
        executor.spin_once(timeout_sec=0.1)
    print(count / (time.perf_counter() - begin))


if __name__ == "__main__":
    rclpy.init()
    if sys.argv[1] == "answer":
        answer()
    else:
        ask(int(sys.argv[2]))
