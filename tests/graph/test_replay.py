"""`replay`: the messages of a bag again as they were, and a controller that answers them as it did then."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from abrace_core.bag import BagWriter, message_definition
from abrace_core.bag.raw_messages import read_raw
from abrace_core.controller_file import Controller, save_controller
from abrace_core.linear_model import LinearModel
from abrace_core.node import LATCHED_QOS
from abrace_interfaces.msg import BraceCommand, Response

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


SAMPLES = 1000
STEP = 20_000_000


def end_of_replay(graph: Any, said: str) -> int:
    """Wait for its end, and look at what it said last."""
    code = graph.ended("replay")
    assert any(said in line for line in graph.said("replay")), graph.said("replay")
    assert "Traceback" not in "\n".join(graph.said("replay"))
    return int(code)


def listen_raw(graph: Any, message_type: type, topic: str) -> list[bytes]:
    """Subscribe; the bytes of the messages come into the list that is returned."""
    payloads: list[bytes] = []
    graph.node.create_subscription(message_type, topic, payloads.append, 5000, raw=True)
    return payloads


@pytest.fixture(scope="module")
def controller(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a law with a memory, that takes three accelerations."""
    law = LinearModel(
        [[0.9, 0.2], [-0.2, 0.9]], [[0.1, 0.0, 0.3], [0.0, 0.2, 0.1]], [[300.0, -200.0]], [[50.0, 0.0, 0.0]],
        ("a1", "a2", "a3"), ("U",), 0.002,
    )  # fmt: skip
    path = tmp_path_factory.mktemp("controller") / "memory.yaml"
    limit = np.array([20e3])
    save_controller(Controller("memory", law, np.zeros((2, 1)), np.zeros((3, 3)), limit, "none", "none", "none"), path)
    return path


@pytest.fixture(scope="module")
def run(new_graph: Callable, controller: Path) -> tuple[Path, str]:
    """The bag of a controlled run in lockstep, and its namespace."""
    with new_graph() as graph:
        bag = graph.folder / "bag"
        graph.start("logger", output=str(bag), topics=["response", "brace_command"])
        graph.start(
            "plant", autostart=False, lockstep=True, wait_for=["brace_command", "ground_motion"],
            duration=SAMPLES * 0.002, seed=3,
        )  # fmt: skip
        graph.start("ground_motion", record="white_noise", duration=SAMPLES * 0.002, rms=1.0)
        graph.start("controller", "--params-file", controller)
        assert graph.change_state("plant", "configure")
        graph.until_matched("plant", response=3, brace_command=1, ground_motion=1)
        graph.until_matched("controller", response=1, brace_command=2)
        graph.until_matched("ground_motion", response=1)
        graph.until_matched("logger", response=1, brace_command=1)
        graph.may_end.add("plant")
        assert graph.change_state("plant", "activate")
        assert graph.ended("plant") == 0
        for name in ("controller", "ground_motion", "logger"):
            assert graph.stop(name) == 0
        return bag, graph.namespace


def text(words: str) -> bytes:
    """A message; of a whole number of four bytes, to which the middleware would fill it up."""
    return bytes(serialize_message(String(data=words)))


@pytest.fixture
def texts(tmp_path: Path) -> Path:
    """A bag of ten texts on /lab/said, 20 ms apart, and one latched on /lab/title."""
    definition = message_definition("std_msgs/msg/String")
    arguments = ("std_msgs/msg/String", definition.text, definition.type_hash)
    with BagWriter(tmp_path / "texts", {}) as bag:
        said = bag.add_topic("/lab/said", *arguments)
        title = bag.add_topic("/lab/title", *arguments, {"durability": "transient_local", "depth": 1})
        bag.write(title, text("the title"), 10**9, 10**9)
        for k in range(10):
            bag.write(said, text(f"words {k}"), 10**9 + k * STEP, 10**9)
    return tmp_path / "texts"


def test_a_controller_answers_the_recorded_responses_with_the_recorded_commands_to_the_last_bit(
    graph: Any, run: tuple[Path, str], controller: Path
) -> None:
    bag, namespace = run
    recorded = [message.payload for message in read_raw(bag, ["brace_command"]).messages]
    assert len(recorded) == SAMPLES
    assert len({payload[-8:] for payload in recorded}) > SAMPLES // 2, "the commands are none to speak of"
    commands = listen_raw(graph, BraceCommand, "brace_command")
    graph.start("controller", "--params-file", controller)
    remap = ["-r", f"{namespace}/response:=response"]
    graph.start("replay", *remap, bag=str(bag), topics=["response"], lockstep=True, start_paused=True)
    graph.until_matched("controller", response=1, brace_command=2)
    graph.until_matched("replay", **{f"{namespace}/response": 1, f"{graph.namespace}/brace_command": 1})
    for count in (1, 2, 3):
        assert graph.call(Trigger, "replay/step", Trigger.Request()).success
        graph.until(lambda count=count: len(commands) >= count, "the answer to a step")
    assert len(commands) == 3
    graph.may_end.add("replay")
    graph.call(SetBool, "replay/pause", SetBool.Request(data=False))
    assert end_of_replay(graph, f"done: {SAMPLES} messages") == 0
    graph.until(lambda: len(commands) >= SAMPLES, "all commands")
    assert commands == recorded


