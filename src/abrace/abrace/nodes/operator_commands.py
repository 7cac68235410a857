# SPDX-License-Identifier: Apache-2.0
"""The commands of an operator, for machines without `ros2`: what `abrace` does on the running graph."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import rclpy
from rcl_interfaces.msg import Parameter
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import get_parameter_value
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Bool
from yaml import YAMLError

from abrace.nodes.graph_operator import PATIENCE, STOP_TOPIC, TRIES, GraphOperator, Refused, StopButton
from abrace.report.node_table import node_table
from abrace_core import AbraceError
from abrace_core.safety.rig_safety import NOT_MEASURED
from abrace_core.safety.stop_senders import UNNAMED
from abrace_node.node import RCLError, rcl_message
from abrace_node.transport import TRANSIENT_LOCAL_QOS, destroy, profile

NAMING = 2.5
"""Seconds in which a rig may learn who pressed."""
REFRESH = 0.5
"""Seconds between tables on a terminal."""
AGAIN = 0.1
"""Seconds after which a clear is asked for again."""


@contextmanager
def graph_operator() -> Iterator[GraphOperator]:
    """An operator with a node of its own in the running graph."""
    context = rclpy.Context()
    try:
        with profile(streams=True):  # what is lost on the way is sent again at once
            context.init()
            node = rclpy.create_node("operator", context=context, start_parameter_services=False)
    except RCLError as error:
        raise AbraceError(f"ROS: {rcl_message(error)}") from error
    rclpy.signals.install_signal_handlers(SignalHandlerOptions.NO)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        yield GraphOperator(node, lambda: executor.spin_once(timeout_sec=0.05))
    finally:
        executor.shutdown()
        destroy(node)
        context.try_shutdown()


def status() -> int:
    """Print what every node reports, on a terminal until Ctrl-C; returns the exit code: 1 where one has a fault."""
    live = sys.stdout.isatty()
    with graph_operator() as operator:
        operator.hear_all()
        while True:
            text = node_table(operator.reports, time.monotonic())
            print(f"\x1b[2J\x1b[H{text}" if live else text, flush=True)
            if not live:
                return int(any(report.failed for report in operator.reports.values()))
            operator.wait(REFRESH)


def stop() -> int:
    """Press the stop button of the whole laboratory; returns the exit code: 1 if no rig has reported that it stops."""
    with graph_operator() as operator:
        publisher = operator.node.create_publisher(Bool, STOP_TOPIC, TRANSIENT_LOCAL_QOS)
        button = StopButton(operator.node, publisher, lambda: True)
        button.publish()

        def stopped() -> list[str]:
            return sorted(name for name, report in operator.reports.items() if report.stopped)

        listening = operator.wait(PATIENCE, lambda: stopped() and stopped() == operator.rigs())
        # a node that left before its name was received would stay a node of unknown name
        operator.wait(NAMING, lambda: not any(UNNAMED in report.stopped for report in operator.reports.values()))
        button.rest()
        for name in stopped():
            print(f"{name}: stop {operator.reports[name].stopped}")
        missing = sorted(set(operator.rigs()) - set(stopped()))
        for name in missing:
            print(f"{name}: has not reported that it stops", file=sys.stderr)
        if not stopped():
            print("no rig has reported that it stops; press the stop button of the hardware", file=sys.stderr)
        return int(not listening)


def act_on(node: str, command: str) -> int:
    """Activate, deactivate, clear or play a `node`; returns the exit code: 1 if that is refused."""
    with graph_operator() as operator:
        name = operator.full_name(node)
        acts: dict[str, Callable[[], str]] = {
            "activate": lambda: operator.arm(name),
            "deactivate": lambda: operator.disarm(name),
            "clear": lambda: _clear(operator, name),
            "play": lambda: operator.trigger(f"{name}/play"),
        }
        try:
            print(f"{name}: {acts[command]()}")
        except Refused as refusal:
            print(f"{name}: {refusal}", file=sys.stderr)
            return 1
    return 0


def _clear(operator: GraphOperator, name: str) -> str:
    """Clear a node's fault, of a rig that has just stopped once its rest has been measured; returns its answer."""
    end = time.monotonic() + PATIENCE
    while True:
        try:
            return operator.trigger(f"{name}/clear_fault", TRIES)
        except Refused as refusal:
            if not str(refusal).startswith(NOT_MEASURED) or time.monotonic() > end:
                raise
        operator.wait(AGAIN)


def set_parameter(node: str, parameter: str, value: str) -> int:
    """Set a `parameter` of a `node` to a `value`, written as in YAML; returns the exit code: 1 if that is refused."""
    wrong = AbraceError(f"value {value}: expected a number, a text, true or false, or a list of them")
    try:
        given = get_parameter_value(value)
    except YAMLError as error:
        raise wrong from error
    if not isinstance(given.string_value, str):  # rclpy takes a mapping for a text
        raise wrong
    with graph_operator() as operator:
        name = operator.full_name(node)
        request = SetParameters.Request(parameters=[Parameter(name=parameter, value=given)])
        (result,) = operator.call(SetParameters, f"{name}/set_parameters", request).results
    if result.successful:
        print(f"{name}: {parameter} is {value}")
        return 0
    print(f"{name}: {parameter}: refused: {result.reason}", file=sys.stderr)
    return 1
