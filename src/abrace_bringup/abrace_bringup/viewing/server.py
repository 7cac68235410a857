# SPDX-License-Identifier: Apache-2.0
"""The server to which Foxglove and Lichtblick connect, by Foxglove's SDK: topics, with messages over a WebSocket."""

from __future__ import annotations

import json
import threading
from typing import TYPE_CHECKING, Any

import foxglove
from foxglove import Channel, Context, Schema
from foxglove.messages import FrameTransforms, SceneUpdate
from foxglove.websocket import Capability, ServerListener, StatusLevel

from abrace_bringup.viewing.guard import hidden_address
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from foxglove.websocket import ChannelView, Client, Parameter, Service

    from abrace_bags import MessageDefinition
    from abrace_bringup.viewing.guard import Guard

CHANNELS, FRAMES, SCENE, NODES = "/view/channels", "/view/frames", "/view/scene", "/view/nodes"
"""Topics made for viewers: named channels; positions of the floors; columns and braces; states of the nodes."""
NODES_SCHEMA = {
    "title": "abrace.Nodes",
    "type": "object",
    "properties": {
        "nodes": {
            "type": "array",
            "items": {
                "type": "object",
                "properties": {
                    "name": {"type": "string"},
                    "level": {"type": "string", "description": "ok, error or stale"},
                    "state": {"type": "string"},
                    "rate": {"type": "number", "description": "samples a second; null: the node takes no samples"},
                    "lost": {"type": "integer", "description": "samples or messages; null: not counted by the node"},
                },
            },
        }
    },
}
DESCRIPTION = "/robot_description"
"""Topic on which viewers expect a URDF."""


