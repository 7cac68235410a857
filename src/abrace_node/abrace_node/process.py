# SPDX-License-Identifier: Apache-2.0
"""A node as a process: arguments, signals, spinning, the exit code.

Exit codes: 0 done or stopped by a person, 1 failed while running, 2 wrong parameters or files (one line says what is
wrong, where, and what was expected), 130 a test stopped before its end.
"""

from __future__ import annotations

import ctypes
import os
import select
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from types import FrameType

import rclpy
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import LoggingSeverity, get_logger, get_logger_effective_level, set_logger_level
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args

from abrace_core import AbraceError, RunFailed, __version__
from abrace_core.model.one_thread import one_thread
from abrace_node import real_time
from abrace_node.executable import check_environment
from abrace_node.node import AbraceNode, Described, RCLError, rcl_message, what_and_where
from abrace_node.threads import LONGEST_WAIT, GuardedExecutor
from abrace_node.transport import destroy, profile

EVENTS_WHEN_LATE = 3
"""Callbacks between two ticks of a node that is late: they bring the answers without which it cannot catch up."""

EXPECTED_ARGUMENTS = "expected --ros-args -p NAME:=VALUE, --params-file FILE or -r FROM:=TO"

END_WITH = "ABRACE_END_WITH"
"""Environment variable: number of a process; the node ends with it. For `ros2 launch`, which SIGTERM ends at once."""


class _Stop(BaseException):
    """A signal requests the end of the process."""


_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""SIGHUP: the terminal was closed, for example because the connection to the rig's computer was lost."""


class _Signals:
    """Handles `_SIGNALS`: they end a spinning node between two callbacks, and interrupt the `work` of an offline node.

    At other times a signal is only noted, so that it does not interrupt the start or the end of a node: Ctrl-C under
    `ros2 launch` comes twice, from the terminal and from launch. A SIGHUP that was ignored when the process started, as
    by `nohup`, stays ignored.
    """

    def __init__(self) -> None:
        self.stopped = False
        self.wake: Callable[[], None] | None = None
        """What has a node that spins look at `stopped` at once; it may wait for a lock, so a thread calls it."""
        self._interrupting: set[int] = set()
        self._terminals = [number for number in (1, 2) if os.isatty(number)]
        for number in _SIGNALS:
            if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, self._received)

    def _received(self, number: int, frame: FrameType | None) -> None:
        if number == signal.SIGHUP:
            _silence(self._terminals)
        first, self.stopped = not self.stopped, True
        if first and self.wake is not None:
            threading.Thread(target=self.wake, daemon=True).start()
        if number in self._interrupting:
            # a second signal of this kind would interrupt the clean-up after the first
            self._interrupting.discard(number)
            raise _Stop

    def interrupt(self, work: Callable[[], None]) -> None:
        """Call `work`; the first signal of each kind raises _Stop in it."""
        self._interrupting.update(_SIGNALS)
        try:
            if not self.stopped:
                work()
        finally:
            self._interrupting.clear()


def _ignore_signals() -> None:
    """Ignore signals from now on: while the interpreter ends, no handler runs, and a signal would kill the process.

    The handler is first replaced in C: Python prints a signal that arrives during `signal.signal` as an error. The same
    holds for a signal that another thread receives at this moment, hence the hook.
    """
    sys.unraisablehook = _print_unless_signal
    set_handler = ctypes.pythonapi.PyOS_setsig
    set_handler.argtypes, set_handler.restype = (ctypes.c_int, ctypes.c_void_p), ctypes.c_void_p
    for number in _SIGNALS:
        set_handler(number, int(signal.SIG_IGN))
        signal.signal(number, signal.SIG_IGN)


def _print_unless_signal(unraisable: sys.UnraisableHookArgs) -> None:
    """Print an error that cannot be caught, unless it only reports that a signal was ignored."""
    if unraisable.exc_type is not OSError or "ignored due to race condition" not in str(unraisable.exc_value):
        sys.__unraisablehook__(unraisable)


def _silence(descriptors: Sequence[int]) -> None:
    """Discard further output to these `descriptors`: printing to a closed terminal would raise an error at the end."""
    for descriptor in descriptors:
        os.dup2(os.open(os.devnull, os.O_WRONLY), descriptor)


def _end_with(process: str) -> None:
    """Stop this node when another `process`, given by its number, ends in any way; a thread waits for that.

    Raises
    ------
    AbraceError
        If there is no such process, or it has ended already.
    """
    ended = select.poll()
    try:
        ended.register(os.pidfd_open(int(process)), select.POLLIN)
    except ProcessLookupError as error:
        raise AbraceError(f"{END_WITH}={process}: that process, which started this node, has ended") from error
    except (OSError, ValueError, OverflowError) as error:
        raise AbraceError(f"{END_WITH}={process}, expected the number of a process") from error

    def wait() -> None:
        ended.poll()
        _silence((1, 2))
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=wait, name="end_with", daemon=True).start()


