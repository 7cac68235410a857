# SPDX-License-Identifier: Apache-2.0
"""The two threads of a node that streams: subscriptions and `tick` in the loop's, everything else in a second one.

A node of rclpy belongs to one executor, which spins what the node's attributes `subscriptions`, `timers`, `services`,
`clients` and `waitables` name. So each executor gets a view of the node that shows its share of them: for ROS, and for
who looks at the graph, it is one node.
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
"""Seconds that an executor may wait at a time. An untimed wait of the events executor never returns to Python."""

SWITCH_INTERVAL = 1e-4
"""Seconds after which the second thread, in the middle of Python code, gives way to the loop; Python has 0.005."""

_KINDS = frozenset({"subscriptions", "timers", "services", "clients", "waitables", "guards"})


class _View:
    """A node that has only what one executor is to spin."""

    executor: Executor | None = None

    def __init__(self, node: Node, kinds: Iterable[str]) -> None:
        self._node = node
        self._kinds = frozenset(kinds)

    def __getattr__(self, name: str) -> Any:
        return () if name in _KINDS - self._kinds else getattr(self._node, name)


class TwoThreads:
    """What spins a node: the executor of the loop, which the caller spins, and another one in a thread of its own.

    It stands for both where rclpy asks for the node's executor.

    Parameters
    ----------
    node
        The node.
    loop
        The executor that the thread of the loop spins.
    begin, failed
        Called in the second thread: at its begin, and once it has ended with an `error`.
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
        """Take the node over and start the second thread."""
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
        """End the second thread after all that it was given to do, and leave the node; raises what ended it early."""
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
        """For rclpy."""
        for executor, view in self._views.items():
            executor.add_node(view)  # type: ignore[arg-type]
        return True

    def remove_node(self, _: Node) -> None:
        """For rclpy."""
        for executor, view in self._views.items():
            executor.remove_node(view)  # type: ignore[arg-type]

    def wake(self) -> None:
        """For rclpy: something has been created or destroyed."""
        for executor in self._views:
            executor.wake()

    def create_task(self, act: Callable[..., Any], *arguments: Any) -> Any:
        """Have the second thread call `act`, in turn; from any thread."""
        return self._other.create_task(act, *arguments)

    def in_loop(self, act: Callable[[], None]) -> None:
        """Have the loop's thread call `act` between two callbacks, and wait until it has, without any lock.

        What an executor spins may be destroyed only where that executor does not look at it just then.
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
