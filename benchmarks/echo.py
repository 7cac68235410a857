# SPDX-License-Identifier: Apache-2.0
"""A bare echo: one process publishes a Response, the other answers with a BraceCommand; nothing else.

The peer of the lockstep graph: what DDS, rclpy and two processes cost for the same messages on the same machine. With
a second process that answers, on `ground_motion`, and one that listens to all it is a bare graph of the same shape as
the lockstep graph.

python benchmarks/echo.py PRIORITY (answer TOPIC | listen | ask COUNT LISTENERS TOPIC...)
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
from array import array
from typing import TYPE_CHECKING

import rclpy
from geometry_msgs.msg import AccelStamped
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.utilities import remove_ros_args

from abrace_interfaces.msg import BraceCommand, Response
from abrace_node import real_time
from abrace_node.transport import STREAM_QOS

if TYPE_CHECKING:
    from rclpy.node import Node

ANSWERS = {"brace_command": BraceCommand(force=array("d", [0.0])), "ground_motion": AccelStamped()}


def spin(node: Node) -> None:
    """Spin until the asking process ends this one."""
    executor = EventsExecutor()
    executor.add_node(node)
    with contextlib.suppress(ExternalShutdownException):
        while rclpy.ok():
            executor.spin_once(timeout_sec=0.1)


def answer(topic: str) -> None:
    """Answer every Response on a topic of ANSWERS."""
    node = rclpy.create_node(f"echo_{topic}")
    message = ANSWERS[topic]
    publisher = node.create_publisher(type(message), topic, STREAM_QOS)

    def on_response(response: Response) -> None:
        message.header.stamp = response.header.stamp
        if isinstance(message, BraceCommand):
            message.sequence = response.sequence
        publisher.publish(message)

    node.create_subscription(Response, "response", on_response, STREAM_QOS)
    spin(node)


def listen() -> None:
    """Listen to all topics."""
    node = rclpy.create_node("echo_listen")
    types = {"response": Response, **{topic: type(message) for topic, message in ANSWERS.items()}}
    for topic, message_type in types.items():
        node.create_subscription(message_type, topic, lambda _: None, STREAM_QOS, raw=True)
    spin(node)


def ask(count: int, listeners: int, topics: list[str]) -> None:
    """Make `count` round trips, each of an answer on every topic, and print how many a second."""
    node = rclpy.create_node("echo_ask")
    publisher = node.create_publisher(Response, "response", STREAM_QOS)
    message = Response(displacement=array("d", [0.0] * 3), acceleration=array("d", [0.0] * 3))
    message.braces = [1]
    message.stroke = message.force = message.command = array("d", [0.0])
    answers, expected = 0, count * len(topics)

    def on_answer(_: object) -> None:
        nonlocal answers
        answers += 1
        if answers < expected and answers % len(topics) == 0:
            message.sequence = answers // len(topics)
            publisher.publish(message)

    subscriptions = [node.create_subscription(type(ANSWERS[topic]), topic, on_answer, STREAM_QOS) for topic in topics]
    executor = EventsExecutor()
    executor.add_node(node)
    while publisher.get_subscription_count() < len(topics) + listeners or not all(
        subscription.get_publisher_count() for subscription in subscriptions
    ):
        executor.spin_once(timeout_sec=0.1)
    settled = time.monotonic() + 1.0
    while time.monotonic() < settled:
        executor.spin_once(timeout_sec=0.1)
    begin = time.perf_counter()
    publisher.publish(message)
    while answers < expected:
        executor.spin_once(timeout_sec=0.1)
    print(count / (time.perf_counter() - begin))


def main(priority: int, words: list[str]) -> None:
    """Do what the `words` name, with a SCHED_FIFO `priority`, processors awake, where that is allowed; 0: none."""
    if priority:
        with contextlib.suppress(PermissionError):  # the nodes of the graph run without it then, too
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        real_time.keep_processors_awake(lambda _: None)
    rclpy.init()  # its threads inherit the priority
    match words:
        case "answer", topic:
            answer(topic)
        case ("listen",):
            listen()
        case "ask", count, listeners, *topics:
            ask(int(count), int(listeners), topics)


if __name__ == "__main__":
    arguments = remove_ros_args(sys.argv)[1:]
    main(int(arguments[0]), arguments[1:])
