# SPDX-License-Identifier: Apache-2.0
"""The viewer, as Foxglove and Lichtblick see it: a client of their protocol, over a WebSocket."""

from __future__ import annotations

import functools
import json
import re
import threading
import urllib.error
import urllib.parse
import urllib.request
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bag_of_run import write_bag
from browser import CHROMIUM
from driven_browser import DrivenBrowser
from foxglove_client import FoxgloveClient, Refused
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from std_msgs.msg import String
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from abrace import simulate
from abrace.processes.parameter_file import parameter_file
from abrace.processes.watching import watched
from abrace.report.recorded import last_bag
from abrace_bags import message_definition
from abrace_core.installed import find_file
from abrace_core.table_signals import table_noise
from abrace_interfaces.msg import Response

VIEW = ("/view/channels", "/view/frames", "/view/scene")


def started(graph: Any, **parameters: Any) -> tuple[int, str, str]:
    """Start a viewer on free ports; returns its WebSocket port, where its page is, and its token."""
    graph.start("viewer", port=0, page_port=0, **parameters)
    line = graph.until(lambda: [line for line in graph.output_of("viewer") if "ws://" in line], "the viewer to listen")
    pattern = r"viewer: (http://127\.0\.0\.1:\d+/) in .* ws://127\.0\.0\.1:(\d+)(?:/\?token=([\w-]{16,}))?"
    page, port, token = re.fullmatch(pattern, line[0]).groups()
    return int(port), page, token or ""


def test_viewers_get_the_graph_as_it_is_and_a_building_that_moves_and_may_stop_it_where_that_was_allowed(
    graph: Any,
) -> None:
    graph.start("plant")
    port, page, token = started(graph, operate=True)
    for origin in ("https://elsewhere.example", "http://127.0.0.1:80", "null", ""):
        with pytest.raises(Refused, match="403"), FoxgloveClient(port, origin=origin):
            pass
    with FoxgloveClient(port, origin=page.rstrip("/")) as own_page:
        graph.until(lambda: own_page.said["serverInfo"], "the viewer to answer its own page")
    response, plant = f"{graph.namespace}/response", f"{graph.namespace}/plant"
    with FoxgloveClient(port, token, "https://app.foxglove.dev") as client:
        graph.until(lambda: {response, *VIEW} <= set(client.channels), "the topics of the graph")
        channel = client.channels[response]
        assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
        assert channel["schemaName"] == "abrace_interfaces/msg/Response"
        assert channel["schema"] == message_definition("abrace_interfaces/msg/Response").text
        schemas = [client.channels[topic]["schemaName"] for topic in VIEW]
        assert schemas == ["abrace.Channels", "foxglove.FrameTransforms", "foxglove.SceneUpdate"]
        graph.until_matched("plant", response=0)
        subscribers = graph.values("plant")["subscribers of response"]
        assert subscribers == "0", "without a client the viewer subscribes to nothing"

        published: list[bytes] = []
        graph.node.create_subscription(Response, "response", published.append, 5000, raw=True)
        graph.until_matched("plant", response=1)
        client.subscribe(response, *VIEW, "/view/nodes", "/robot_description", f"{graph.namespace}/robot_description")
        graph.until(lambda: all(len(client.messages[topic]) > 20 for topic in (response, *VIEW)), "messages")
        passed_on = [payload for _, payload in client.messages[response]]
        graph.until(lambda: set(passed_on) <= set(published), "the same messages, byte for byte")
        samples = [deserialize_message(payload, Response) for payload in passed_on]
        numbers = [sample.sequence for sample in samples]
        assert numbers == sorted(set(numbers))
        shown = client.json("/view/channels")
        assert shown[0]["state"] == "running"
        names = client.channels["/view/channels"]["schema"]
        assert {"x1", "a3", "fb_utilisation"} <= set(json.loads(names)["properties"]) & set(shown[0])
        by_number = {sample.sequence: sample.displacement[0] for sample in samples}
        covered = [one for one in shown if one["sequence"] in by_number]
        assert {one["x1"] for one in covered} & set(by_number.values()), "measured values, none in between"
        for topic in ("/robot_description", f"{graph.namespace}/robot_description"):
            graph.until(lambda topic=topic: client.messages[topic], "the robot description")
            (_, payload) = client.messages[topic][0]
            assert deserialize_message(payload, String).data.startswith('<?xml version="1.0"?>\n<robot name="ncree')
        graph.until(lambda: plant in str(client.json("/view/nodes")[-1:]), "the state of the rig")

        expect_operations(graph, client, plant)
    with urllib.request.urlopen(page) as answer:
        assert b"<canvas" in answer.read()
    with urllib.request.urlopen(f"{page}rig.json") as answer:
        assert json.load(answer)["port"] == port
    with urllib.request.urlopen(f"{page}foxglove.json") as answer:
        assert "3D!building" in json.load(answer)["configById"]
    with urllib.request.urlopen(f"{page}plotjuggler.xml") as answer:
        assert f"{response}/displacement[2]".encode() in answer.read()
    with pytest.raises(urllib.error.HTTPError, match="404"):
        urllib.request.urlopen(f"{page}../etc/passwd")
    assert graph.stop("viewer") == 0


