# SPDX-License-Identifier: Apache-2.0
"""A lockstep run: every sample recorded, each command in force when it should be, the same each time."""

from __future__ import annotations

import os
import signal
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from ament_index_python.packages import get_package_share_directory
from rcl_interfaces.msg import Log
from rosbags.highlevel import AnyReader
from simulated_loop import RUN, simulated_loop

from abrace_bags import read_facts, read_run, read_topics
from abrace_interfaces.msg import BraceCommand, Response
from abrace_plant.rig.file import load_rig

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

SAMPLES = 2000
SEED = 5
PERIOD = 2_000_000
TOPICS = ("response", "brace_command", "ground_motion")


def record(graph: Any) -> Path:
    """A run of 4 s with noise on both inputs, started as `abrace campaign` does: the rig last, all being matched."""
    bag = graph.folder / "bag"
    graph.start("logger", output=str(bag), topics=list(TOPICS), facts=["sample_period=0.002"])
    graph.start("plant", autostart=False, lockstep=True, wait_for=list(TOPICS[1:]), duration=4.0, seed=SEED)
    graph.start("ground_motion", record="white_noise", duration=4.0)
    graph.start("excitation", duration=4.0)
    assert graph.change_state("plant", "configure")
    graph.until_matched("plant", response=3, brace_command=1, ground_motion=1)
    graph.until_matched("excitation", response=1, brace_command=2)
    graph.until_matched("ground_motion", response=1, ground_motion=2)
    graph.until_matched("logger", response=1, brace_command=1, ground_motion=1)
    graph.may_end.add("plant")
    assert graph.change_state("plant", "activate")
    assert graph.ended("plant") == 0
    assert graph.output_of("plant")[-1].startswith("plant: done: 2000 samples")
    for name in ("excitation", "ground_motion", "logger"):
        assert graph.stop(name) == 0
    return bag


@pytest.fixture(scope="module")
def bags(new_graph: Callable) -> list[Path]:
    """The bags of two such runs."""
    made = []
    for _ in range(2):
        with new_graph() as graph:
            made.append(record(graph))
    return made


def test_the_rig_waits_for_a_logger_that_is_behind(graph):
    """A logger that stands still for seconds, in which some 10 000 samples would have been taken, misses none."""
    bag = graph.folder / "bag"
    graph.start("logger", output=str(bag), topics=list(TOPICS), lockstep=True)
    graph.start("plant", autostart=False, lockstep=True, wait_for=list(TOPICS[1:]), duration=24.0, seed=SEED)
    graph.start("ground_motion", record="white_noise", duration=24.0)
    graph.start("excitation", duration=24.0)
    assert graph.change_state("plant", "configure")
    graph.until_matched("plant", response=3, brace_command=1, ground_motion=1)
    for name in ("excitation", "ground_motion"):
        graph.until_matched(name, response=1)
    graph.until_matched("logger", response=1, brace_command=1, ground_motion=1)
    graph.may_end.add("plant")
    assert graph.change_state("plant", "activate")
    logger = graph.started["logger"].group
    time.sleep(0.3)
    os.kill(logger, signal.SIGSTOP)
    time.sleep(4.0)
    os.kill(logger, signal.SIGCONT)
    assert graph.ended("plant") == 0
    for name in ("excitation", "ground_motion", "logger"):
        assert graph.stop(name) == 0
    recorded = fields(bag)
    for topic in ("response", "brace_command"):
        np.testing.assert_array_equal(recorded[topic]["sequence"], np.arange(12_000), err_msg=topic)
    assert len(recorded["ground_motion"]["accel.linear.x"]) == 12_000


def fields(bag: Path) -> dict[str, dict[str, np.ndarray]]:
    """The fields of each topic, by the last part of its name."""
    contents = read_topics(bag)
    assert contents.warnings == ()
    return {name.rpartition("/")[2]: topic.fields for name, topic in contents.items()}


def stamps(topic: dict[str, np.ndarray]) -> np.ndarray:
    return topic["header.stamp.sec"].astype(np.int64) * 10**9 + topic["header.stamp.nanosec"]


def test_every_sample_is_recorded_on_every_topic(bags):
    recorded = fields(bags[0])
    assert set(recorded) == set(TOPICS)
    for topic in ("response", "brace_command"):
        np.testing.assert_array_equal(recorded[topic]["sequence"], np.arange(SAMPLES), err_msg=topic)
    for topic in TOPICS:
        np.testing.assert_array_equal(stamps(recorded[topic]), np.arange(SAMPLES) * PERIOD, err_msg=topic)


def test_a_command_from_sample_k_is_in_force_until_sample_k_plus_2(bags):
    recorded = fields(bags[0])
    command, answered = recorded["response"]["command"], recorded["brace_command"]["force"]
    assert np.abs(answered).max() > 1000, "the braces were driven"
    np.testing.assert_array_equal(command[2:], answered[:-2])
    np.testing.assert_array_equal(command[:2], 0.0)


def test_two_runs_give_the_same_bytes(bags):
    def payloads(bag: Path) -> list[bytes]:
        with AnyReader([bag]) as reader:
            chosen = [connection for connection in reader.connections if connection.topic.endswith("/response")]
            return [raw for _, _, raw in reader.messages(chosen)]

    first, second = map(payloads, bags)
    runs = [int(fields(bag)["response"]["run"][0]) for bag in bags]
    assert runs[0] < runs[1]
    numbers = [run.to_bytes(8, "little") for run in runs]
    assert len(first) == SAMPLES
    assert all(raw.count(numbers[0]) == 1 for raw in first)
    assert [raw.replace(*numbers) for raw in first] == second, "but for the number of the run"