def _spin_until(node: AbraceNode, executor: GuardedExecutor, over: Callable[[], bool]) -> None:
    """Spin, and call the node's `tick` when it is due, until `over` returns true; `wake` makes it check at once."""
    spin_once, spin, run_tick = executor.spin_once, executor.spin_until_future_complete, node.catching(node.run_tick)
    monotonic = time.monotonic
    while True:
        if node.woken.done():
            node.woken = Future()
        if over():
            return
        due = node.due
        if due is None:
            spin(node.woken, LONGEST_WAIT)
            continue
        wait = due - monotonic()
        if wait > 0:
            spin(node.woken, min(wait, LONGEST_WAIT))
        else:
            run_tick()
            if node.due is not None and node.due <= monotonic():
                for _ in range(EVENTS_WHEN_LATE):
                    spin_once(timeout_sec=0.0)


def _spin(node: AbraceNode, signals: _Signals) -> int:
    """Spin until the node finishes, or has come to rest after a signal or an exception; returns the exit code."""
    signals.wake = node.wake
    if END_WITH in os.environ:
        node.await_observer(lambda: signals.stopped)
    with node.spinning() as executor:
        # now, because the pauses of a collection would delay samples
        real_time.collect_unfrozen_garbage()
        if not signals.stopped:
            node.autostart()
        _spin_until(node, executor, lambda: signals.stopped or bool(node.error) or node.exit_code is not None)
        if node.exit_code is None:
            latest = time.monotonic() + node.begin_shutdown()
            _spin_until(
                node, executor, lambda: node.exit_code is not None or node.at_rest or time.monotonic() >= latest
            )
            if node.exit_code is None and not node.at_rest:
                node.ended_before_rest()
    return node.exit_code or 0


def _initialize(arguments: list[str]) -> None:
    """Start rclpy; only the AbraceError reports wrong arguments, not rcl's log as well."""
    set_logger_level("rcl", LoggingSeverity.FATAL)
    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
        extra = remove_ros_args(arguments)[1:]
    except Exception as error:
        unknown = "unknown: " if isinstance(error, rclpy_implementation.UnknownROSArgsError) else ""
        raise AbraceError(f"ROS arguments: {unknown}{rcl_message(error)}; {EXPECTED_ARGUMENTS}") from error
    if get_logger_effective_level("rcl") == LoggingSeverity.FATAL:
        set_logger_level("rcl", LoggingSeverity.UNSET)
    if extra:
        raise AbraceError(f"argument {extra[0]!r}: unknown, {EXPECTED_ARGUMENTS}")


def _close(node: AbraceNode | None, program: str) -> int:
    """Close the node's files, destroy it and shut rclpy down; returns 1 if a file could not be closed."""
    exit_code = 0
    if node is not None:
        exit_code = int(node.error is not None)
        try:
            node.close()
            node.flush_publishers()
        except Exception as error:
            _report(program, error)
            exit_code = 1
        destroy(node)
    rclpy.try_shutdown()
    try:
        sys.stdout.flush()
    except OSError:  # reported where it was written to
        _silence((1,))
    return exit_code


def _report(program: str, error: Exception) -> None:
    """Print the `error` in one line, and log its traceback with `--log-level debug`."""
    print(f"{program}: {what_and_where(error)}", file=sys.stderr, flush=True)
    get_logger(program).debug("".join(traceback.format_exception(error)).rstrip())


def _describe(create: Callable[[], AbraceNode]) -> None:
    """Print the description of a node and its parameters, without creating it."""
    AbraceNode.describing = True
    try:
        create()
    except Described as described:
        text = str(described)
    finally:
        AbraceNode.describing = False
    try:
        print(text, flush=True)
    except BrokenPipeError:  # the reader, such as `head`, has closed the pipe
        _silence((1,))


def run(create: Callable[[], AbraceNode], arguments: Sequence[str] | None = None) -> int:
    """Run a node until it ends and return the process's exit code; `--help` and `--version` only print the answer.

    A node with a method `work` is an offline one: `work` is called once and the process ends.

    Parameters
    ----------
    create
        Function that creates the node.
    arguments
        Command line; that of the process by default.
    """
    arguments = list(sys.argv if arguments is None else arguments)
    program = arguments[0].rsplit("/", 1)[-1]
    if {"-h", "--help"} & set(arguments[1:]):
        try:
            _describe(create)
        except AbraceError as error:
            print(f"{program}: {error}", file=sys.stderr, flush=True)
            return 2
        return 0
    if "--version" in arguments[1:]:
        print(f"{program} of abrace {__version__}")
        return 0
    signals = _Signals()
    node: AbraceNode | None = None
    try:
        check_environment()
        if END_WITH in os.environ:
            _end_with(os.environ[END_WITH])
        with profile(getattr(create, "streams", False)):
            _initialize(arguments)
            try:
                node = create()
            except RCLError as error:
                raise AbraceError(f"the node cannot be created: {rcl_message(error)}") from error
        unforeseen = node.fail
        threading.excepthook = lambda given: unforeseen(given.exc_value or given.exc_type())
        if hasattr(node, "work"):
            with one_thread():
                signals.interrupt(node.work)
            exit_code = node.exit_code or 0
        else:
            exit_code = _spin(node, signals)
    except Exception as error:
        _report(program, error)
        exit_code = 2 if isinstance(error, AbraceError) and not isinstance(error, RunFailed) else 1
    except _Stop:
        exit_code = 0 if node is None or node.error is not None else node.stopped_exit_code
    finally:
        _ignore_signals()
        if signals.stopped and node is not None and node.error is None and hasattr(node, "work"):
            print(f"{program}: stopped before it was done", file=sys.stderr, flush=True)
        closing_code = _close(node, program)
    return exit_code or closing_code
