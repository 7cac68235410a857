# SPDX-License-Identifier: Apache-2.0
"""What viewers may do in the graph: read parameters; where it was allowed set them, call services, and stop.

The server calls these in threads of its own; what touches ROS is done by the node's executor.
"""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Any

from foxglove import Schema
from foxglove.websocket import Capability, MessageSchema, Parameter, Service, ServiceSchema
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.clock import Clock, ClockType
from rclpy.parameter import Parameter as RosParameter
from rclpy.parameter import parameter_value_to_python
from rclpy.serialization import serialize_message
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from abrace.nodes.graph_operator import STOP_TOPIC, StopButton
from abrace_core.errors import AbraceError
from abrace_core.node import TRANSIENT_LOCAL_QOS, RCLError, rcl_message

if TYPE_CHECKING:
    from collections.abc import Sequence

    from foxglove.websocket import ServiceRequest
    from rclpy.client import Client

    from abrace_bringup.viewing.server import ViewServer
    from abrace_core.node import AbraceNode

STOP = "/view/stop"
"""The service that presses the stop button."""
PRESSED = 2.5
"""Seconds for which a stop is pressed: within them every rig receives it, and the name of its sender."""
PATIENCE = 3.0
"""Seconds in which a node has to answer."""
POLL = 0.02
"""Seconds between looks whether a service is there."""
TRIGGER = "std_srvs/srv/Trigger"
_SCHEMA = ServiceSchema(
    name=TRIGGER,
    request=MessageSchema(encoding="cdr", schema=Schema(name=f"{TRIGGER}_Request", encoding="ros2msg", data=b"")),
    response=MessageSchema(
        encoding="cdr",
        schema=Schema(name=f"{TRIGGER}_Response", encoding="ros2msg", data=b"bool success\nstring message\n"),
    ),
)


