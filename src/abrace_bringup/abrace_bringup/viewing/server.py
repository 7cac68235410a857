# SPDX-License-Identifier: Apache-2.0
"""The server to which Foxglove and Lichtblick connect, by Foxglove's SDK: topics, with messages over a WebSocket."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import foxglove
from foxglove import Channel, Context, Schema
from foxglove.websocket import ServerListener

from abrace_core import AbraceError

if TYPE_CHECKING:
    from foxglove.websocket import ChannelView, Client

    from abrace_bags import MessageDefinition


class ViewServer(ServerListener):
    """A server of topics.

    Parameters
    ----------
    host, port
        Where it listens; port 0: any that is free.
    name
        Name of the server that viewers show.

    Raises
    ------
    AbraceError
        If it can't listen there.
    """

    def __init__(self, host: str, port: int, name: str) -> None:
        super().__init__()
        self._context = Context()
        self._channels: dict[str, Channel] = {}
        self._latched: dict[str, tuple[bytes, int]] = {}
        self._joined: set[str] = set()
        self._lock = threading.Lock()
        try:
            self._server = foxglove.start_server(
                name=name,
                host=host,
                port=port,
                capabilities=[],
                server_listener=self,
                supported_encodings=["cdr"],
                context=self._context,
            )
        except (RuntimeError, OSError, ValueError, OverflowError) as error:
            raise AbraceError(f"server: cannot listen on {host}, port {port}: {error}") from error

    @property
    def port(self) -> int:
        """The port to which viewers connect."""
        return int(self._server.port)

    @property
    def topics(self) -> set[str]:
        """Names of the topics that it has."""
        return set(self._channels)

    def offer(self, topic: str, definition: MessageDefinition) -> None:
        """Offer a `topic` whose messages, of the type in `definition`, are passed on in CDR as received."""
        schema = Schema(name=definition.type_name, encoding="ros2msg", data=definition.text.encode())
        self._channels[topic] = Channel(topic, message_encoding="cdr", schema=schema, context=self._context)

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

    def greet(self) -> None:
        """Send latched messages to viewers that have subscribed since the last call."""
        with self._lock:
            joined, self._joined = self._joined, set()
        for topic in joined & set(self._latched):
            payload, time = self._latched[topic]
            self._channels[topic].log(payload, log_time=time)

    def close(self) -> None:
        """Disconnect all viewers."""
        self._server.stop()

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:  # noqa: ARG002
        """A viewer has subscribed; called in threads of the server's."""
        with self._lock:
            self._joined.add(channel.topic)
