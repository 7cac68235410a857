# SPDX-License-Identifier: Apache-2.0
"""The executors of a node: no exception leaves them; a node that streams has two, each with a thread of its own.

A node of rclpy belongs to one executor, which spins the node's `subscriptions`, `timers`, `services`, `clients` and
`waitables`. An executor here gets a view of the node in which their callbacks are guarded: an exception is passed to
the node's `fail`. Left to itself, the events executor of rclpy 7.1 crashes where a task raises (ros2/rclpy#1641).

Of a node that streams, subscriptions and `tick` belong to the loop's thread, everything else to a second one: each of
two executors gets a part of the node. In the ROS graph it is one node.
"""

from __future__ import annotations

import faulthandler
import threading
from collections.abc import Callable, Iterable
from typing import Any

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.task import Future

LONGEST_WAIT = 0.1
"""Longest wait of an executor [s]. A wait of the events executor without a limit never returns to Python."""

SWITCH_INTERVAL = 1e-4
"""Seconds after which the second thread, running Python code, yields to the waiting loop; Python's default is 0.005."""

_KINDS = frozenset({"subscriptions", "timers", "services", "clients", "waitables", "guards"})


class _View:
    """A view of a node that shows only the entities that one executor spins, with guarded callbacks."""

    executor: Any = None

    def __init__(self, node: Any, kinds: Iterable[str]) -> None:
        self._node = node
        self._kinds = frozenset(kinds)

    def __getattr__(self, name: str) -> Any:
        if name not in _KINDS:
            return getattr(self._node, name)
        entities = list(getattr(self._node, name)) if name in self._kinds else []
        for entity in entities:
            for attribute in ("callback", "execute"):
                act = getattr(entity, attribute, None)
                if act is not None and not hasattr(act, "catches"):
                    # a service answers in any case
                    otherwise = entity.srv_type.Response() if name == "services" else None
                    setattr(entity, attribute, self._node.catching(act, otherwise))
        return entities


class GuardedExecutor(rclpy_implementation.EventsExecutor):  # type: ignore[misc]
    """The events executor of a node, or of a part of it, which passes every exception to the node's `fail`.

    Parameters
    ----------
    node
        The AbraceNode.
    kinds
        Which of its entities it spins.
    """

    def __init__(self, node: Any, kinds: Iterable[str] = _KINDS) -> None:
        super().__init__(node.context)
        faulthandler.enable()
        node.context.on_shutdown(self.wake)
        self._node, self._view = node, _View(node, kinds)

    def add_node(self, _: Any) -> bool:
        """Called by rclpy."""
        return bool(super().add_node(self._view))

    def remove_node(self, _: Any) -> None:
        """Called by rclpy."""
        super().remove_node(self._view)

    def create_task(self, act: Callable[..., Any], *arguments: Any) -> Any:
        """Have the executor call `act`, in turn; from any thread."""
        return super().create_task(self._node.catching(act), *arguments)

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Spin until a callback has been called, or for `timeout_sec`."""
        try:
            super().spin_once(timeout_sec)
        except Exception as error:  # of rclpy's own
            self._node.fail(error)

    def spin_until_future_complete(self, future: Future, timeout_sec: float | None = None) -> None:
        """Spin until the `future` is done, or for `timeout_sec`."""
        try:
            super().spin_until_future_complete(future, timeout_sec)
        except Exception as error:  # of rclpy's own
            self._node.fail(error)


class TwoThreads:
    """The two executors of a node: that of the `loop`, which the caller spins, and another one in a thread of its own.

    To rclpy it is the node's executor.

    Parameters
    ----------
    node
        The AbraceNode.
    begin
        Called in the second thread when it begins.
    """

    def __init__(self, node: Any, begin: Callable[[], None]) -> None:
        self._node = node
        self.loop = GuardedExecutor(node, ["subscriptions"])
        self._other = GuardedExecutor(node, _KINDS - {"subscriptions"})
        self._executors = self.loop, self._other
        self._begin = begin
        self._closing = Future()
        self._thread = threading.Thread(target=node.catching(self._spin), name="services")

    def start(self) -> None:
        """Become the node's executor and start the second thread."""
        self._node.executor = self
        self._thread.start()

    def _spin(self) -> None:
        self._begin()
        while not self._closing.done():
            self._other.spin_until_future_complete(self._closing, LONGEST_WAIT)

    def stop(self) -> None:
        """End the second thread after its pending tasks, and release the node."""
        self.create_task(self._closing.set_result, None)
        while self._thread.is_alive():
            # it may wait for the loop, see `in_loop`
            self.loop.spin_once(timeout_sec=0.01)
        self._node.executor = None
        for executor in self._executors:
            executor.shutdown()

    def add_node(self, node: Any) -> bool:
        """Called by rclpy."""
        for executor in self._executors:
            executor.add_node(node)
        return True

    def remove_node(self, node: Any) -> None:
        """Called by rclpy."""
        for executor in self._executors:
            executor.remove_node(node)

    def wake(self) -> None:
        """Called by rclpy when an entity of the node has been created or destroyed."""
        for executor in self._executors:
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

        self.loop.create_task(acted)
        done.wait()
