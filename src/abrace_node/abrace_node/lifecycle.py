# SPDX-License-Identifier: Apache-2.0
"""The base class of nodes that move something: life cycle nodes, which do so only while they are active."""

from __future__ import annotations

import contextlib
import gc
import os
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from abrace_core import AbraceError
from abrace_core.safety.rig_safety import RAMP_TIME
from abrace_node import real_time
from abrace_node.node import AbraceNode
from abrace_node.parameters import Parameter
from abrace_node.threads import SWITCH_INTERVAL, GuardedExecutor, TwoThreads

AUTOSTART = Parameter("autostart", True, "configure and activate at once; false: wait for life cycle commands")


REST_MARGIN = 0.1
"""Seconds beyond `ramp_time` after which a node no longer waits until it is at rest."""

OBSERVER_PATIENCE, OBSERVER_PERIOD = 10.0, 0.01
"""For how long a node that `ros2 launch` has started waits for its subscription, and how often it looks for it [s].

The topic of transitions is volatile: what happens before the subscription is discovered is never received. In 11 of 20
launches of two rigs on two processors `ros2 launch` missed the activation of one.
"""


class AbraceLifecycleNode(LifecycleNodeMixin, AbraceNode):
    """A node that can move something: it does so only while active.

    Subclasses implement `configure`, `activate` and `deactivate`; an AbraceError in them refuses the transition. Their
    table of parameters does not contain `autostart` and the parameters of `real_time`. A subclass that drives something
    also overrides `come_to_rest` and `at_rest`.

    The node has two threads, so that nothing delays a sample. The main thread, the loop, runs `tick` and the callbacks
    of subscriptions, with the `lock`. The second thread runs everything else: services, parameters, timers,
    diagnostics, actions. It takes the lock, for no longer than an assignment, to change data that the loop uses; the
    methods named above are called with it. The loop passes work, such as log messages, to the second thread by `defer`.
    """

    streams = True
    configured = False
    active = False
    ramp_time = RAMP_TIME
    """Seconds within which `come_to_rest` has brought the node to rest."""
    _refusal: AbraceError | None = None
    _starting = False
    _threads: TwoThreads | None = None
    _awaiting_rest = False

    def __init__(self, name: str, table: Sequence[Parameter], context: Context | None = None) -> None:
        AbraceNode.__init__(self, name, [*table, *real_time.PARAMETERS, AUTOSTART], context)
        LifecycleNodeMixin.__init__(self)
        for state, act in self._callbacks.items():
            self._callbacks[state] = self.catching(act, TransitionCallbackReturn.FAILURE)
        self._rest = threading.Condition(self.lock)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(real_time.GARBAGE_PERIOD, real_time.collect_new_garbage, clock=steady)
        self.keep_endpoints()
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state

    def keep_endpoints(self) -> None:
        """Keep the publishers, subscriptions and services that exist now through every clean-up."""
        self._permanent = {*self.publishers, *self.subscriptions, *self.services}

    def destroy_node(self) -> None:
        """Destroy the node and its state machine; rclpy leaves that one, and with it the node in the graph."""
        super().destroy_node()
        self._state_machine.destroy_when_not_in_use()

    @property
    def life_cycle(self) -> str:  # type: ignore[override]
        """Its state, as ROS calls it."""
        return "active" if self.active else "inactive" if self.configured else "unconfigured"

    @contextlib.contextmanager
    def spinning(self) -> Iterator[GuardedExecutor]:
        """Gives the executor that the main thread is to spin; the second thread runs until the end."""
        processors = os.sched_getaffinity(0)
        real_time.apply(self.parameters, self.get_logger().warning)
        self._threads = TwoThreads(self, partial(real_time.beside_the_loop, processors))
        interval = sys.getswitchinterval()
        sys.setswitchinterval(SWITCH_INTERVAL)
        gc.disable()
        self._threads.start()
        try:
            yield self._threads.loop
        finally:
            self._threads.stop()
            self._threads = None
            gc.enable()
            sys.setswitchinterval(interval)

    def defer(self, act: Callable[[], object]) -> None:
        """Have the second thread call `act`, in turn."""
        if self._threads is None:
            act()
        else:
            self._threads.create_task(act)

    def create_subscription(
        self, msg_type: type, topic: str, callback: Callable[[Any], None], qos_profile: QoSProfile | int, **options: Any
    ) -> Subscription:
        """Create a subscription whose `callback` is called with each message in the loop's thread, with the lock."""
        return super().create_subscription(msg_type, topic, self._in_loop(callback), qos_profile, **options)

    def run_tick(self) -> None:
        """Call `tick` with the lock, if it is still due."""
        super().run_tick()
        self.notify_rest()

    def _in_loop(self, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        lock = self.lock

        def call(message: Any) -> None:
            with lock:
                callback(message)
            if self._awaiting_rest:
                self.notify_rest()

        return call

    def notify_rest(self) -> None:
        """Wake the threads that wait for the node to be at rest, if it is; from any thread."""
        with self.lock:
            if self._awaiting_rest and self.at_rest:
                self._awaiting_rest = False
                self._rest.notify_all()
                self.wake()

    def come_to_rest(self) -> None:
        """Override to begin to come to rest, within `ramp_time`; called with the lock while the node is active.

        The node stays active until `at_rest`, and at most REST_MARGIN beyond `ramp_time`; only then `deactivate` is
        called, or the process ended.
        """

    def stay_active(self) -> None:
        """Override to take back `come_to_rest`: the node has not come to rest in time; called with the lock."""

    @property
    def at_rest(self) -> bool:
        """Override: whether what the node drives is at rest."""
        return True

    def until_at_rest(self) -> bool:
        """Wait, without the lock, until the loop has brought the node to rest; returns False if that took too long."""
        with self._rest:
            self._awaiting_rest = not self.at_rest
            return self._rest.wait_for(lambda: self.at_rest, self.ramp_time + REST_MARGIN)

    def begin_shutdown(self) -> float:
        """Begin to come to rest, after a signal; returns the seconds that this may take before the process ends."""
        with self.lock:
            if not self.active or self.at_rest:
                return 0.0
            self.catching(self.come_to_rest)()
            self._awaiting_rest = not self.at_rest
        return self.ramp_time + REST_MARGIN

    def _on_change_state(self, request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
        """Refuse a transition that the present state does not have; in rclpy 7.1 it ends the process."""
        machine = self._state_machine
        names = {number: label for number, label, *_ in machine.transition_graph}
        available = {number: label for number, label, *_ in machine.available_transitions}
        asked = request.transition.label or names.get(request.transition.id, str(request.transition.id))
        if request.transition.label in available.values() or (
            not request.transition.label and request.transition.id in available
        ):
            response = self._change_state(request, response)
        else:
            response.success = False
            expected = " or ".join(available.values()) or "none"
            self.get_logger().error(f"{asked} refused: the node is {machine.current_state[1]}, expected {expected}")
        self.publish_diagnostics()
        return response

    def configure(self) -> None:
        """Override to load files and create publishers, subscriptions and services."""

    def activate(self) -> None:
        """Override to begin."""

    def deactivate(self) -> None:
        """Override to stop; what the node drives is at rest."""

    def cleanup(self) -> None:
        """Override to undo what `configure` did, but for publishers, subscriptions and services."""

    def _transition(
        self, act: Callable[[], None], otherwise: TransitionCallbackReturn = TransitionCallbackReturn.FAILURE
    ) -> TransitionCallbackReturn:
        """Call one of the methods above, with the lock; an AbraceError in it is logged, and `otherwise` returned."""
        try:
            with self.lock:
                act()
        except AbraceError as error:
            self._refusal = error
            if not self._starting:
                refused = "refused" if otherwise == TransitionCallbackReturn.FAILURE else "failed"
                self.get_logger().error(f"{act.__name__} {refused}: {error}")
            return otherwise
        return TransitionCallbackReturn.SUCCESS

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback."""
        result = self._transition(self.configure)
        self.configured = result == TransitionCallbackReturn.SUCCESS
        if not self.configured:
            self._destroy_endpoints()
        return result

    def _destroy_endpoints(self) -> None:
        """Destroy the publishers, subscriptions and services that `configure` created."""

        def destroy() -> None:
            for publisher in set(self.publishers) - self._permanent:
                self.destroy_publisher(publisher)
            for subscription in set(self.subscriptions) - self._permanent:
                self.destroy_subscription(subscription)
            for service in set(self.services) - self._permanent:
                self.destroy_service(service)

        self._endpoint_counts.clear()
        self._streams.clear()
        self._publishers_of_streams.clear()
        if self._threads is None:
            destroy()
        else:
            self._threads.in_loop(destroy)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback."""
        with self.lock:
            result = self._transition(self.activate)
            self.active = result == TransitionCallbackReturn.SUCCESS
            gc.freeze()  # objects made so far are left out of later collections, which would delay the loop
            if not self.active:
                self.due = None
        self.wake()
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback; a node that has not come to rest stays active; after an error `on_error` resets it."""
        resting = self._transition(self.come_to_rest, TransitionCallbackReturn.ERROR)
        if resting == TransitionCallbackReturn.SUCCESS and not self.until_at_rest():
            with self.lock:
                self.stay_active()
            self.get_logger().error(f"deactivate refused: not at rest after {self.ramp_time + REST_MARGIN:.1f} s")
            return TransitionCallbackReturn.FAILURE
        with self.lock:
            self.active = False
            result = self._transition(self.deactivate, TransitionCallbackReturn.ERROR)
        self.defer(self._collect_garbage)  # up to 0.1 s, for which the caller does not have to wait
        return result if resting == TransitionCallbackReturn.SUCCESS else resting

    def _collect_garbage(self) -> None:
        """Collect garbage unless the node has become active again."""
        if not self.active:
            real_time.collect_garbage()

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback."""
        with self.lock:
            self.configured = False
            result = self._transition(self.cleanup, TransitionCallbackReturn.ERROR)
        self._destroy_endpoints()
        real_time.collect_garbage()
        return result

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback: an active node is deactivated first; the node is finalized in any case."""
        stopped = not self.active or self.on_deactivate(state) == TransitionCallbackReturn.SUCCESS
        if not stopped:
            self.on_error(state)
        return TransitionCallbackReturn.SUCCESS if stopped else TransitionCallbackReturn.FAILURE

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback: after a transition that failed halfway, the node is at rest and unconfigured."""
        with self.lock:
            self.active = self.configured = False
            self.due = None
            with contextlib.suppress(Exception):  # logged by the transition; `configure` may have failed early
                self.cleanup()
        self._destroy_endpoints()
        return TransitionCallbackReturn.SUCCESS

    def await_observer(self, stopped: Callable[[], bool]) -> None:
        """Wait until `~/transition_event` has a subscriber, or `stopped`; at most OBSERVER_PATIENCE."""
        latest = time.monotonic() + OBSERVER_PATIENCE
        while not self.count_subscribers("~/transition_event"):
            if stopped() or time.monotonic() > latest:
                return
            time.sleep(OBSERVER_PERIOD)

    def autostart(self) -> None:
        """Configure and activate, if the parameter `autostart` is true."""
        if not self.parameters.autostart:
            return
        self._starting = True
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != TransitionCallbackReturn.SUCCESS:
                if self.error is not None:
                    return
                raise self._refusal or AbraceError("could not start; see the log above")
        self._starting = False
