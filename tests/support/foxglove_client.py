# SPDX-License-Identifier: Apache-2.0
"""A client of the Foxglove WebSocket protocol, as used by Foxglove and Lichtblick."""

from __future__ import annotations

import asyncio
import json
import struct
import threading
from collections import defaultdict
from typing import TYPE_CHECKING, Any

from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable
    from types import TracebackType
    from typing import Self

    from tornado.websocket import WebSocketClientConnection

PROTOCOL = "foxglove.sdk.v1"
PATIENCE = 20.0
MESSAGE, SERVICE_ANSWER, SERVICE_CALL = 1, 3, 2


class Refused(Exception):  # noqa: N818
    """The server has answered with this HTTP status instead of a WebSocket."""


class FoxgloveClient:
    """A connection, served by a thread of its own; a context manager.

    Parameters
    ----------
    port
        Port of the server on this machine.
    token
        In the address; empty: none.
    origin
        Header that a browser sends: of the page that connects; empty: none.

    Raises
    ------
    Refused
        When it is entered, if the server does not let it in.
    """

    def __init__(self, port: int, token: str = "", origin: str = "") -> None:
        address = f"ws://127.0.0.1:{port}/" + (f"?token={token}" if token else "")
        self._request = HTTPRequest(address, headers={"Origin": origin} if origin else None)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._subscriptions: dict[int, str] = {}
        self._calls = 0
        self.channels: dict[str, dict[str, Any]] = {}
        """The channels that the server has advertised, by topic."""
        self.services: dict[str, dict[str, Any]] = {}
        """Its services, by name."""
        self.messages: defaultdict[str, list[tuple[int, bytes]]] = defaultdict(list)
        """Received messages by topic: time [ns] and bytes."""
        self.said: defaultdict[str, list[dict[str, Any]]] = defaultdict(list)
        """Other messages of the server, by their `op`."""
        self.answers: dict[int, bytes] = {}
        """Answers of services, by the number of the call."""

    def __enter__(self) -> Self:
        self._thread.start()
        try:
            self._connection: WebSocketClientConnection = self._run(
                lambda: websocket_connect(self._request, subprotocols=[PROTOCOL], on_message_callback=self._take)
            )
        except HTTPClientError as error:
            self._end()
            raise Refused(error.code) from error
        assert self._connection.selected_subprotocol == PROTOCOL
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._loop.call_soon_threadsafe(self._connection.close)
        self._end()

    def _end(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()

    def _run(self, begin: Callable[[], Awaitable[Any]]) -> Any:
        async def awaited() -> Any:
            return await begin()

        return asyncio.run_coroutine_threadsafe(awaited(), self._loop).result(PATIENCE)

    def _take(self, message: str | bytes | None) -> None:
        if isinstance(message, bytes):
            self._take_bytes(message)
        elif message is not None:
            content = json.loads(message)
            for channel in content.get("channels", []):
                self.channels[channel["topic"]] = channel
            for service in content.get("services", []):
                self.services[service["name"]] = service
            self.said[content["op"]].append(content)

    def _take_bytes(self, message: bytes) -> None:
        if message[0] == MESSAGE:
            number, time = struct.unpack_from("<IQ", message, 1)
            self.messages[self._subscriptions[number]].append((time, message[13:]))
        elif message[0] == SERVICE_ANSWER:
            _, call, length = struct.unpack_from("<III", message, 1)
            self.answers[call] = message[13 + length :]

    def send(self, content: dict[str, Any] | bytes) -> None:
        """Send a message as JSON, or bytes."""
        binary = isinstance(content, bytes)
        data = content if binary else json.dumps(content)
        self._run(lambda: self._connection.write_message(data, binary=binary))

    def subscribe(self, *topics: str) -> None:
        """Subscribe to topics that the server has."""
        for topic in topics:
            number = len(self._subscriptions) + 1
            self._subscriptions[number] = topic
            entry = {"id": number, "channelId": self.channels[topic]["id"]}
            self.send({"op": "subscribe", "subscriptions": [entry]})

    def call(self, service: str, request: bytes) -> int:
        """Call a service with the bytes of a request; returns the number of the call."""
        self._calls += 1
        number = self._calls
        head = struct.pack("<BIII", SERVICE_CALL, self.services[service]["id"], number, 3)
        self.send(head + b"cdr" + request)
        return number

    def json(self, topic: str) -> list[dict[str, Any]]:
        """The messages of a topic whose messages are JSON."""
        return [json.loads(payload) for _, payload in self.messages[topic]]
