# SPDX-License-Identifier: Apache-2.0
"""`replay`: the messages of a bag again as they were, and a controller that answers them as it did then."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rclpy
from ament_index_python.packages import get_package_share_directory
from rclpy.serialization import serialize_message
from rosbags.interfaces import QosDurability
from std_msgs.msg import String

from abrace import design as design_proven
from abrace import simulate
from abrace_bags import DEFAULT_QOS, Bag, BagWriter, message_definition, read_run
from abrace_bags.nodes.replay import Replay
from abrace_core.model.controller_file import Controller, save_controller
from abrace_core.model.table_signals import table_noise
from abrace_interfaces.msg import BraceCommand, Response
from abrace_lqg.design import design
from abrace_lqg.weights import load_weights
from abrace_node.transport import TRANSIENT_LOCAL_QOS
from abrace_plant.rig.file import load_rig

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


SAMPLES = 1000
BEFORE = 300
"""Samples of the run that are not of the test: the rig arms and fades in first."""
STEP = 20_000_000
LIMIT = 4e3


def end_of_replay(graph: Any, expected: str) -> int:
    """Wait for its end, and look for a text in its output."""
    code = graph.ended("replay")
    assert any(expected in line for line in graph.output_of("replay")), graph.output_of("replay")
    assert "Traceback" not in "\n".join(graph.output_of("replay"))
    return int(code)


def listen_raw(graph: Any, message_type: type, topic: str) -> list[bytes]:
    """Subscribe; the bytes of the messages come into the list that is returned."""
    payloads: list[bytes] = []
    graph.node.create_subscription(message_type, topic, payloads.append, 5000, raw=True)
    return payloads


@pytest.fixture(scope="module")
def controller(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of LQG3, designed for the rig itself; of small force, so that much of what it wants is cut."""
    rig = load_rig(f"{get_package_share_directory('abrace_plant')}/config/ncree_three_storey.yaml")
    weights = load_weights(f"{get_package_share_directory('abrace_lqg')}/config/lqg3.yaml")
    made = design(rig.model, weights, 0.002)
    path = tmp_path_factory.mktemp("controller") / "lqg3.yaml"
    limit = np.array([LIMIT])
    save_controller(
        Controller("lqg3", made.controller, made.correction, made.prediction, limit, "rig", "lqg3", "none"), path
    )
    return path


@pytest.fixture(scope="module")
def run(new_graph: Callable, controller: Path) -> tuple[Path, str]:
    """The bag of a controlled run in lockstep, and its namespace."""
    with new_graph() as graph:
        bag = graph.folder / "bag"
        graph.start("logger", output=str(bag), topics=["response", "brace_command", "ground_motion"])
        lockstep = {"lockstep": True, "wait_for": ["brace_command", "ground_motion"]}
        graph.start("plant", autostart=False, duration=(SAMPLES + BEFORE) * 0.002, seed=3, **lockstep)
        graph.start("ground_motion", record="white_noise", duration=SAMPLES * 0.002, rms=0.3, band=[0.5, 10.0])
        graph.start("controller", "--params-file", controller)
        graph.run_to_the_end()
        return bag, graph.namespace


def test_a_controller_of_a_fifth_of_the_rigs_rate_commands_what_was_simulated(graph: Any, tmp_path: Path) -> None:
    made = design_proven("ncree_three_storey", "lqg3", sample_period=0.01, force_limit=[LIMIT])
    made.save(tmp_path / "slower.yaml")
    bag = graph.folder / "bag"
    graph.start("logger", output=str(bag), topics=["response", "brace_command", "ground_motion"])
    lockstep = {"lockstep": True, "wait_for": ["brace_command", "ground_motion"]}
    graph.start("plant", autostart=False, duration=(SAMPLES + BEFORE) * 0.002, seed=3, **lockstep)
    graph.start("ground_motion", record="white_noise", duration=SAMPLES * 0.002, rms=0.3, band=[0.5, 10.0])
    graph.start("controller", "--params-file", tmp_path / "slower.yaml")
    graph.run_to_the_end()
    recorded, topics = read_run(bag), Bag(bag).arrays()
    begin = int(np.argmax(topics[f"{graph.namespace}/response"].fields["state"] == Response.RUNNING))
    answered = topics[f"{graph.namespace}/brace_command"].fields["sequence"]
    np.testing.assert_array_equal(answered, np.arange(SAMPLES + BEFORE), "no sample is unanswered")
    noise = table_noise(SAMPLES, 500.0, (0.5, 10.0), 0.3, 1)
    simulated = simulate("ncree_three_storey", noise, controller=tmp_path / "slower.yaml", seed=3)
    for name in ("outputs", "ground_acceleration", "command"):
        part = getattr(recorded, name)[begin : begin + SAMPLES]
        np.testing.assert_array_equal(getattr(simulated, name), part, err_msg=name)
    assert not (np.diff(np.flatnonzero(np.diff(simulated.command[:, 0]))) % 5).any(), "held in between"
    assert np.abs(simulated.command).max() == LIMIT