ELSEWHERE = """<!doctype html><title>elsewhere</title><script>
document.title = "waiting";
const socket = new WebSocket(new URLSearchParams(location.search).get("to"), ["foxglove.sdk.v1"]);
socket.onopen = () => { document.title = "connected"; };
socket.onerror = () => { document.title = "refused"; };
</script>"""


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")
def test_a_page_from_elsewhere_does_not_reach_a_viewer_that_may_operate_and_its_own_page_does(
    graph: Any, tmp_path: Path
) -> None:
    graph.start("plant")
    port, page, token = started(graph, operate=True)
    (tmp_path / "elsewhere.html").write_text(ELSEWHERE)
    handler = functools.partial(SimpleHTTPRequestHandler, directory=tmp_path)
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server, DrivenBrowser() as browser:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        for base in (f"http://127.0.0.1:{server.server_port}", tmp_path.as_uri()):
            for suffix, expected in (("", "refused"), ("wrong", "refused"), (token, "connected")):
                to = urllib.parse.quote(f"ws://127.0.0.1:{port}/?token={suffix}", safe="")
                tab = browser.open(f"{base}/elsewhere.html?to={to}")
                tab.until("!['', 'waiting', 'elsewhere'].includes(document.title)")
                assert tab.evaluate("document.title") == expected, (base, suffix)
        browser.open(page).until("document.getElementById('state')?.textContent.includes('running')")
        server.shutdown()


def expect_operations(graph: Any, client: FoxgloveClient, plant: str) -> None:
    """Parameters are read and set, the rig is stopped, and asked to clear it."""
    client.send({"op": "getParameters", "parameterNames": [f"{plant}.rig"], "id": "look"})
    graph.until(lambda: client.said["parameterValues"], "parameters")
    (found,) = client.said["parameterValues"][0]["parameters"]
    assert (found["name"], found["value"]) == (f"{plant}.rig", "ncree_three_storey")
    graph.until(lambda: f"{plant}/clear_fault" in client.services, "services")
    call = client.call("/view/stop", b"\x00\x01\x00\x00\x00")
    graph.until_fault("plant", "protective stop: pressed by ")
    graph.until(lambda: call in client.answers or client.said["serviceCallFailure"], "an answer of the viewer")
    assert not client.said["serviceCallFailure"]
    assert deserialize_message(client.answers[call], Trigger.Response).success

    call = client.call(f"{plant}/clear_fault", b"\x00\x01\x00\x00\x00")
    graph.until(lambda: call in client.answers, "an answer of the rig")
    answer = deserialize_message(client.answers[call], Trigger.Response)
    assert not answer.success, "the stop is still pressed"
    assert "pressed" in answer.message
    faults = {"name": f"{plant}.sensor_faults", "value": ["a1=zero"]}
    client.send({"op": "setParameters", "parameters": [faults], "id": "set"})
    graph.until(lambda: faults in client.said["parameterValues"][-1]["parameters"], "the parameter to be set")


