"""The base of nodes that move something: life cycle nodes, which do so only while they are active."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence

from lifecycle_msgs.srv import ChangeState
from rclpy.context import Context
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from abrace_core.errors import AbraceError
from abrace_core.node.conventions import AbraceNode
from abrace_core.node.parameters import Parameter

AUTOSTART = Parameter("autostart", True, "configure and activate at once; false: wait for life cycle commands")


class AbraceLifecycleNode(LifecycleNodeMixin, AbraceNode):
    """A node that can move something: it does so only while active.

    Subclasses implement `configure`, `activate` and `deactivate`; an AbraceError in them refuses the transition. Their
    table of parameters is without `autostart`.
    """

    configured = False
    active = False
    _refusal: AbraceError | None = None
    _starting = False

    def __init__(self, name: str, table: Sequence[Parameter], context: Context | None = None) -> None:
        AbraceNode.__init__(self, name, [*table, AUTOSTART], context)
        LifecycleNodeMixin.__init__(self)
        self._permanent = {*self.publishers, *self.subscriptions, *self.services}
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state

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
        """Override to stop, smoothly."""

    def cleanup(self) -> None:
        """Override to undo what `configure` did, but for publishers, subscriptions and services."""

    def _transition(
        self, act: Callable[[], None], otherwise: TransitionCallbackReturn = TransitionCallbackReturn.FAILURE
    ) -> TransitionCallbackReturn:
        """Call one of the methods above; returns `otherwise` where it raises an AbraceError, and logs that."""
        try:
            act()
        except AbraceError as error:
            self._refusal = error
            if not self._starting:
                refused = "refused" if otherwise == TransitionCallbackReturn.FAILURE else "failed"
                self.get_logger().error(f"{act.__name__} {refused}: {error}")
            return otherwise
        except Exception as error:
            self.get_logger().fatal(f"{act.__name__} failed: {type(error).__name__}: {error}")
            return TransitionCallbackReturn.ERROR
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
        for publisher in set(self.publishers) - self._permanent:
            self.destroy_publisher(publisher)
        for subscription in set(self.subscriptions) - self._permanent:
            self.destroy_subscription(subscription)
        for service in set(self.services) - self._permanent:
            self.destroy_service(service)
        self._endpoint_counts.clear()
        self._publishers_of_streams.clear()

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback."""
        result = self._transition(self.activate)
        self.active = result == TransitionCallbackReturn.SUCCESS
        if not self.active:
            self.due = None
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback; where it fails the node is reset by `on_error`, never left active."""
        self.active = False
        return self._transition(self.deactivate, TransitionCallbackReturn.ERROR)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback."""
        self.configured = False
        result = self._transition(self.cleanup, TransitionCallbackReturn.ERROR)
        self._destroy_endpoints()
        return result

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback: an active node stops as when it is deactivated; it ends up finalized in any case."""
        stopped = not self.active or self.on_deactivate(state) == TransitionCallbackReturn.SUCCESS
        if not stopped:
            self.on_error(state)
        return TransitionCallbackReturn.SUCCESS if stopped else TransitionCallbackReturn.FAILURE

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback: after a transition that failed halfway, the node is at rest and unconfigured."""
        self.active = self.configured = False
        self.due = None
        with contextlib.suppress(Exception):  # logged by the transition; `configure` may not have come far
            self.cleanup()
        self._destroy_endpoints()
        return TransitionCallbackReturn.SUCCESS

    def autostart(self) -> None:
        """Configure and activate, if the parameter `autostart` is true."""
        if not self.parameters.autostart:
            return
        self._starting = True
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != TransitionCallbackReturn.SUCCESS:
                raise self._refusal or AbraceError("could not start; see the log above")
        self._starting = False