def test_a_response_without_an_answer_ends_a_lockstep_replay(graph: Any, run: tuple[Path, str]) -> None:
    bag, namespace = run
    graph.publisher(BraceCommand, "brace_command", subscribers=0)
    responses = graph.listen(Response, "response")
    remap = ("-r", f"{namespace}/response:=response")
    graph.may_end.add("replay")
    graph.start("replay", *remap, bag=str(bag), topics=["response"], lockstep=True, lockstep_timeout=0.1)
    assert end_of_replay(graph, f"no answer to sample 0 on {graph.namespace}/brace_command within 0.1 s") == 1
    assert [response.sequence for response in responses] in ([], [0])


def test_every_message_comes_again_as_it_was_and_the_latched_one_to_who_comes_late(graph: Any, texts: Path) -> None:
    said = listen_raw(graph, String, "words")
    clock = graph.listen(Clock, "/clock")
    remap = ("-r", "/lab/said:=words", "-r", "/lab/title:=title")
    graph.start("replay", *remap, bag=str(texts), start_paused=True, clock=True, rate=0.5)
    graph.until_matched("replay", **{"/lab/said": 1})
    assert graph.call(Trigger, "replay/step", Trigger.Request()).success
    assert graph.call(Trigger, "replay/step", Trigger.Request()).success
    graph.until(lambda: len(said) == 1, "the first word")
    title = graph.listen(String, "title", LATCHED_QOS)
    graph.until(lambda: title, "the latched title")
    assert title[0].data == "the title"
    assert graph.call(SetBool, "replay/pause", SetBool.Request(data=True)).message == "paused"
    graph.until(lambda: clock, "the bag's time")
    assert {message.clock.sec for message in clock} == {1}
    assert {message.clock.nanosec for message in clock} == {0}
    graph.may_end.add("replay")
    assert graph.call(SetBool, "replay/pause", SetBool.Request(data=False)).message == "playing"
    assert end_of_replay(graph, "done: 11 messages") == 0
    graph.until(lambda: len(said) >= 10, "the last word")
    assert said == [text(f"words {k}") for k in range(10)]
    times = [message.clock.sec * 10**9 + message.clock.nanosec for message in clock]
    assert times == sorted(times)
    assert times[-1] <= 10**9 + 9 * STEP


def test_a_loop_goes_on_until_a_signal_ends_it(graph: Any, texts: Path) -> None:
    said = listen_raw(graph, String, "/lab/said")
    graph.start("replay", bag=str(texts), topics=["said"], loop=True, rate=20.0)
    graph.until(lambda: len(said) > 50, "the fifth round")
    first = int(said[0][14:15])
    assert said == [text(f"words {(first + k) % 10}") for k in range(len(said))]
    assert not graph.call(Trigger, "replay/step", Trigger.Request()).success
    assert graph.stop("replay") == 0
    assert "stopped after" in graph.said("replay")[-1]


@pytest.mark.parametrize(
    ("parameters", "complaint"),
    [
        ({"topics": ["sang"]}, "no topic sang in it, it has /lab/said, /lab/title"),
        ({"start_offset": 3.0}, "there is no message from 3 s to the end"),
        ({"lockstep": True}, "0 topics of abrace_interfaces/msg/Response to replay (none), expected one"),
        ({"rate": 0.0}, "parameter rate"),
    ],
)
def test_what_cannot_be_replayed_is_refused_in_one_line(
    graph: Any, texts: Path, parameters: dict[str, Any], complaint: str
) -> None:
    graph.may_end.add("replay")
    graph.start("replay", bag=str(texts), **parameters)
    assert end_of_replay(graph, complaint) == 2
    assert len(graph.said("replay")) == 1


def test_a_bag_that_is_not_there_is_refused_in_one_line(graph: Any) -> None:
    graph.may_end.add("replay")
    graph.start("replay", bag="nowhere")
    assert end_of_replay(graph, "nowhere: no such bag") == 2
    assert len(graph.said("replay")) == 1


def test_a_type_that_is_not_installed_is_refused_in_one_line(graph: Any, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "odd", {}) as bag:
        bag.write(bag.add_topic("/odd", "odd_msgs/msg/Odd", "int8 x\n", ""), b"\0\1\0\0\1", 1, 1)
    graph.may_end.add("replay")
    graph.start("replay", bag=str(tmp_path / "odd"))
    assert end_of_replay(graph, "topic /odd: message type odd_msgs/Odd is not installed") == 2
    assert len(graph.said("replay")) == 1