def test_a_bag_is_played_to_viewers_and_no_peak_of_it_is_hidden(graph: Any, tmp_path: Path) -> None:
    run = simulate("ncree_three_storey", table_noise(1000, 500.0, (0.5, 10.0), 0.3, 1))
    write_bag(run, tmp_path / "noise")
    port, _, _ = started(graph, bag=str(tmp_path / "noise"), rate=4.0)
    with FoxgloveClient(port) as client:
        graph.until(lambda: {"/response", *VIEW} <= set(client.channels), "the topics of the bag")
        assert client.said["serverInfo"][0]["capabilities"] == ["time"], "nothing to set, nothing to call"
        client.subscribe(*VIEW)
        graph.until(lambda: len(client.said["serverInfo"]) > 2, "the third round of the bag")
        for name, values in zip(run.names, run.outputs.T, strict=True):
            shown = [message[name] for message in client.json("/view/channels")]
            np.testing.assert_allclose([min(shown), max(shown)], [values.min(), values.max()], err_msg=name)
    assert graph.stop("viewer") == 0


def test_the_scene_comes_fifty_times_in_a_second_of_the_samples(graph: Any, tmp_path: Path) -> None:
    run = simulate("ncree_three_storey", table_noise(1000, 500.0, (0.5, 10.0), 0.3, 1))
    write_bag(run, tmp_path / "noise")
    port, _, _ = started(graph, bag=str(tmp_path / "noise"))
    with FoxgloveClient(port) as client:
        graph.until(lambda: "/view/scene" in client.channels, "the topics of the bag")
        client.subscribe("/view/scene")

        def scenes_of_rounds() -> list[int]:
            times = np.array([time for time, _ in client.messages["/view/scene"]])
            starts = np.flatnonzero(np.diff(times) < 0) + 1
            return [len(part) for part in np.split(times, starts)[1:-1]]

        # in a round in which the viewer was held up there are fewer, or some more when it catches up
        graph.until(lambda: any(98 <= count <= 101 for count in scenes_of_rounds()), "100 scenes of the bag's 2 s")
    assert graph.stop("viewer") == 0


def test_rviz_gets_columns_braces_and_forces_while_it_has_subscribed(graph: Any) -> None:
    graph.start("plant")
    started(graph)
    arrays = graph.listen(MarkerArray, "markers", QoSProfile(depth=10))
    graph.until(lambda: len(arrays) > 50, "markers")
    for array in arrays:
        texts = [marker.text for marker in array.markers if marker.ns == "numbers"]
        assert [re.fullmatch(r"(f[ab]) -?\d+\.\d\d kN, \d+ %", text)[1] for text in texts] == ["fa", "fb"]
        assert {marker.ns for marker in array.markers} == {"columns", "braces", "forces", "numbers"}
    assert graph.stop("viewer") == 0


@pytest.mark.usefixtures("domain")
def test_a_campaign_that_is_watched_has_a_page_meanwhile_and_says_where(capsys: pytest.CaptureFixture) -> None:
    rig_file = find_file("five_storey", "abrace_plant", "config", ".yaml", "rig")
    with watched(rig_file, ["port:=0", "page_port:=0"]):
        page = re.match(r"watch: (\S+)", capsys.readouterr().err)[1]
        with urllib.request.urlopen(f"{page}rig.json") as answer:
            assert json.load(answer)["floors"] == 5
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(page)


def test_the_bag_of_the_last_test_is_shown_afterwards(tmp_path: Path) -> None:
    assert last_bag(tmp_path, ["noise"]) is None
    (tmp_path / "nodes").mkdir()
    for step in ("noise", "quake"):
        parameter_file(tmp_path / f"nodes/{step}_logger.yaml", {"output": f"/bags/{step}"})
    assert last_bag(tmp_path, ["noise", "quake", "model"]) == Path("/bags/quake")
