# SPDX-License-Identifier: Apache-2.0
"""A client of the Foxglove WebSocket protocol, as used by Foxglove and Lichtblick."""

from __future__ import annotations

import asyncio
import json
import struct
import threading
from collections import defaultdict
from typing import TYPE_CHECKING, Any

from tornado.websocket import websocket_connect

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable
    from types import TracebackType
    from typing import Self

    from tornado.websocket import WebSocketClientConnection

PROTOCOL = "foxglove.sdk.v1"
PATIENCE = 20.0
MESSAGE = 1


class FoxgloveClient:
    """A connection, served by a thread of its own; a context manager.

    Parameters
    ----------
    port
        Port of the server on this machine.
    """

    def __init__(self, port: int) -> None:
        self._address = f"ws://127.0.0.1:{port}/"
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._subscriptions: dict[int, str] = {}
        self.channels: dict[str, dict[str, Any]] = {}
        """The channels that the server has advertised, by topic."""
        self.messages: defaultdict[str, list[tuple[int, bytes]]] = defaultdict(list)
        """Received messages by topic: time [ns] and bytes."""
        self.said: defaultdict[str, list[dict[str, Any]]] = defaultdict(list)
        """Other messages of the server, by their `op`."""

    def __enter__(self) -> Self:
        self._thread.start()
        self._connection: WebSocketClientConnection = self._run(
            lambda: websocket_connect(self._address, subprotocols=[PROTOCOL], on_message_callback=self._take)
        )
        assert self._connection.selected_subprotocol == PROTOCOL
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._loop.call_soon_threadsafe(self._connection.close)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()

    def _run(self, begin: Callable[[], Awaitable[Any]]) -> Any:
        async def awaited() -> Any:
            return await begin()

        return asyncio.run_coroutine_threadsafe(awaited(), self._loop).result(PATIENCE)

    def _take(self, message: str | bytes | None) -> None:
        if isinstance(message, bytes):
            if message[0] == MESSAGE:
                number, time = struct.unpack_from("<IQ", message, 1)
                self.messages[self._subscriptions[number]].append((time, message[13:]))
        elif message is not None:
            content = json.loads(message)
            for channel in content.get("channels", []):
                self.channels[channel["topic"]] = channel
            self.said[content["op"]].append(content)

    def send(self, content: dict[str, Any]) -> None:
        """Send a message as JSON."""
        self._run(lambda: self._connection.write_message(json.dumps(content)))

    def subscribe(self, *topics: str) -> None:
        """Subscribe to topics that the server has."""
        for topic in topics:
            number = len(self._subscriptions) + 1
            self._subscriptions[number] = topic
            entry = {"id": number, "channelId": self.channels[topic]["id"]}
            self.send({"op": "subscribe", "subscriptions": [entry]})
