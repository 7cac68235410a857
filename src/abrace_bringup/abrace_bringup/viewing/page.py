# SPDX-License-Identifier: Apache-2.0
"""A page that shows the building in any browser, without anything to install, served next to the WebSocket server."""

from __future__ import annotations

import json
import threading
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any

from abrace_core.errors import AbraceError
from abrace_core.installed import find_file

if TYPE_CHECKING:
    from collections.abc import Callable

    from abrace_plant.rig.model import Rig

PAGE, FACTS, LAYOUT, PLOTJUGGLER = "/", "/rig.json", "/foxglove.json", "/plotjuggler.xml"
"""Paths that are served: the page, what it has to know, and the layouts of the rig for Foxglove and PlotJuggler."""


def facts(rig: Rig, port: int, exaggeration: float) -> dict[str, Any]:
    """What the page has to know to draw a rig.

    Parameters
    ----------
    rig
        What it draws.
    port
        Of the WebSocket server, on the same host.
    exaggeration
        Times which it enlarges displacements at first.
    """
    braces = [{"floor": group.floor, "cosine": group.cosine, "count": group.count} for group in rig.braces]
    return {
        "name": rig.name,
        "floors": rig.floors,
        "storey": rig.storey_height,
        "braces": braces,
        "port": port,
        "exaggeration": exaggeration,
    }


class PageServer:
    """Serves the page in a thread of its own.

    Parameters
    ----------
    host, port
        Where it listens; port 0: any that is free.
    rig_facts
        What `facts` gives.
    rig_layout
        What `layout.layout` gives.
    plotjuggler_layout
        Function that returns what `layout.plotjuggler_layout` gives, called at each request: the topic may come later.

    Raises
    ------
    AbraceError
        If it can't listen there.
    """

    def __init__(
        self,
        host: str,
        port: int,
        rig_facts: dict[str, Any],
        rig_layout: dict[str, Any],
        plotjuggler_layout: Callable[[], bytes],
    ) -> None:
        page = find_file("page", "abrace_bringup", "viewer", ".html", "page").read_bytes()
        answers = {
            PAGE: ("text/html; charset=utf-8", page),
            FACTS: ("application/json", json.dumps(rig_facts).encode()),
            LAYOUT: ("application/json", json.dumps(rig_layout, indent=1).encode()),
        }

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                path = self.path.partition("?")[0]
                kind, body = answers.get(path, ("", b""))
                if path == PLOTJUGGLER:
                    kind, body = "application/xml", plotjuggler_layout()
                self.send_response(HTTPStatus.OK if kind else HTTPStatus.NOT_FOUND)
                self.send_header("Content-Type", kind or "text/plain")
                self.send_header("Content-Length", str(len(body)))
                self.send_header("X-Content-Type-Options", "nosniff")
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: Any) -> None:
                """Requests are not logged."""

        try:
            self._server = ThreadingHTTPServer((host, port), Handler)
        except OSError as error:
            raise AbraceError(f"page: cannot listen on {host}, port {port}: {error.strerror or error}") from error
        self._thread = threading.Thread(target=self._server.serve_forever, name="page", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """The port on which it listens."""
        return int(self._server.server_address[1])

    @property
    def url(self) -> str:
        """Where the page is."""
        host, port = self._server.server_address[:2]
        return f"http://{host!s}:{port}{PAGE}"

    def close(self) -> None:
        """Stop the server."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