class ViewServer:
    """A server of topics.

    Parameters
    ----------
    host, port
        Where it listens; port 0: any that is free.
    name
        Name of the server that viewers show.
    guard
        Listens in its place, and passes connections on to it from the call of `open_to` on; None: all may connect.
    capabilities
        Of the server in addition to topics.
    get_parameters, set_parameters
        Called in a thread of the server: return the parameters of these names (no name: all), and those that were
        set of the ones that a viewer sets.

    Raises
    ------
    AbraceError
        If it can't listen there.
    """

    def __init__(
        self,
        host: str,
        port: int,
        name: str,
        guard: Guard | None = None,
        capabilities: Sequence[Capability] = (),
        get_parameters: Callable[[Sequence[str]], list[Parameter]] = lambda _: [],
        set_parameters: Callable[[Sequence[Parameter]], list[Parameter]] = lambda _: [],
    ) -> None:
        self._context = Context()
        self._guard = guard
        self._channels: dict[str, Channel] = {}
        self._latched: dict[str, tuple[bytes, int]] = {}
        self._joined: set[str] = set()
        self._lock = threading.Lock()
        self._schema: dict[str, Any] = {}
        if guard is not None:
            host, port = hidden_address(), 0
        self._host = host
        try:
            self._server = foxglove.start_server(
                name=name,
                host=host,
                port=port,
                capabilities=list(capabilities),
                server_listener=_Listener(self._on_subscribe, get_parameters, set_parameters),
                supported_encodings=["cdr", "json"],
                context=self._context,
            )
        except (RuntimeError, OSError, ValueError, OverflowError) as error:
            raise AbraceError(f"server: cannot listen on {host}, port {port}: {error}") from error
        self._open(FRAMES, "protobuf", FrameTransforms.get_schema())
        self._open(SCENE, "protobuf", SceneUpdate.get_schema())
        self._channels[NODES] = Channel(NODES, schema=NODES_SCHEMA, context=self._context)

    @property
    def port(self) -> int:
        """The port to which viewers connect."""
        return int(self._server.port) if self._guard is None else self._guard.port

    def open_to(self, origins: Collection[str]) -> None:
        """Accept connections, where there is a guard; pages of these `origins` need no token."""
        if self._guard is not None:
            self._guard.open((self._host, int(self._server.port)), origins)

    @property
    def topics(self) -> set[str]:
        """Names of the topics that it has."""
        return set(self._channels)

    def offer(self, topic: str, definition: MessageDefinition) -> None:
        """Offer a `topic` whose messages, of the type in `definition`, are passed on in CDR as received."""
        name = definition.type_name
        self._open(topic, "cdr", Schema(name=name, encoding="ros2msg", data=definition.text.encode()))

    def withdraw(self, topic: str) -> None:
        """Remove a `topic`."""
        self._channels.pop(topic).close()
        self._latched.pop(topic, None)

    def wanted(self, topic: str) -> bool:
        """Whether a viewer has subscribed to a `topic`."""
        channel = self._channels.get(topic)
        return channel is not None and channel.has_sinks()

    def send(self, topic: str, payload: bytes, time: int, latched: bool = False) -> None:
        """Send a message.

        Parameters
        ----------
        topic
            One that the server has.
        payload
            Bytes of the message.
        time
            Of the message [ns].
        latched
            Whether viewers that subscribe later receive it as well.
        """
        if latched:
            self._latched[topic] = payload, time
        self._channels[topic].log(payload, log_time=time)

    def open_channels(self, schema: Mapping[str, Any]) -> None:
        """Open the topic of named channels with this JSON `schema`; open it again if the schema has changed."""
        if schema != self._schema:
            if self._schema:
                self.withdraw(CHANNELS)
            self._schema = dict(schema)
            self._channels[CHANNELS] = Channel(CHANNELS, schema=self._schema, context=self._context)

    def send_json(self, topic: str, message: Mapping[str, Any], time: int, latched: bool = False) -> None:
        """Send a `message` as JSON.

        Parameters
        ----------
        topic, message, time, latched
            As for `send`.
        """
        self.send(topic, json.dumps(message).encode(), time, latched)

    def greet(self) -> None:
        """Send latched messages to viewers that have subscribed since the last call."""
        with self._lock:
            joined, self._joined = self._joined, set()
        for topic in joined & set(self._latched):
            payload, time = self._latched[topic]
            self._channels[topic].log(payload, log_time=time)

    def begin_anew(self) -> None:
        """Clear the viewers' data, because time steps back."""
        self._server.clear_session()

    def tell_time(self, time: int) -> None:
        """Send viewers the `time` [ns] of the bag that is played."""
        self._server.broadcast_time(time)

    def warn(self, text: str) -> None:
        """Show viewers a warning; an empty `text` removes it."""
        if text:
            self._server.publish_status(text, StatusLevel.Warning, id="abrace")
        else:
            self._server.remove_status(["abrace"])

    def add_services(self, services: list[Service]) -> None:
        """Offer `services` to viewers."""
        self._server.add_services(services)

    def remove_services(self, names: list[str]) -> None:
        """Remove the services of these `names`."""
        self._server.remove_services(names)

    def close(self) -> None:
        """Disconnect all viewers."""
        if self._guard is not None:
            self._guard.close()
        self._server.stop()

    def _open(self, topic: str, encoding: str, schema: Schema) -> None:
        self._channels[topic] = Channel(topic, message_encoding=encoding, schema=schema, context=self._context)

    def _on_subscribe(self, topic: str) -> None:
        with self._lock:
            self._joined.add(topic)


class _Listener(ServerListener):
    """Called in threads of the server's."""

    def __init__(
        self,
        subscribed: Callable[[str], None],
        get_parameters: Callable[[Sequence[str]], list[Parameter]],
        set_parameters: Callable[[Sequence[Parameter]], list[Parameter]],
    ) -> None:
        self._subscribed = subscribed
        self._get, self._set = get_parameters, set_parameters

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:  # noqa: ARG002
        self._subscribed(channel.topic)

    def on_get_parameters(
        self,
        client: Client,  # noqa: ARG002
        param_names: list[str],
        request_id: str | None = None,  # noqa: ARG002
    ) -> list[Parameter]:
        return self._get(param_names)

    def on_set_parameters(
        self,
        client: Client,  # noqa: ARG002
        parameters: list[Parameter],
        request_id: str | None = None,  # noqa: ARG002
    ) -> list[Parameter]:
        return self._set(parameters)
