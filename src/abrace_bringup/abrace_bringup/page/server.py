# SPDX-License-Identifier: Apache-2.0
"""The page's web server, in a thread of its own: its files, and a live connection to each page that is open.

A page begins with its token, and without it only watches. It then gets a frame every `PERIOD`, and answers each with
its number: that is its heartbeat, and a page that does not answer gets no further frames, so nothing piles up for one
that is slow.
"""

from __future__ import annotations

import asyncio
import errno
import json
import re
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.web import Application, HTTPError, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from abrace_bringup.page.access import HEADERS, Access
from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

PERIOD = 0.1
"""Seconds between frames."""
AHEAD = 2
"""Frames that may be under way to a page."""
MOST_PAGES, MOST_UNKNOWN = 16, 16
"""Open pages that operate, as many that watch, and connections that have not given their token yet."""
TOKEN_PATIENCE = 5.0
"""Seconds in which a connection has to give its token."""
WRONG_TOKEN_PAUSE = 1.0
"""Seconds after which a wrong token is answered."""
DEAD = 15.0
"""Seconds after which a page that does not answer is closed."""
LONGEST_MESSAGE = 1024
"""Bytes of a message of a page."""
REFUSED, MALFORMED, FULL, ENDED = 4401, 4400, 4429, 4410
"""Codes with which a live connection is closed."""
FILES = {
    "/": ("index.html", "text/html; charset=utf-8"),
    **{
        f"/{name}": (name, "text/javascript; charset=utf-8") for name in ("page.js", "building.js", "uPlot.iife.min.js")
    },
    **{f"/{name}": (name, "text/css; charset=utf-8") for name in ("page.css", "uPlot.min.css")},
}
"""By path: file of the page and its type."""


class Desk(Protocol):
    """What the server calls in the node; every method is called in the server's thread, and returns at once."""

    def hello(self) -> dict[str, Any]:
        """Content of the first message to a page."""

    def frame(self, bins: int, events: int) -> dict[str, Any]:
        """Content of the next frame to a page that has the bins and events up to these numbers."""

    def ask(self, action: str, node: str) -> None:
        """A person who may operate has pressed a button; the result of the action is an event."""

    def hear(self, page: object) -> None:
        """A page that operates has answered."""

    def lose(self, page: object) -> None:
        """The connection of a page that operates has ended."""


class _Guarded(RequestHandler):
    """Answers only the requests that `Access` admits."""

    def initialize(self, server: PageServer) -> None:
        self.server = server

    def set_default_headers(self) -> None:
        self.clear_header("Server")
        for name, value in HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        headers = self.request.headers
        live = isinstance(self, WebSocketHandler)
        reason = self.server.access.refusal(
            headers.get("Host", ""), headers.get("Origin"), headers.get("Sec-Fetch-Site"), live
        )
        if reason:
            self.server.refuse(reason)
            raise HTTPError(403, reason="Forbidden")

    def write_error(self, status_code: int, **_: Any) -> None:
        self.finish(f"{status_code}\n")


class _File(_Guarded):
    def get(self) -> None:
        content, kind = self.server.files[self.request.path]
        self.set_header("Content-Type", kind)
        self.finish(content)


class _Nothing(_Guarded):
    def prepare(self) -> None:
        super().prepare()
        raise HTTPError(404)


class _Live(_Guarded, WebSocketHandler):
    """A page's live connection."""

    known = operates = False
    sent = answered = bins = events = 0
    heard = 0.0

    def check_origin(self, _: str) -> bool:
        return True  # `prepare` has checked more than tornado does

    def open(self, *_: str, **__: str) -> None:
        self.set_nodelay(True)
        self.heard = time.monotonic()
        if sum(not page.known for page in self.server.pages) >= MOST_UNKNOWN:
            self.close(FULL, "too many connections")
            return
        self.server.pages.add(self)

    async def on_message(self, message: str | bytes) -> None:
        try:
            given = json.loads(message)
            if not isinstance(given, dict):
                raise ValueError
            if self not in self.server.pages:
                # messages sent before the page was closed still arrive: of these only a stop is obeyed
                if self.operates and given.get("do") == "stop":
                    self.server.desk.ask("stop", "")
            elif not self.known:
                await self._enter(str(given["token"]))
            elif "got" in given:
                self.answered, self.heard = min(int(given["got"]), self.sent), time.monotonic()
                self.server.answered(self)
            elif self.operates:
                self.server.desk.ask(str(given["do"]), str(given.get("node", "")))
            else:
                self.server.refuse(f"{given['do']!s:.20} of a page that only watches")
        except (ValueError, KeyError, TypeError):
            self.close(MALFORMED, "malformed")

    async def _enter(self, token: str) -> None:
        server, access = self.server, self.server.access
        operates = access.may_operate(token)
        if token and access.token and not operates:
            server.refuse("a wrong token")
            await asyncio.sleep(WRONG_TOKEN_PAUSE)
            self.close(REFUSED, "token")
        elif sum(page.known and page.operates == operates for page in server.pages) >= MOST_PAGES:
            self.close(FULL, "too many pages")
        else:
            self.known, self.operates, self.heard = True, operates, time.monotonic()
            server.answered(self)
            self._send({"hello": {**server.desk.hello(), "operate": operates, "token": bool(access.token)}})

    def tell(self, now: float) -> None:
        """Send the next frame, unless the page is behind; close a page that has stopped answering."""
        if now - self.heard > (DEAD if self.known else TOKEN_PATIENCE):
            self.close(ENDED, "no answer")
            self.server.forget(self)
        elif self.known and self.sent - self.answered < AHEAD:
            frame = self.server.desk.frame(self.bins, self.events)
            self.bins, self.events = frame["traces"]["number"], frame["event_number"]
            self.sent += 1
            self._send({"number": self.sent, **frame})

    def _send(self, content: dict[str, Any]) -> None:
        try:
            self.write_message(json.dumps(content, separators=(",", ":"), allow_nan=False))
        except WebSocketClosedError:
            self.server.forget(self)

    def on_close(self) -> None:
        self.server.forget(self)


