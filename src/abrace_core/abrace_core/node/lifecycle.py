"""A life cycle node with abrace's conventions: it moves something only while it is active."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from abrace_core.errors import AbraceError
from abrace_core.node.conventions import Conventions, RCLError
from abrace_core.node.parameters import Parameter, declare

AUTOSTART = Parameter("autostart", True, "configure and activate at once; false: wait for life cycle commands")


class AbraceLifecycleNode(Conventions, LifecycleNode):
    """A node that can move something: it does so only while active.

    Subclasses implement `configure`, `activate` and `deactivate`; an AbraceError in them refuses the transition.
    """

    def __init__(self, name: str, table: Sequence[Parameter]) -> None:
        LifecycleNode.__init__(self, name)
        self.parameters = declare(self, [*table, AUTOSTART])
        self.follow_parameters(self, table, self.parameters)
        self.refusal: AbraceError | None = None
        self.configured = False
        self.active = False
        self.start_diagnostics(self)
        self._standing = {*self.publishers, *self.subscriptions, *self.services}
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state

    def _on_change_state(self, request: ChangeState.Request, response: ChangeState.Response) -> ChangeState.Response:
        """Refuse a transition that the present state does not have; rclpy 7.1 would end the process."""
        try:
            return self._change_state(request, response)
        except RCLError:
            response.success = False
            return response

    def configure(self) -> None:
        """Load files, make publishers and subscriptions."""

    def activate(self) -> None:
        """Begin."""

    def deactivate(self) -> None:
        """Stop, smoothly."""

    def cleanup(self) -> None:
        """Undo what `configure` made beside publishers, subscriptions and services."""

    def _transition(self, step: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            step()
        except AbraceError as error:
            self.refusal = error
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
            self._forget()
        return result

    def _forget(self) -> None:
        """Destroy what `configure` made."""
        for publisher in set(self.publishers) - self._standing:
            self.destroy_publisher(publisher)
        for subscription in set(self.subscriptions) - self._standing:
            self.destroy_subscription(subscription)
        for service in set(self.services) - self._standing:
            self.destroy_service(service)
        self._endpoints.clear()
        self._published.clear()

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback."""
        result = self._transition(self.activate)
        self.active = result == TransitionCallbackReturn.SUCCESS
        return LifecycleNode.on_activate(self, state) if self.active else result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback."""
        self.active = False
        self._transition(self.deactivate)
        return LifecycleNode.on_deactivate(self, state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback."""
        self.configured = False
        self.cleanup()
        self._forget()
        return LifecycleNode.on_cleanup(self, state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Life cycle callback: an active node stops as when it is deactivated."""
        if self.active:
            self.on_deactivate(state)
        return LifecycleNode.on_shutdown(self, state)

    def autostart(self) -> None:
        """Configure and activate, where the parameter asks for it."""
        if not self.parameters.autostart:
            return
        for trigger in (self.trigger_configure, self.trigger_activate):
            if trigger() != TransitionCallbackReturn.SUCCESS:
                raise self.refusal or AbraceError("could not start; see the log above")
