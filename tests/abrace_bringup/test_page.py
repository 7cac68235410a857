# SPDX-License-Identifier: Apache-2.0
"""The page without ROS: what it shows, who may watch and who may operate, when it asks for a stop."""

from __future__ import annotations

import asyncio
import http.client
import json
import shutil
import subprocess
import time
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import WebSocketClientConnection, websocket_connect

from abrace.report.node_table import NodeReport, NodeReports
from abrace_bringup.page import actions, view
from abrace_bringup.page.access import make_access
from abrace_bringup.page.samples import Samples, names_of
from abrace_bringup.page.server import AHEAD, FILES, LONGEST_MESSAGE, MOST_PAGES, PageServer
from abrace_bringup.page.stop_request import NO_PAGE, StopRequest
from abrace_bringup.page.traces import BIN, SECONDS, Traces
from abrace_core import AbraceError
from abrace_core.files.installed import find_file
from abrace_plant.rig.file import load_rig

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

TOKEN = "0123456789abcdef"


def report(message: str = "running", failed: bool = False, heard: float = 10.0, **values: object) -> NodeReport:
    return NodeReport.after(
        None, message, failed, {key.replace("_", " "): str(one) for key, one in values.items()}, heard
    )


# what it shows


def test_no_peak_is_hidden_and_what_is_kept_has_an_end():
    traces = Traces()
    values = np.stack([np.arange(100_000) == 99_950, -np.arange(100_000)], axis=1).astype(float)
    for part in np.array_split(np.arange(100_000), 7_000):
        traces.add(np.full(len(part), 7, np.uint64), 2_000_000 * part, values[part])
    told = traces.since(0)
    assert told["anew"], "most of it was too long ago"
    assert len(told["low"]) == len(told["begin"]) == SECONDS * 1_000_000_000 // BIN
    assert max(high[0] for high in told["high"]) == 1.0, "the peak of one sample"
    assert told["low"][-1][1] == -99_979, "the last whole bin"
    assert told["begin"][-1] == pytest.approx(199.92, abs=0.05)
    again = traces.since(told["number"])
    assert (again["anew"], again["begin"]) == (False, [])
    failed = np.arange(100_000, 100_045)
    traces.add(np.full(45, 7, np.uint64), 2_000_000 * failed, np.full((45, 2), [np.nan, np.inf]))
    told = traces.since(told["number"])
    assert len(told["begin"]) == 3
    assert told["low"][-1] == [None, None], "no JSON has NaN"
    json.dumps(told, allow_nan=False)


def test_a_new_run_or_a_rig_of_another_size_begins_anew():
    traces, stamps = Traces(), 2_000_000 * np.arange(60)
    traces.add(np.full(60, 1, np.uint64), stamps, np.zeros((60, 1)))
    shown = traces.since(0)["number"]
    for run, size in ((2, 1), (2, 2)):
        traces.add(np.full(60, run, np.uint64), stamps, np.full((60, size), float(run)))
        told = traces.since(shown)
        assert told["anew"]
        assert {len(low) for low in told["low"]} == {size}
        assert len(told["begin"]) == 2, "of this run alone"
        shown = told["number"]