def text(words: str) -> bytes:
    """A message; of a whole number of four bytes, to which the middleware would fill it up."""
    return bytes(serialize_message(String(data=words)))


@pytest.fixture
def texts(tmp_path: Path) -> Path:
    """A bag of a text on /lab/title, which is transient local, and 0.1 s later ten on /lab/note, 20 ms apart."""
    definition = message_definition("std_msgs/msg/String")
    arguments = ("std_msgs/msg/String", definition.text, definition.type_hash)
    transient_local = DEFAULT_QOS._replace(durability=QosDurability.TRANSIENT_LOCAL, depth=1)
    with BagWriter(tmp_path / "texts", {}) as bag:
        note = bag.add_topic("/lab/note", *arguments)
        title = bag.add_topic("/lab/title", *arguments, transient_local)
        bag.write(title, text("the title"), 10**9 - 5 * STEP, 10**9)
        for k in range(10):
            bag.write(note, text(f"words {k}"), 10**9 + k * STEP, 10**9)
    return tmp_path / "texts"


def test_the_same_test_in_python_gives_every_recorded_number(run: tuple[Path, str], controller: Path) -> None:
    recorded = read_run(run[0])
    states = Bag(run[0]).arrays()[f"{run[1]}/response"].fields["state"]
    begin = int(np.argmax(states == Response.RUNNING))
    assert 250 <= begin < BEFORE
    noise = table_noise(SAMPLES, 500.0, (0.5, 10.0), 0.3, 1)
    simulated = simulate("ncree_three_storey", noise, controller=controller, seed=3)
    for name in ("outputs", "ground_acceleration", "command", "clipped"):
        part = getattr(recorded, name)[begin : begin + SAMPLES]
        np.testing.assert_array_equal(getattr(simulated, name), part, err_msg=name)
    assert np.abs(recorded.command).max() == LIMIT, "much of what it wants is cut"


def test_a_controller_answers_the_recorded_responses_with_the_recorded_commands_to_the_last_bit(
    graph: Any, run: tuple[Path, str], controller: Path
) -> None:
    bag, namespace = run
    recorded = [message.payload for message in Bag(bag).raw(["brace_command"])]
    assert len(recorded) == SAMPLES + BEFORE
    force = Bag(bag).arrays()[f"{namespace}/brace_command"].fields["force"][:, 0]
    assert 50 < np.sum(np.abs(force) == LIMIT) < SAMPLES - 500, "some of the commands are cut, most are not"
    commands = listen_raw(graph, BraceCommand, "brace_command")
    graph.start("controller", "--params-file", controller)
    graph.until_matched("controller", brace_command=1)
    graph.may_end.add("replay")
    graph.start("replay", "-r", f"{namespace}/response:=response", bag=str(bag), lockstep=True)
    assert end_of_replay(graph, f"done: {SAMPLES + BEFORE} messages") == 0
    left_out = f"{namespace}/brace_command, {namespace}/ground_motion left out: they command a rig"
    assert left_out in graph.output_of("replay")[0]
    graph.until(lambda: len(commands) >= SAMPLES + BEFORE, "all commands")
    assert commands == recorded


def test_a_lockstep_replay_begins_when_a_commander_has_subscribed_to_the_samples(
    graph: Any, run: tuple[Path, str], context: rclpy.Context
) -> None:
    bag, namespace = run
    onlooker = listen_raw(graph, Response, "response")
    hand = rclpy.create_node("hand", namespace=graph.namespace, context=context)
    hand.create_publisher(BraceCommand, "brace_command", 10)
    remap = ("-r", f"{namespace}/response:=response")
    graph.start("replay", *remap, bag=str(bag), topics=["response"], lockstep=True)
    graph.until_matched("replay", **{f"{namespace}/response": 1, f"{graph.namespace}/brace_command": 1})
    for _ in range(2):
        graph.until_well("replay")
    assert graph.statuses["replay"].message == "waiting for the controller"
    assert not onlooker
    hand.create_subscription(Response, "response", print, 10)
    graph.until(lambda: onlooker, "the first sample")
    assert graph.stop("replay") == 0
    hand.destroy_node()