def test_readings_are_those_of_the_same_rig_simulated_offline(bags):
    recorded = fields(bags[0])
    response = recorded["response"]
    rig = load_rig(f"{get_package_share_directory('abrace_plant')}/config/ncree_three_storey.yaml")
    loop = simulated_loop(rig, SEED)
    readings, commands = [], []
    inputs = zip(recorded["brace_command"]["force"], recorded["ground_motion"]["accel.linear.x"], strict=True)
    for k, (force, acceleration) in enumerate(inputs):
        sample = loop.step()
        readings.append(sample.reading)
        commands.append(sample.command)
        loop.receive_command(RUN, k, force, "")
        loop.receive_ground_acceleration(sample.stamp, acceleration)
    sizes = (rig.floors, rig.groups, rig.floors, sum(rig.braces_in_group))
    expected = np.split(np.array(readings), np.cumsum(sizes), axis=1)
    for name, values in zip(("displacement", "stroke", "acceleration", "force"), expected, strict=False):
        np.testing.assert_array_equal(response[name], values, err_msg=name)
    np.testing.assert_array_equal(response["ground_acceleration"], expected[-1][:, 0])
    np.testing.assert_array_equal(response["command"], np.array(commands))
    assert np.abs(response["displacement"]).max() > 1e-3, "the building moved"


def test_rosbags_reads_the_values_that_we_read(bags):
    recorded = fields(bags[0])
    vectors = ("braces", "displacement", "acceleration", "stroke", "force", "command")
    seen = dict.fromkeys(TOPICS, 0)
    with AnyReader([bags[0]]) as reader:
        for connection, _, raw in reader.messages():
            topic = connection.topic.rpartition("/")[2]
            k, ours = seen[topic], recorded[topic]
            seen[topic] += 1
            message: Any = reader.deserialize(raw, connection.msgtype)
            assert message.header.stamp.nanosec == ours["header.stamp.nanosec"][k]
            if topic == "ground_motion":
                assert message.accel.linear.x == ours["accel.linear.x"][k]
                continue
            assert message.sequence == ours["sequence"][k]
            for name in vectors if topic == "response" else ("force",):
                np.testing.assert_array_equal(getattr(message, name), ours[name][k])
    assert seen == dict.fromkeys(TOPICS, SAMPLES)


def test_the_bag_is_a_run_of_the_rig(bags):
    run = read_run(bags[0])
    assert (len(run.sequence), run.floors, run.groups, run.sample_period) == (SAMPLES, 3, 1, 0.002)
    assert read_facts(bags[0])["sample_period"] == "0.002"
    assert (bags[0] / "metadata.yaml").is_file()


def test_a_missing_answer_ends_the_run_and_is_named(graph):
    graph.start("plant", lockstep=True, wait_for=list(TOPICS[1:]), lockstep_timeout=0.5)
    graph.start("ground_motion")
    responses, logged = graph.listen(Response, "response"), graph.listen(Log, "/rosout")
    graph.publisher(BraceCommand, "brace_command")
    assert graph.ended("plant") == 1
    (line,) = graph.output_of("plant")
    assert line.startswith("[ERROR]")
    assert line.endswith("no answer to sample 0 on brace_command within 0.5 s (lockstep_timeout)")
    graph.until(lambda: any("no answer to sample 0" in message.msg for message in logged), "it on /rosout")
    assert [message.sequence for message in responses] == [0]


@pytest.mark.parametrize("duration", [0.0, 1.0])
def test_an_answer_to_an_earlier_run_neither_ends_nor_begins_the_next_one(graph, duration):
    graph.start("plant", lockstep=True, wait_for=list(TOPICS[1:]), duration=duration)
    responses = graph.listen(Response, "response")
    graph.publisher(BraceCommand, "brace_command").publish(BraceCommand(run=1, sequence=9, force=[0.0]))
    graph.until(
        lambda: graph.values("plant").get("answers_to_unknown_samples") == "1", "the old answer in the diagnostics"
    )
    assert graph.state("plant") == "active"
    assert not responses, "nobody plays the table's motion yet"


def test_a_run_that_ends_with_a_fault_is_not_done(graph):
    graph.start("plant", lockstep=True, wait_for=["ground_motion"], duration=1.0, sensor_faults=["a1=stuck@0.2"])
    graph.start("ground_motion", record="white_noise", duration=4.0)
    assert graph.ended("plant") == 1
    output = graph.output_of("plant")
    assert not any("done" in line for line in output)
    assert "ended with a fault: a1: stuck at" in output[-1]
    assert "500 samples in " in output[-1]


def test_a_run_that_is_deactivated_has_one_last_sample(graph):
    graph.start("plant", lockstep=True, autostart=False)
    graph.start("excitation", duration=600.0)
    assert graph.change_state("plant", "configure")
    responses = graph.listen(Response, "response")
    graph.until_matched("plant", response=2, brace_command=1)
    for run in range(1, 6):
        count = len(responses) + 100
        assert graph.change_state("plant", "activate")
        graph.until(lambda count=count: len(responses) > count, "samples")
        assert graph.change_state("plant", "deactivate")
        graph.until(lambda: responses[-1].flags & Response.LAST, "the last sample")
        assert sum(bool(one.flags & Response.LAST) for one in responses) == run