def test_the_rigs_state_is_shown_in_words_and_silence_and_another_rig_are_told():
    rig = load_rig(find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig"))
    values = [0.001, 0.002, 0.003, 0.5, 1.0, 2.0, 3.0, 12e3, 0.1, -6e3]

    def last(state: int, cause: str = "", flags: int = 0, floors: int = 3) -> Samples:
        row, zero = np.array([values]), np.zeros(1, np.int64)
        return Samples(names_of(3, 1), row, zero, zero.astype(np.uint64), floors, 1, state, flags, cause)

    shown = view.rig_view(rig)
    assert shown["channels"] == ["x1", "x2", "x3", "a1", "a2", "a3", "f", "w", "U"]
    assert view.on_screen(last(3), rig).tolist() == [[1.0, 2.0, 3.0, 1.0, 2.0, 3.0, 12.0, 0.1, -6.0]]
    (group,) = shown["groups"]
    assert (group["name"], group["floor"], group["capacity"]) == ("f", 1, pytest.approx(24.516625))
    assert len(shown["heights"]) == 3
    shown = view.sample_view(last(3, flags=1), 0.1, rig)
    assert (shown["state"], shown["level"]) == ("running", "acting")
    assert shown["limited"] == ["a command is cut to the capacity"]
    shown = view.sample_view(last(4, "drift"), 0.1, rig)
    assert (shown["state"], shown["level"], shown["cause"]) == ("ramping down", "fault", "drift")
    for age, sample in ((0.6, last(3)), (0.0, None)):
        assert view.sample_view(sample, age, rig)["state"] == "no samples"
    assert "has 5 floors" in view.sample_view(last(3, floors=5), 0.1, rig)["wrong"]


def test_reports_become_interlocks_latencies_losses_and_nodes():
    reports = NodeReports(
        {
            "/rig/plant": report(interlock_drift="64 % of its limit", interlock_stuck="91 % of its limit"),
            "/rig/controller": NodeReport.after(
                None, "fault: x", True, {f"answer_{one}_us": "9" for one in view.LATENCIES} | {"late": "2"}, 10.0
            ),
            "/rig/logger": NodeReport.after(
                None,
                "recording",
                False,
                {"messages of response": "500", "lost of response": "3", "file": "bags/a"},
                10.0,
            ),
            "/rig/stale": report("not active", heard=5.0),
            "/rig/excitation": report("cancelled: a stop", life_cycle="active", signal="cancelled"),
            "/rig/ground_motion": report("playing", life_cycle="active", signal="playing"),
        }
    )
    offered = actions.offers(
        [f"/rig/{name}/change_state" for name in ("plant", "controller", "excitation", "ground_motion")]
        + ["/rig/controller/clear_fault", "/rig/excitation/play", "/rig/ground_motion/play"]
        + [f"/rig/logger/{name}" for name in ("start", "stop", "describe_parameters")]
    )
    assert [one["name"] for one in view.interlock_view(reports["/rig/plant"])] == ["stuck", "drift"]
    assert [one["times"] for one in view.latency_view(reports)] == [["9", "9", "9"]]
    (logger,) = view.recording_view(reports, actions.recorders(offered, "/rig"), 10.0)
    assert (logger["messages"], logger["lost"], logger["bad"], logger["file"]) == (500, 3, True, "bags/a")
    nodes = {one["name"]: one for one in view.node_view(reports, offered, 10.0)}
    assert nodes["/rig/controller"]["actions"] == ["arm", "clear"], "its life cycle is not reported"
    assert nodes["/rig/excitation"]["actions"] == ["disarm", "play"], "a signal that was cancelled can be played again"
    assert nodes["/rig/ground_motion"]["actions"] == ["disarm"]
    assert nodes["/rig/stale"]["state"] == "stale for 5 s; was: not active"
    events = view.Events()
    for number in range(200):
        events.add(float(number), f"event {number}")
    assert [one["text"] for one in events.since(198)] == ["event 198", "event 199"]
    assert len(events.since(0)) == view.EVENTS


def test_wrong_diagnostics_of_anyone_can_be_shown():
    reports = NodeReports()
    for text in ("9" * 5000, "9" * 5000 + " %", "\u00b2", "1e999 %", "<b>"):
        keys = ("messages of response", "lost of response", "sequence", "interlock drift", "late", "answer_worst_us")
        values = [SimpleNamespace(key=key, value=text) for key in keys]
        for _ in range(2):
            reports.note(SimpleNamespace(name="rig/x: state", level=b"\x01", message=text, values=values), 10.0)
        shown = [
            view.interlock_view(reports["/rig/x"]),
            view.recording_view(reports, ["/rig/x"], 10.0),
            view.latency_view(reports),
            view.node_view(reports, {}, 10.0),
        ]
        assert len(json.dumps(shown, allow_nan=False)) < 10**6


def test_actions_go_to_the_nodes_of_the_namespace_the_rig_last():
    offered = actions.offers(
        [f"/rig/{node}/{name}" for node in ("plant", "controller") for name in ("change_state", "clear_fault")]
        + ["/other/plant/clear_fault", "/rig/logger/start", "/rig/logger/stop", "/rig/x/start"]
    )

    def of(action: str, node: str = "") -> list[str]:
        failed = ["/rig/plant", "/rig/controller", "/other/plant"]
        return actions.targets(action, node, offered, "/rig", ["/rig/plant", "/other/plant"], failed)

    assert of("arm") == of("disarm") == ["/rig/plant"]
    assert of("arm", "/rig/controller") == ["/rig/controller"]
    assert of("clear") == ["/rig/controller", "/rig/plant"], "a rig refuses while its sender has a fault"
    assert of("record") == of("end_record") == ["/rig/logger"]
    for action, node, message in (
        ("zero", "", "no node in namespace /rig to zero the sensors, expected a rig with zero_sensors"),
        ("clear", "/other/plant", "/other/plant in namespace /rig: not there"),
        ("format", "", "action 'format': unknown, expected one of arm,"),
    ):
        with pytest.raises(AbraceError, match=message):
            of(action, node)


# when it asks for a stop


def test_a_stop_stands_until_a_person_releases_it():
    request = StopRequest(0.0)
    assert request.reason(0.0) == ""
    request.press("pressed")
    request.press("again")
    request.lose("a page")
    assert request.reason(1e9) == "pressed"
    request.release()
    assert request.reason(1e9) == "", "pages may come and go"


def test_with_a_heartbeat_every_lost_page_is_a_stop_and_so_is_none():
    request = StopRequest(1.0)
    assert request.reason(0.0) == NO_PAGE
    with pytest.raises(AbraceError, match="no page answers"):
        request.release()
    request.hear("a", 10.0)
    assert request.reason(10.0) == NO_PAGE, "a person releases it"
    request.release()
    request.hear("b", 10.9)
    assert request.reason(10.95) == ""
    assert request.reason(11.1) == "a page has not answered for more than 1 s", "though another one has"
    request.hear("a", 11.2)
    assert request.reason(11.2), "it stays"
    request.release()
    request.hear("b", 11.2)
    assert request.reason(11.3) == ""
    request.lose("a")
    assert request.reason(11.3) == "a page was closed, or its connection is lost"


# whom it lets in


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with cert.pem, key.pem and token."""
    folder = tmp_path_factory.mktemp("keys")
    if shutil.which("openssl") is None:
        pytest.skip("no openssl on this machine")
    command = "openssl req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=localhost -keyout key.pem -out cert.pem"
    subprocess.run(command.split(), cwd=folder, check=True, capture_output=True)
    (folder / "token").write_text(TOKEN)
    (folder / "token").chmod(0o600)
    return folder


def test_beyond_this_machine_token_and_tls_are_needed_and_each_mistake_is_named(keys, tmp_path):
    given: dict[str, Any] = {"address": "0.0.0.0", "port": 1, "hosts": ["lab"], "operate": True}
    given["token_file"] = str(keys / "token")
    tls = {"certificate": str(keys / "cert.pem"), "key": str(keys / "key.pem")}
    access = make_access(**given, **tls)
    assert access.url == "https://lab:1/"
    assert TOKEN not in repr(access)
    watched = make_access("0.0.0.0", 1, ["lab"], operate=False, token_file="", certificate="", key="")
    assert watched.url == "http://lab:1/"
    assert not any(map(watched.may_operate, ("", TOKEN)))
    (tmp_path / "open").write_text(TOKEN)
    (tmp_path / "open").chmod(0o644)
    (tmp_path / "short").write_text("secret")
    (tmp_path / "short").chmod(0o600)
    for change, message in (
        ({"certificate": "", "key": ""}, "address: 0.0.0.0, beyond this machine, expected token_file, cert"),
        ({"token_file": ""}, "address: 0.0.0.0, beyond this machine"),
        ({"address": "192.0.2.1", "token_file": ""}, "address: 192.0.2.1, beyond this machine"),
        ({"operate": False}, "token_file: .*/token, expected none with operate:=false"),
        ({"address": "lab"}, "address: lab, expected an IP address"),
        ({"hosts": []}, "hosts: not given, expected the names"),
        ({"key": ""}, "key: not given, expected a file, because certificate is given"),
        ({"key": str(keys / "no")}, "key: .*no such file"),
        ({"key": str(keys / "cert.pem")}, "certificate: .*expected a certificate and its key in PEM"),
        ({"token_file": str(keys / "no")}, "token_file: .*No such file or directory"),
        ({"token_file": str(tmp_path / "open")}, "token_file: .*others can read it, expected chmod 600"),
        ({"token_file": str(tmp_path / "short")}, "token_file: .*expected one word of 16 characters or more"),
    ):
        with pytest.raises(AbraceError, match=f"^parameter {message}"):
            make_access(**{**given, **tls, **change})


class Desk:
    """In the node's place: keeps what the server asks."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, str]] = []
        self.frames = self.heard = 0
        self.pages: set[object] = set()

    def hello(self) -> dict[str, Any]:
        return {"rig": "a rig"}

    def frame(self, bins: int, events: int) -> dict[str, Any]:
        self.frames += 1
        return {"traces": {"number": bins + 1}, "event_number": events}

    def ask(self, action: str, node: str) -> None:
        self.asked.append((action, node))

    def hear(self, page: object) -> None:
        self.heard += 1
        self.pages.add(page)

    def lose(self, page: object) -> None:
        self.pages.discard(page)


def served(**given: Any) -> PageServer:
    defaults = {"address": "127.0.0.1", "port": 0, "hosts": [], "operate": True}
    defaults |= {"token_file": "", "certificate": "", "key": ""}

    def failed(error: BaseException) -> None:
        raise AssertionError from error

    layouts = {"/layout.json": (b"{}", "application/json")}
    return PageServer(make_access(**{**defaults, **given}), Desk(), layouts, failed)


@pytest.fixture
def server() -> Iterator[PageServer]:
    server = served()
    server.start()
    yield server
    server.stop()


async def connected(server: PageServer, token: str = "", **headers: str) -> WebSocketClientConnection:
    """A live connection as of a page of the server's own, but for the headers given."""
    access = server.access
    own = f"{access.scheme}://127.0.0.1:{access.port}"
    url = own.replace("http", "ws", 1) + "/live"
    given = {"Origin": own, **{name.replace("_", "-"): value for name, value in headers.items() if value}}
    if headers.get("Origin") == "":
        del given["Origin"]
    socket = await websocket_connect(HTTPRequest(url, headers=given, validate_cert=False))
    await socket.write_message(json.dumps({"token": token}))
    return socket


def get(server: PageServer, path: str = "/", method: str = "GET", **headers: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", server.access.port, timeout=10)
    connection.putrequest(method, path, skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name.replace("_", "-"), value)
    connection.endheaders()
    return connection.getresponse()


def test_only_the_page_is_served_and_no_other_page_may_frame_it(server):
    for path, (_, kind) in FILES.items():
        answer = get(server, path)
        assert (answer.status, answer.headers["Content-Type"]) == (200, kind)
        assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]
        assert "unsafe" not in answer.headers["Content-Security-Policy"]
        assert answer.headers["Server"] is None
    assert get(server, "/layout.json").read() == b"{}"
    for path in ("/../access.py", "/files/page.js", "//page.js", "/pagexjs", "/%2e%2e/server.py", "/live"):
        assert get(server, path).status in (400, 403, 404), path
    assert get(server, method="POST").status == 405


def test_a_page_of_somebody_elses_can_neither_look_nor_press(server):
    port = server.access.port
    wrong_hosts = (
        "attacker.example",
        f"attacker.example:{port}",
        f"127.0.0.1.attacker.example:{port}",
        "",
        "127.0.0.1",
    )
    for host in wrong_hosts:
        assert get(server, Host=host).status in (400, 403), f"a name that leads here: {host!r}"
    for host in (f"localhost:{port}", f"127.0.0.1:{port}", f"[::1]:{port}"):
        assert get(server, Host=host).status == 200
    origins = ("https://attacker.example", f"http://attacker.example:{port}", "null", f"https://127.0.0.1:{port}")
    tries = [
        {"Origin": origin} for origin in (*origins, f"http://127.0.0.1:{port + 1}", f"http://localhost:{port}", "")
    ]
    tries.append({"Host": f"attacker.example:{port}", "Origin": f"http://attacker.example:{port}"})
    tries.append({"Sec_Fetch_Site": "cross-site"})
    tries.append({"Sec_Fetch_Site": "same-site"})
    for headers in tries:
        with pytest.raises(HTTPClientError) as caught:
            asyncio.run(connected(server, **headers))
        assert caught.value.code in (400, 403), headers
    assert server.refused >= len(wrong_hosts) - 1
    assert "expected" in server.last_refusal
    assert not server.pages
    assert server.desk.asked == []


def test_of_a_page_that_was_given_up_only_a_stop_is_still_heard(server):
    async def page() -> None:
        socket = await connected(server)
        assert "hello" in json.loads(await socket.read_message())
        (own,) = server.pages
        server.forget(own)
        for message in ({"got": 1}, {"do": "release"}, {"do": "stop"}):
            await socket.write_message(json.dumps(message))
        while not server.desk.asked:
            await asyncio.sleep(0.01)

    asyncio.run(asyncio.wait_for(page(), 30))
    assert server.desk.asked == [("stop", "")]
    assert not server.desk.pages


def test_a_page_gets_frames_as_fast_as_it_answers_and_what_it_presses_arrives(server):
    async def page() -> None:
        socket = await connected(server)
        hello = {"rig": "a rig", "operate": True, "token": False}
        assert json.loads(await socket.read_message()) == {"hello": hello}
        await socket.write_message('{"do": "stop"}')
        await socket.write_message('{"do": "arm", "node": "/rig/plant"}')
        for number in range(1, AHEAD + 1):
            assert json.loads(await socket.read_message())["number"] == number
        behind = server.desk.frames
        await asyncio.sleep(0.5)
        assert server.desk.frames == behind == AHEAD, "a page that is behind gets no more"
        await socket.write_message(json.dumps({"got": AHEAD}))
        assert json.loads(await socket.read_message())["number"] == AHEAD + 1
        assert server.desk.asked == [("stop", ""), ("arm", "/rig/plant")]
        assert len(server.desk.pages) == server.open_pages == 1
        socket.close()
        while server.desk.pages:
            await asyncio.sleep(0.01)

    asyncio.run(asyncio.wait_for(page(), 30))


@pytest.mark.parametrize(
    "message", ["", "[]", "{", '{"got": "x"}', '{"got": null}', "{}", '"stop"', b"\xff", "9" * (LONGEST_MESSAGE + 1)]
)
def test_a_malformed_message_ends_the_connection_and_nothing_else(server, message):
    async def page() -> None:
        socket = await connected(server)
        await socket.read_message()
        await socket.write_message(message, binary=isinstance(message, bytes))
        while await socket.read_message() is not None:
            pass

    asyncio.run(asyncio.wait_for(page(), 30))
    assert server.desk.asked == []
    assert get(server).status == 200


async def pressed(server: PageServer, token: str) -> dict[str, Any] | None:
    """Press STOP on a page that gives this token, and stay for some frames; returns the hello, None: refused."""
    socket = await connected(server, token)
    for message in ('{"do": "stop"}', '{"do": "arm", "node": "/rig/plant"}'):
        await socket.write_message(message)
    if (answer := await socket.read_message()) is None:
        return None
    for number in range(1, AHEAD + 2):
        assert json.loads(await socket.read_message() or "{}")["number"] == number
        await socket.write_message(json.dumps({"got": number}))
    return dict(json.loads(answer)["hello"])


def test_without_the_token_a_page_only_watches_and_with_it_it_operates_over_tls(keys):
    server = served(token_file=str(keys / "token"), certificate=str(keys / "cert.pem"), key=str(keys / "key.pem"))
    server.start()

    async def guess() -> list[dict[str, Any] | None]:
        return await asyncio.wait_for(asyncio.gather(*(pressed(server, token) for token in (TOKEN[:-1], "é"))), 30)

    try:
        began = time.monotonic()
        assert asyncio.run(guess()) == [None] * 2
        assert time.monotonic() - began >= 1.0, "guessing is slow"
        assert (server.desk.asked, server.desk.frames, server.refused) == ([], 0, 2)
        assert server.last_refusal == "a wrong token"
        assert asyncio.run(pressed(server, "")) == {"rig": "a rig", "operate": False, "token": True}
        assert (server.desk.asked, server.desk.heard) == ([], 0), "one that watches is nobody's heartbeat"
        assert server.last_refusal == "arm of a page that only watches"
        assert asyncio.run(pressed(server, TOKEN)) == {"rig": "a rig", "operate": True, "token": True}
        assert server.desk.asked == [("stop", ""), ("arm", "/rig/plant")]
        assert server.desk.heard
        with pytest.raises((http.client.HTTPException, ConnectionError)):
            get(server)
    finally:
        server.stop()


def test_nobody_operates_where_that_is_switched_off_and_no_stop_is_asked_for():
    server = served(operate=False)
    server.start()
    try:
        for token in ("", TOKEN):
            assert asyncio.run(pressed(server, token)) == {"rig": "a rig", "operate": False, "token": False}
        assert (server.desk.asked, server.desk.heard) == ([], 0)
    finally:
        server.stop()


def test_those_who_watch_take_no_place_from_one_who_operates(keys):
    server = served(token_file=str(keys / "token"))
    server.start()

    async def crowd() -> tuple[dict[str, Any] | None, str | bytes | None]:
        watching = [await connected(server) for _ in range(MOST_PAGES)]
        for each in watching:
            assert await each.read_message()
        operating = await pressed(server, TOKEN)
        one_more = await connected(server)
        return operating, await one_more.read_message()

    try:
        operating, one_more = asyncio.run(asyncio.wait_for(crowd(), 30))
        assert operating is not None
        assert operating["operate"]
        assert one_more is None, "their number has an end"
    finally:
        server.stop()


def test_a_port_that_is_taken_is_named(server):
    with pytest.raises(AbraceError, match=f"^parameter port: {server.access.port}: taken by another program"):
        served(port=server.access.port)