def test_responses_are_not_replayed_where_a_rig_publishes_them(graph: Any, run: tuple[Path, str]) -> None:
    bag, namespace = run
    graph.start("replay", "-r", f"{namespace}/response:=response", bag=str(bag), rate=0.01)
    graph.until_matched("replay", **{f"{namespace}/response": 0})
    graph.may_end.add("replay")
    graph.publisher(Response, "response", subscribers=0)
    assert end_of_replay(graph, f"{graph.namespace}/response is published by ") == 1
    # a publisher may be discovered a moment before the name of its node
    (named,) = (line for line in graph.output_of("replay") if " is published by " in line)
    assert any(f" by {name} as well" in named for name in (f"{graph.namespace}/test", "another node"))


def test_a_response_without_an_answer_ends_a_lockstep_replay(graph: Any, run: tuple[Path, str]) -> None:
    bag, namespace = run
    graph.publisher(BraceCommand, "brace_command", subscribers=0)
    responses = graph.listen(Response, "response")
    remap = ("-r", f"{namespace}/response:=response")
    graph.may_end.add("replay")
    graph.start("replay", *remap, bag=str(bag), topics=["response"], lockstep=True, lockstep_timeout=0.1)
    assert end_of_replay(graph, f"no answer to sample 0 on {graph.namespace}/brace_command within 0.1 s") == 1
    assert [response.sequence for response in responses] in ([], [0])


def test_every_message_comes_again_as_it_was_and_a_transient_local_one_to_a_late_subscriber(
    graph: Any, texts: Path
) -> None:
    notes = listen_raw(graph, String, "words")
    remap = ("-r", "/lab/note:=words", "-r", "/lab/title:=title")
    graph.may_end.add("replay")
    graph.start("replay", *remap, bag=str(texts), rate=0.05)
    graph.until(lambda: notes, "the first word")
    title = graph.listen(String, "title", TRANSIENT_LOCAL_QOS)
    graph.until(lambda: title, "the title")
    assert title[0].data == "the title"
    assert end_of_replay(graph, "done: 11 messages") == 0
    graph.until(lambda: len(notes) >= 10, "the last word")
    assert notes == [text(f"words {k}") for k in range(10)]


def test_the_bag_s_time_begins_with_the_first_tick(domain: int, texts: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = ["replay", "--ros-args", "-p", f"bag:={texts}"]
    monkeypatch.setattr("sys.argv", arguments)
    rclpy.init(args=arguments, domain_id=domain)
    replay = Replay()
    try:
        assert replay.due is not None
        time.sleep(0.2)
        replay.tick()
        assert replay.playback.played == 1, "time passed until the first tick: it is not made up for in a burst"
        assert replay.due > time.monotonic()
    finally:
        replay.destroy_node()
        rclpy.shutdown()


def written(folder: Path, topic: str, type_name: str, payload: bytes) -> Path:
    """A bag of one message."""
    definition = message_definition(type_name)
    with BagWriter(folder / "odd", {}) as bag:
        bag.write(bag.add_topic(topic, type_name, definition.text, definition.type_hash), payload, 1, 1)
    return folder / "odd"


@pytest.mark.parametrize(
    ("topic", "payload", "code", "complaint"),
    [
        ("/odd name", b"\0\1\0\0\1", 2, "topic /odd name: Invalid topic name"),
        ("/odd", b"\0\1\0\0" + b"\1" * 300, 1, "topic /odd: a message of 304 bytes can't be published"),
    ],
)
def test_what_the_middleware_or_a_rig_must_not_have_is_said(
    graph: Any, tmp_path: Path, topic: str, payload: bytes, code: int, complaint: str
) -> None:
    bag = written(tmp_path, topic, "std_msgs/msg/Bool", payload)
    graph.may_end.add("replay")
    graph.start("replay", bag=str(bag))
    assert end_of_replay(graph, complaint) == code


def test_a_response_that_cannot_be_read_ends_a_lockstep_replay(graph: Any, tmp_path: Path) -> None:
    graph.may_end.add("replay")
    graph.start("replay", bag=str(written(tmp_path, "/r", "abrace_interfaces/msg/Response", b"cut")), lockstep=True)
    graph.publisher(BraceCommand, "/brace_command", subscribers=0)
    graph.node.create_subscription(Response, "/r", print, 10)
    assert end_of_replay(graph, "message: expected a stamped message in little-endian CDR") == 1
