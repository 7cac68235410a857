"""The base of nodes that move something: life cycle nodes, which do so only while they are active."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from abrace_core.errors import AbraceError
from abrace_core.node.conventions import AbraceNode, RCLError
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

    def __init__(self, name: str, table: Sequence[Parameter]) -> None:
        AbraceNode.__init__(self, name, [*table, AUTOSTART])
        LifecycleNodeMixin.__init__(self)
        self._permanent = {*self.publishers, *self.subscriptions, *self.services}
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state

    def _on_change_state(self, request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
        """Refuse a transition that the present state does not have; in rclpy 7.1 it ends the process."""
        try:
            return self._change_state(request, response)
        except RCLError:
            response.success = False
            return response

    def configure(self) -> None:
        """Override to load files and create publishers, subscriptions and services."""

    def activate(self) -> None:
        """Override to begin."""

    def deactivate(self) -> None:
        """Override to stop, smoothly."""

    def cleanup(self) -> None:
        """Override to undo what `configure` did, but for publishers, subscriptions and services."""

    def _transition(self, act: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            act()
        except AbraceError as error:
            self._refusal = error
            if not self.parameters.autostart:
                self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        except Exception as error:
            self.get_logger().fatal(f"{type(error).__name__}: {error}")
            raise
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
        return LifecycleNodeMixin.on_activate(self, state) if self.active else result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback."""
        self.active = False
        self._transition(self.deactivate)
        return LifecycleNodeMixin.on_deactivate(self, state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback."""
        self.configured = False
        self.cleanup()
        self._destroy_endpoints()
        return LifecycleNodeMixin.on_cleanup(self, state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback: an active node stops as when it is deactivated."""
        if self.active:
            self.on_deactivate(state)
        return LifecycleNodeMixin.on_shutdown(self, state)

    def autostart(self) -> None:
        """Configure and activate, if the parameter `autostart` is true."""
        if not self.parameters.autostart:
            return
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != TransitionCallbackReturn.SUCCESS:
                raise self._refusal or AbraceError("could not start; see the log above")