class PageServer:
    """Serves the page until it is stopped.

    Parameters
    ----------
    access
        Address, names and token; its port may be 0, for a free one.
    desk
        Provides what the pages show, and takes what is pressed.
    further
        Files that are served besides the page's: by path, content and type.
    failed
        Called in the server's thread with the exception that ended the server.

    Raises
    ------
    AbraceError
        If the address or the port cannot be used.
    """

    def __init__(
        self,
        access: Access,
        desk: Desk,
        further: Mapping[str, tuple[bytes, str]],
        failed: Callable[[BaseException], None],
    ) -> None:
        self.desk = desk
        self.pages: set[_Live] = set()
        self.refused, self.last_refusal = 0, ""
        self._failed = failed
        self._sockets = _bind(access)
        port = self._sockets[0].getsockname()[1]
        self.access = replace(access, port=port)
        folder = Path(__file__).parent / "files"
        self.files = {path: ((folder / name).read_bytes(), kind) for path, (name, kind) in FILES.items()}
        self.files |= further
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ready, self._over = threading.Event(), asyncio.Event()
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)

    def start(self) -> None:
        """Start the server in a thread; returns once it accepts connections."""
        self._thread.start()
        self._ready.wait()

    def stop(self) -> None:
        """Close all pages, and stop the server."""
        if self._loop is not None and self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._over.set)
            self._thread.join()
        for each in self._sockets:
            each.close()

    @property
    def open_pages(self) -> int:
        """How many pages are open."""
        return sum(page.known for page in list(self.pages))

    def refuse(self, reason: str) -> None:
        """Count a refused request, and keep the reason."""
        self.refused, self.last_refusal = self.refused + 1, reason

    def answered(self, page: _Live) -> None:
        """A page has answered."""
        if page.operates:
            self.desk.hear(page)

    def forget(self, page: _Live) -> None:
        """A page's connection has ended."""
        if page in self.pages:
            self.pages.discard(page)
            if page.operates:
                self.desk.lose(page)

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except BaseException as error:
            self._failed(error)
        finally:
            self._ready.set()

    async def _serve(self) -> None:
        self._loop = asyncio.get_running_loop()
        given = {"server": self}
        handlers = [*((re.escape(path), _File, given) for path in self.files), ("/live", _Live, given)]
        application = Application(
            handlers,
            default_handler_class=_Nothing,
            default_handler_args=given,
            log_function=lambda _: None,
            websocket_max_message_size=LONGEST_MESSAGE,
        )
        server = HTTPServer(
            application,
            ssl_options=self.access.certificate,
            max_header_size=16_384,
            max_body_size=LONGEST_MESSAGE,
            idle_connection_timeout=30.0,
            body_timeout=5.0,
        )
        server.add_sockets(self._sockets)
        self._ready.set()
        due = time.monotonic()
        while not self._over.is_set():
            for page in list(self.pages):
                page.tell(time.monotonic())
            due = max(due + PERIOD, time.monotonic())
            try:
                await asyncio.wait_for(self._over.wait(), due - time.monotonic())
            except TimeoutError:
                continue
        server.stop()
        for page in list(self.pages):
            page.close(ENDED, "the server ends")
            self.forget(page)
        await server.close_all_connections()


def _bind(access: Access) -> list[Any]:
    try:
        return bind_sockets(access.port, access.address)
    except PermissionError as error:
        raise AbraceError(f"parameter port: {access.port}: not allowed, expected one of 1024 or more") from error
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise AbraceError(
                f"parameter port: {access.port}: taken by another program, expected a free one"
            ) from error
        raise AbraceError(
            f"parameter address: {access.address}: {error.strerror}, expected one of this machine"
        ) from error
