# SPDX-License-Identifier: Apache-2.0
"""Who may connect to a viewer that may operate: those with its token, and its own page; no page of another site."""

from __future__ import annotations

import socket
import time
from typing import TYPE_CHECKING

import pytest
from foxglove_client import FoxgloveClient, Refused

from abrace_bringup.viewing.guard import LONGEST_HEAD, Guard, hidden_address, own_origins, refusal
from abrace_bringup.viewing.server import ViewServer
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

CHANNELS = "/view/channels"
TOKEN, PAGE_PORT = "0123456789abcdef", 8766
OWN = own_origins(PAGE_PORT)
PAYLOAD = 300_000
"""Bytes of a message that is passed on in several pieces."""


def request(target: str = "/", *headers: str, method: str = "GET", upgrade: str = "Upgrade: websocket") -> bytes:
    lines = [f"{method} {target} HTTP/1.1", "Host: 127.0.0.1:8765", upgrade, *headers, "", ""]
    return "\r\n".join(lines).encode("latin-1")


@pytest.mark.parametrize(
    "head",
    [
        request(f"/?token={TOKEN}"),
        request(f"/?token={TOKEN}", "Origin: https://app.foxglove.dev"),
        request(f"/?token={TOKEN}", "origin: file://"),
        request("/", "Origin: http://127.0.0.1:8766"),
        request("/", "ORIGIN: http://LocalHost:8766"),
        request("/", "Origin: http://[::1]:8766"),
    ],
)
def test_whoever_has_the_token_and_the_own_page_are_let_in(head):
    assert not refusal(head, TOKEN, OWN)


@pytest.mark.parametrize(
    ("head", "reason"),
    [
        (request(), "without an origin with no token"),
        (request("/", "Origin: https://elsewhere.example"), "of 'https://elsewhere.example' with no token"),
        (request("/", "Origin: http://127.0.0.1:8766.elsewhere.example"), "with no token"),
        (request("/", "Origin: http://127.0.0.1:3000"), "with no token"),
        (request("/", "Origin: https://127.0.0.1:8766"), "with no token"),
        (request("/", "Origin: null"), "of 'null' with no token"),
        (request("/", "Origin: file://"), "of 'file://' with no token"),
        (request("/", "Origin: http://rebound.example:8766"), "with no token"),
        (request("/", "Origin: http://127.0.0.1:8766", "Origin: https://elsewhere.example"), "with no token"),
        (request("/", f"X: {TOKEN}", "Origin: https://elsewhere.example"), "with no token"),
        (request("/?token="), "with no token"),
        (request(f"/?token={TOKEN[:-1]}"), "with a wrong token"),
        (request("/?token=%C3%A9"), "with a wrong token"),
        (request(f"/?token={TOKEN}&token=other"), "with a wrong token"),
        (request(f"/?token={TOKEN}", method="POST"), "no WebSocket"),
        (request(f"/?token={TOKEN}", upgrade="Accept: *"), "no WebSocket"),
        (b"\r\n\r\n", "no WebSocket"),
        (b"\xff\xfe \x00\r\n\r\n", "no WebSocket"),
    ],
)
def test_nobody_else_is(head, reason):
    assert reason in refusal(head, TOKEN, OWN)


def test_what_is_reported_of_an_origin_has_an_end_and_no_line_of_its_own():
    found = refusal(request("/", "Origin: " + "x\x1b[2J" * 2000), TOKEN, OWN)
    assert len(found) < 1000
    assert found.isprintable()


@pytest.fixture
def guarded() -> Iterator[tuple[ViewServer, list[str]]]:
    """A server with a message for all who subscribe, behind a guard; and why the guard has refused."""
    refused: list[str] = []
    server = ViewServer("127.0.0.1", 0, "test", Guard("127.0.0.1", 0, TOKEN, refused.append))
    server.open_channels({"type": "object"})
    server.send_json(CHANNELS, {"text": "x" * PAYLOAD}, 1, latched=True)
    server.open_to(OWN)
    yield server, refused
    server.close()


def until(condition: Callable[[], object], what: str) -> None:
    deadline = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.01)


@pytest.mark.parametrize(("token", "origin"), [(TOKEN, "https://app.foxglove.dev"), ("", "http://localhost:8766")])
def test_messages_pass_through_the_guard_whole(guarded, token, origin):
    server, refused = guarded
    with FoxgloveClient(server.port, token, origin) as client:
        until(lambda: CHANNELS in client.channels, "the topic")
        client.subscribe(CHANNELS)
        until(lambda: server.wanted(CHANNELS), "the subscription")
        until(lambda: server.greet() or client.messages[CHANNELS], "the message")
        assert client.json(CHANNELS) == [{"text": "x" * PAYLOAD}]
    until(lambda: not server.wanted(CHANNELS), "the server to see that the client has gone")
    assert not refused


@pytest.mark.parametrize(("token", "origin"), [("", "https://elsewhere.example"), ("", ""), ("wrong", "")])
def test_a_page_of_another_site_is_answered_403_and_never_reaches_the_server(guarded, token, origin):
    server, refused = guarded
    with pytest.raises(Refused, match="403"), FoxgloveClient(server.port, token, origin):
        pass
    assert refused == [refusal(request(f"/?token={token}", *([f"Origin: {origin}"] if origin else [])), TOKEN, OWN)]


def test_a_connection_that_sends_too_much_or_half_a_request_does_not_hold_up_others(guarded):
    server, _ = guarded
    here = ("127.0.0.1", server.port)
    with socket.create_connection(here) as endless, socket.create_connection(here) as half:
        half.sendall(request(f"/?token={TOKEN}")[:-2])
        endless.sendall(b"GET / HTTP/1.1\r\n" + b"x" * 4 * LONGEST_HEAD)
        with FoxgloveClient(server.port, TOKEN) as client:
            until(lambda: client.said["serverInfo"], "the server")
        endless.settimeout(5.0)
        try:
            answer = endless.recv(100)
        except ConnectionResetError:
            answer = b""
        assert answer == b"", "closed"


def test_the_server_itself_listens_where_nobody_finds_it(guarded):
    server, _ = guarded
    assert len({hidden_address() for _ in range(100)}) > 90
    inner = server._server.port
    assert inner != server.port
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", inner), timeout=5.0)


def test_a_port_that_is_taken_is_an_error_of_one_line(guarded):
    server, _ = guarded
    with pytest.raises(AbraceError, match=rf"server: cannot listen on 127\.0\.0\.1, port {server.port}: "):
        Guard("127.0.0.1", server.port, TOKEN, lambda _: None)