class Operations:
    """Services and parameters of the graph for viewers.

    Parameters
    ----------
    node
        In the graph.
    may_change
        Whether viewers may do more than look.
    """

    def __init__(self, node: AbraceNode, may_change: bool) -> None:
        self._node = node
        self._may_change = may_change
        self._clients: dict[str, Client] = {}
        self._offered: set[str] = set()

    def capabilities(self, live: bool) -> list[Capability]:
        """What the server tells viewers that it can; of a bag, which is not `live`, the time."""
        if not live:
            return [Capability.Time]
        return [Capability.Parameters, *([Capability.Services] if self._may_change else [])]

    def offer(self, server: ViewServer) -> None:
        """Offer the services that the graph has now."""
        if not self._may_change:
            return
        found = {name for name, types in self._node.get_service_names_and_types() if TRIGGER in types} | {STOP}
        if gone := sorted(self._offered - found):
            server.remove_services(gone)
        if new := sorted(found - self._offered):
            server.add_services([Service(name=name, schema=_SCHEMA, handler=self._on_call) for name in new])
        self._offered = found

    def _on_call(self, request: ServiceRequest) -> bytes:
        """A viewer calls a service; what it raises goes to the viewer."""
        name = request.service_name
        answer = self._press_stop() if name == STOP else self._ask(Trigger, name, Trigger.Request())
        return bytes(serialize_message(answer))

    def _press_stop(self) -> Trigger.Response:
        """Press the stop button of the whole laboratory, and release it once every rig has received it."""

        def press() -> None:
            publisher = self._node.create_publisher(Bool, STOP_TOPIC, TRANSIENT_LOCAL_QOS)
            button = StopButton(self._node, publisher, lambda: True)
            button.publish()

            def let_go() -> None:
                button.rest()
                self._node.destroy_timer(timer)
                self._node.destroy_publisher(publisher)

            timer = self._node.create_timer(PRESSED, let_go, clock=Clock(clock_type=ClockType.STEADY_TIME))

        self._in_node(press)
        return Trigger.Response(success=True, message="pressed: /diagnostics tells which rigs stop")

    def get_parameters(self, names: Sequence[str]) -> list[Parameter]:
        """The parameters of these names, `NODE.PARAMETER`; all of the graph where none are named."""
        nodes = {name.partition(".")[0] for name in names} or set(self._nodes())
        found = [parameter for node in sorted(nodes) for parameter in self._parameters_of(node)]
        return [parameter for parameter in found if not names or parameter.name in names]

    def _parameters_of(self, node: str) -> list[Parameter]:
        try:
            names = self._ask(ListParameters, f"{node}/list_parameters", ListParameters.Request()).result.names
            values = self._ask(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=names)).values
        except AbraceError:
            return []  # it has none, or has just ended
        return [Parameter(f"{node}.{name}", value=_native(value)) for name, value in zip(names, values, strict=True)]

    def set_parameters(self, parameters: Sequence[Parameter]) -> list[Parameter]:
        """Set parameters, if viewers may; returns their values then, and logs why one is refused."""
        if not self._may_change:
            self._node.get_logger().warning("a client tried to set parameters, expected -p operate:=true")
            return self.get_parameters([parameter.name for parameter in parameters])
        for parameter in parameters:
            node, _, name = parameter.name.partition(".")
            try:
                before = self._ask(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=[name]))
                given = _of_type(parameter.get_value(), parameter_value_to_python(before.values[0]))
                request = SetParameters.Request(parameters=[RosParameter(name, value=given).to_parameter_msg()])
                (result,) = self._ask(SetParameters, f"{node}/set_parameters", request).results
                reason = "" if result.successful else result.reason
            except (AbraceError, ValueError, TypeError) as error:
                reason = str(error)
            if reason:
                self._node.get_logger().warning(f"{parameter.name}: refused: {reason}")
        return self.get_parameters([parameter.name for parameter in parameters])

    def _nodes(self) -> list[str]:
        """Full names of the nodes that have parameters."""
        services = dict(self._node.get_service_names_and_types())
        own = self._node.get_fully_qualified_name()
        ending = "/list_parameters"
        return [name.removesuffix(ending) for name in services if name.endswith(ending) and not name.startswith(own)]

    def _ask(self, service_type: type, name: str, request: Any) -> Any:
        """Call a service; returns its answer. Raises an AbraceError if there is none in time."""
        deadline = time.monotonic() + PATIENCE

        def begin() -> Any:
            client = self._clients.get(name)
            if client is None:
                client = self._clients[name] = self._node.create_client(service_type, name)
            return client.call_async(request) if client.service_is_ready() else None

        while (asked := self._in_node(begin)) is None:
            if time.monotonic() > deadline:
                raise AbraceError(f"service {name}: not offered")
            time.sleep(POLL)
        done = threading.Event()
        asked.add_done_callback(lambda _: done.set())
        if not done.wait(max(POLL, deadline - time.monotonic())):
            raise AbraceError(f"service {name}: no answer within {PATIENCE:g} s")
        return asked.result()

    def _in_node(self, act: Any) -> Any:
        """Have the node's executor call `act`; returns its result."""
        executor, done = self._node.executor, threading.Event()
        results: list[Any] = []
        refused: list[str] = []

        def acted() -> None:
            try:
                results.append(act())
            except RCLError as error:
                refused.append(rcl_message(error))  # with SROS2: the viewer's enclave does not allow it
            finally:
                done.set()

        if executor is None:
            raise AbraceError("the viewer is just starting or ending")
        executor.create_task(acted)
        if not done.wait(PATIENCE) or not results:
            raise AbraceError(refused[0] if refused else "the viewer does not answer")
        return results[0]


def _native(value: Any) -> Any:
    """The value of a parameter as Foxglove has it; without a value: an empty text."""
    found = parameter_value_to_python(value)
    if found is None:
        return ""
    return list(found) if not isinstance(found, (bool, int, float, str)) else found


def _of_type(given: Any, before: Any) -> Any:
    """A number of a viewer, which may write 10 for 10.0, with the type that the parameter has."""
    if isinstance(before, float) and isinstance(given, int) and not isinstance(given, bool):
        return float(given)
    if isinstance(before, int) and not isinstance(before, bool) and isinstance(given, float) and given.is_integer():
        return int(given)
    return given
