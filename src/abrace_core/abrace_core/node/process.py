"""A node as a process: arguments, signals, the executor's turns, the exit code.

Exit codes: 0 done or stopped by a person, 1 something failed while running, 2 something that was given is wrong (one
line says what, where, and what was expected).
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any, Protocol

import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.logging import LoggingSeverity, get_logger_effective_level, set_logger_level
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args

from abrace_core.errors import AbraceError
from abrace_core.node.conventions import rcl_message
from abrace_core.node.lifecycle import AbraceLifecycleNode

LONGEST_WAIT = 0.1
"""Seconds that the executor may wait at a time. An untimed wait of the events executor never returns to Python."""

EVENTS_WHEN_LATE = 3
"""Callbacks that may come between two ticks of a node that is late: it has to hear of the answers to catch up."""


class Watched(Protocol):
    """What `run` needs of a node."""

    due: float | None
    exit_code: int | None
    ended: Future

    def tick(self) -> None:
        """Called when `due` [s, monotonic] has come."""

    def closing(self) -> None:
        """Called before the node is destroyed, whatever ended it."""


class _Stop(BaseException):
    """Someone asked the process to end."""


_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""SIGHUP: the terminal is gone, as when a connection to the rig's computer breaks."""


class _Signals:
    """A signal of `_ENDING` ends the node: between callbacks while it spins, at once before that.

    A SIGHUP that was ignored when the process started, as by `nohup`, stays ignored.
    """

    def __init__(self) -> None:
        self.spinning = False
        self.stopped = False
        self._terminals = [number for number in (1, 2) if os.isatty(number)]
        for number in _ENDING:
            if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._received)

    def _received(self, number: int, frame: FrameType | None) -> None:
        if number == signal.SIGHUP:
            for terminal in self._terminals:
                # what is still said at the end would fail there, and the end with it
                os.dup2(os.open(os.devnull, os.O_WRONLY), terminal)
        self.stopped = True
        if not self.spinning:
            raise _Stop


def _spin(node: Watched, signals: _Signals) -> int:
    """Turn the events executor until the node or a person ends it."""
    executor = EventsExecutor()
    executor.add_node(node)
    # what stands by now is never looked at by the garbage collector, whose pauses would be late samples
    gc.collect()
    gc.freeze()
    signals.spinning = True
    spin_once = executor.spin_once
    spin, ended = executor.spin_until_future_complete, node.ended
    monotonic = time.monotonic
    try:
        while not signals.stopped and node.exit_code is None:
            due = node.due
            if due is None:
                spin(ended, LONGEST_WAIT)
                continue
            wait = due - monotonic()
            if wait > 0:
                spin(ended, min(wait, LONGEST_WAIT))
            else:
                node.tick()
                if node.due is not None and node.due <= monotonic():
                    for _ in range(EVENTS_WHEN_LATE):
                        spin_once(timeout_sec=0.0)
    finally:
        signals.spinning = False
        executor.remove_node(node)
        executor.shutdown()
    return node.exit_code or 0


def _initialize(arguments: list[str]) -> None:
    """Start rclpy; wrong arguments are told by the AbraceError alone, not by rcl's log as well."""
    set_logger_level("rcl", LoggingSeverity.FATAL)
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        extra = remove_ros_args(arguments)[1:]
    except Exception as error:
        raise AbraceError(f"arguments: {rcl_message(error)}") from error
    if get_logger_effective_level("rcl") == LoggingSeverity.FATAL:
        set_logger_level("rcl", LoggingSeverity.UNSET)
    if extra:
        raise AbraceError(f"argument {extra[0]!r}: unknown, parameters are given as --ros-args -p name:=value")


def _close(node: Any, program: str) -> int:
    """Close what the node holds open and take it out of the graph; returns the exit code of that."""
    exit_code = 0
    if node is not None:
        try:
            node.closing()
            node.hand_over()
        except AbraceError as error:
            print(f"{program}: {error}", file=sys.stderr, flush=True)
            exit_code = 1
        node.destroy_node()
    rclpy.try_shutdown()
    return exit_code


def run(create: Callable[[], Any], arguments: Sequence[str] | None = None) -> int:
    """Run a node to its end and return the process's exit code.

    A node with a method `work` is an offline one: `work` is called once and the process ends.
    """
    signals = _Signals()
    node: Any = None
    arguments = list(sys.argv if arguments is None else arguments)
    program = arguments[0].rsplit("/", 1)[-1]
    try:
        _initialize(arguments)
        node = create()
        if hasattr(node, "work"):
            node.work()
            exit_code = node.exit_code or 0
        else:
            if isinstance(node, AbraceLifecycleNode):
                node.autostart()
            exit_code = _spin(node, signals)
    except AbraceError as error:
        print(f"{program}: {error}", file=sys.stderr, flush=True)
        exit_code = 2
    except _Stop:
        exit_code = 0
    finally:
        for number in _ENDING:
            signal.signal(number, signal.SIG_IGN)
        closing_code = _close(node, program)
    return exit_code or closing_code
