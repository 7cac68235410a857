# SPDX-License-Identifier: Apache-2.0
"""The listener of a server whose viewers may operate the graph: it refuses pages of other sites.

Every page in a browser on this machine can open a WebSocket to loopback. Foxglove's SDK does not check who connects.
So its server listens on an address that cannot be guessed, and this listener passes on to it only connections with the
token in their address (`ws://127.0.0.1:8765/?token=...`), and those of the viewer's own page, by the header Origin.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import secrets
import threading
from typing import TYPE_CHECKING
from urllib.parse import parse_qs, urlsplit

from tornado.netutil import bind_sockets

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection

LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
"""Host names of this machine, as in an Origin."""
LONGEST_HEAD = 16384
"""Bytes of a request's head."""
LONGEST_NAME = 100
"""Characters that are reported of an Origin."""
PATIENCE = 5.0
"""Seconds within which a connection has to send its request."""
CHUNK = 65536
"""Bytes passed on at once."""
FORBIDDEN = b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"


def hidden_address() -> str:
    """An address of loopback, chosen from 16 million: with a free port it is not to be found by trying.

    >>> hidden_address().startswith("127.")
    True
    """
    return f"127.{secrets.randbelow(256)}.{secrets.randbelow(256)}.{1 + secrets.randbelow(254)}"


def own_origins(port: int) -> frozenset[str]:
    """The header Origin of a page that this machine serves on a `port`, by each name that the machine has.

    >>> sorted(own_origins(8766))
    ['http://127.0.0.1:8766', 'http://[::1]:8766', 'http://localhost:8766']
    """
    return frozenset(f"http://{name}" + (f":{port}" if port != 80 else "") for name in LOOPBACK)


def refusal(head: bytes, token: str, origins: Collection[str]) -> str:
    """Why a request is refused; empty: it is not.

    Parameters
    ----------
    head
        Request line and headers.
    token
        That a connection has to have in its address.
    origins
        Of pages that need no token.
    """
    request, *lines = head.decode("latin-1").split("\r\n")
    method, target, _ = (*request.split(" "), "", "", "")[:3]
    headers: dict[str, list[str]] = {}
    for line in lines:
        name, _, value = line.partition(":")
        headers.setdefault(name.strip().lower(), []).append(value.strip())
    if method != "GET" or [one.lower() for one in headers.get("upgrade", [])] != ["websocket"]:
        return "no WebSocket, expected one"
    given = parse_qs(urlsplit(target).query).get("token", [])
    if len(given) == 1 and hmac.compare_digest(given[0].encode(), token.encode()):
        return ""
    origin = headers.get("origin", [])
    if len(origin) == 1 and origin[0].lower() in origins:
        return ""
    whose = f"of {', '.join(origin)[:LONGEST_NAME]!r}" if origin else "without an origin"
    token_given = "a wrong" if given else "no"
    return f"a connection {whose} with {token_given} token, expected the address that the viewer printed"


class Guard:
    """Listens where viewers connect; connections wait until it is opened.

    Parameters
    ----------
    host, port
        Where it listens; port 0: any that is free.
    token
        That a connection has to have in its address.
    refused
        Called in its thread with the reason why a connection was refused.

    Raises
    ------
    AbraceError
        If it can't listen there.
    """

    def __init__(self, host: str, port: int, token: str, refused: Callable[[str], None]) -> None:
        try:
            self._sockets = bind_sockets(port, host)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise AbraceError(f"server: cannot listen on {host}, port {port}: {reason}") from error
        self._token = token
        self._refused = refused
        self._thread = threading.Thread(target=self._run, name="guard", daemon=True)
        self._loop = asyncio.new_event_loop()
        self._ended = asyncio.Event()

    @property
    def port(self) -> int:
        """The port on which it listens."""
        return int(self._sockets[0].getsockname()[1])

    def open(self, server: tuple[str, int], origins: Collection[str]) -> None:
        """Begin to pass connections on.

        Parameters
        ----------
        server
            Host and port of the server that they are passed on to.
        origins
            Of pages that need no token.
        """
        self._server, self._origins = server, frozenset(origins)
        self._thread.start()

    def close(self) -> None:
        """End all connections."""
        if self._thread.ident is not None:
            self._loop.call_soon_threadsafe(self._ended.set)
            self._thread.join()
        for each in self._sockets:
            each.close()

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._listen())

    async def _listen(self) -> None:
        async with contextlib.AsyncExitStack() as servers:
            for each in self._sockets:
                server = await asyncio.start_server(self._connected, sock=each, limit=LONGEST_HEAD)
                servers.callback(server.close)
            await self._ended.wait()

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with (
            contextlib.closing(writer),
            contextlib.suppress(OSError, TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError),
        ):
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), PATIENCE)
            if reason := refusal(head, self._token, self._origins):
                self._refused(reason)
                writer.write(FORBIDDEN)
                await writer.drain()
                return
            answers, to_server = await asyncio.open_connection(*self._server)
            with contextlib.closing(to_server):
                to_server.write(head)
                ways = (reader, to_server), (answers, writer)
                passing = [asyncio.create_task(_pass_on(*way)) for way in ways]
                _, left = await asyncio.wait(passing, return_when=asyncio.FIRST_COMPLETED)
                for each in left:
                    each.cancel()


async def _pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Write all that comes, until there is no more."""
    with contextlib.suppress(OSError):
        while content := await reader.read(CHUNK):
            writer.write(content)
            await writer.drain()
