# SPDX-License-Identifier: Apache-2.0
"""The two threads of a node that streams: subscriptions and `tick` in the loop's, everything else in a second one.

A node of rclpy belongs to one executor, which spins the node's `subscriptions`, `timers`, `services`, `clients` and
`waitables`. Here each of two executors gets a view of the node with a part of these. In the ROS graph it is one node.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from rclpy.experimental import EventsExecutor
from rclpy.task import Future

if TYPE_CHECKING:
    from rclpy.executors import Executor
    from rclpy.node import Node

LONGEST_WAIT = 0.1
"""Longest wait of an executor [s]. A wait of the events executor without a limit never returns to Python."""

SWITCH_INTERVAL = 1e-4
"""Seconds after which the second thread, running Python code, yields to the waiting loop; Python's default is 0.005."""

_KINDS = frozenset({"subscriptions", "timers", "services", "clients", "waitables", "guards"})


class _View:
    """A view of a node that shows only the entities that one executor spins."""

    executor: Executor | None = None

    def __init__(self, node: Node, kinds: Iterable[str]) -> None:
        self._node = node
        self._kinds = frozenset(kinds)

    def __getattr__(self, name: str) -> Any:
        return () if name in _KINDS - self._kinds else getattr(self._node, name)


class TwoThreads:
    """The two executors of a node: that of the loop, which the caller spins, and another one in a thread of its own.

    To rclpy it is the node's executor.

    Parameters
    ----------
    node
        The node.
    loop
        The executor that the thread of the loop spins.
    begin, failed
        Called in the second thread: when it begins, and if it has ended with an `error`.
    """

    def __init__(self, node: Node, loop: Executor, begin: Callable[[], None], failed: Callable[[], None]) -> None:
        self._node = node
        self._loop = loop
        self._other = EventsExecutor(context=node.context)
        self._views = {
            self._loop: _View(node, ["subscriptions"]),
            self._other: _View(node, _KINDS - {"subscriptions"}),
        }
        self._begin, self._failed = begin, failed
        self._closing = Future()
        self._thread = threading.Thread(target=self._spin, name="services")
        self.error: BaseException | None = None

    def start(self) -> None:
        """Become the node's executor and start the second thread."""
        self._node.executor = self  # type: ignore[assignment]
        self._thread.start()

    def _spin(self) -> None:
        try:
            self._begin()
            while not self._closing.done():
                self._other.spin_until_future_complete(self._closing, LONGEST_WAIT)
        except BaseException as error:  # raised by `stop`, in the main thread
            self.error = error
            self._failed()

    def stop(self) -> None:
        """End the second thread after its pending tasks, and release the node; raises the error that ended it early."""
        self.create_task(self._closing.set_result, None)
        while self._thread.is_alive():
            # it may wait for the loop, see `in_loop`
            self._loop.spin_once(timeout_sec=0.01)
        self._node.executor = None
        for executor in self._views:
            executor.shutdown()
        if self.error is not None:
            raise self.error

    def add_node(self, _: Node) -> bool:
        """Called by rclpy."""
        for executor, view in self._views.items():
            executor.add_node(view)  # type: ignore[arg-type]
        return True

    def remove_node(self, _: Node) -> None:
        """Called by rclpy."""
        for executor, view in self._views.items():
            executor.remove_node(view)  # type: ignore[arg-type]

    def wake(self) -> None:
        """Called by rclpy when an entity of the node has been created or destroyed."""
        for executor in self._views:
            executor.wake()

    def create_task(self, act: Callable[..., Any], *arguments: Any) -> Any:
        """Have the second thread call `act`, in turn; from any thread."""
        return self._other.create_task(act, *arguments)

    def in_loop(self, act: Callable[[], None]) -> None:
        """Have the loop's thread call `act` between two callbacks, and wait until it has; call it without any lock.

        An entity may be destroyed only while the executor that spins it is not using it.
        """
        if threading.current_thread() is not self._thread:
            act()
            return
        done = threading.Event()

        def acted() -> None:
            try:
                act()
            finally:
                done.set()

        self._loop.create_task(acted)
        done.wait()
