# SPDX-License-Identifier: Apache-2.0
"""The viewer, as Foxglove and Lichtblick see it: a client of Foxglove's protocol."""

from __future__ import annotations

import re
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

import pytest
from foxglove_client import FoxgloveClient
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from abrace.processes.parameter_file import parameter_file
from abrace.processes.watching import watched
from abrace.report.recorded import last_bag
from abrace_bags import message_definition
from abrace_core.files.installed import find_file
from abrace_interfaces.msg import Response


def started(graph: Any) -> int:
    """Start a viewer; returns its port."""
    graph.start("viewer", port=0)
    line = graph.until(lambda: [line for line in graph.output_of("viewer") if "ws://" in line], "the viewer to listen")
    return int(re.fullmatch(r"viewer: Foxglove, Lichtblick: ws://127\.0\.0\.1:(\d+)", line[0])[1])


def test_viewers_get_the_graph_as_it_is_and_can_do_nothing_to_it(graph: Any) -> None:
    graph.start("plant")
    port = started(graph)
    response, description = f"{graph.namespace}/response", f"{graph.namespace}/robot_description"
    with FoxgloveClient(port) as client:
        graph.until(lambda: {response, description} <= set(client.channels), "the topics of the graph")
        assert client.said["serverInfo"][0]["capabilities"] == [], "nothing to set, nothing to call"
        channel = client.channels[response]
        assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
        assert channel["schemaName"] == "abrace_interfaces/msg/Response"
        assert channel["schema"] == message_definition("abrace_interfaces/msg/Response").text
        graph.until_matched("plant", response=0)
        subscribers = graph.values("plant")["subscribers of response"]
        assert subscribers == "0", "without a client the viewer subscribes to nothing"

        published: list[bytes] = []
        graph.node.create_subscription(Response, "response", published.append, 5000, raw=True)
        graph.until_matched("plant", response=1)
        client.subscribe(response, description)
        graph.until(lambda: len(client.messages[response]) > 20, "messages")
        passed_on = [payload for _, payload in client.messages[response]]
        graph.until(lambda: set(passed_on) <= set(published), "the same messages, byte for byte")
        samples = [deserialize_message(payload, Response) for payload in passed_on]
        numbers = [sample.sequence for sample in samples]
        assert numbers == sorted(set(numbers))
        graph.until(lambda: client.messages[description], "a message from before it subscribed")
    # a later client gets it, too
    with FoxgloveClient(port) as client:
        graph.until(lambda: description in client.channels, "the topic")
        client.subscribe(description)
        graph.until(lambda: client.messages[description], "the robot description")
        (_, payload) = client.messages[description][0]
        assert deserialize_message(payload, String).data.startswith('<?xml version="1.0"?>\n<robot name="ncree')
    assert graph.stop("viewer") == 0


@pytest.mark.usefixtures("domain")
def test_a_campaign_that_is_watched_has_a_page_meanwhile_and_says_where(capsys: pytest.CaptureFixture) -> None:
    rig_file = find_file("five_storey", "abrace_plant", "config", ".yaml", "rig")
    with watched("/day", rig_file, ["port:=0"]):
        page = re.match(r"watch: (\S+)", capsys.readouterr().err)[1]
        with urllib.request.urlopen(page) as answer:
            assert b"<canvas" in answer.read()
        with urllib.request.urlopen(f"{page}foxglove.json") as answer:
            assert "/day/response.displacement[4]" in answer.read().decode()
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(page)


def test_the_bag_of_the_last_test_is_shown_afterwards(tmp_path: Path) -> None:
    assert last_bag(tmp_path, ["noise"]) is None
    (tmp_path / "nodes").mkdir()
    for step in ("noise", "quake"):
        parameter_file(tmp_path / f"nodes/{step}_logger.yaml", {"output": f"/bags/{step}"})
    assert last_bag(tmp_path, ["noise", "quake", "model"]) == Path("/bags/quake")
