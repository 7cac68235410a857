# SPDX-License-Identifier: Apache-2.0
"""A lockstep run: every sample recorded, each command in force when it should be, the same each time."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import AccelStamped
from rosbags.highlevel import AnyReader
from running_graph import STREAM

from abrace_bags import Bag, read_run
from abrace_core.model.controller_file import Controller, save_controller
from abrace_core.model.linear_model import LinearModel
from abrace_interfaces.msg import BraceCommand, Response
from abrace_node.node import ACKNOWLEDGEMENT_TIMEOUT
from abrace_node.transport import lockstep_environment

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

SAMPLES = 1000
SEED = 5
PERIOD = 2_000_000
TOPICS = ("response", "brace_command", "ground_motion")
SLOW = 300.0
"""Seconds for some thousand samples on a machine that has much else to do."""


def record(graph: Any) -> Path:
    """A run of 2 s with noise on both inputs, started as `abrace campaign` does: the rig last, all being matched."""
    bag = graph.folder / "bag"
    graph.start("logger", output=str(bag), topics=list(TOPICS), facts=["sample_period=0.002"])
    graph.start("plant", autostart=False, lockstep=True, wait_for=list(TOPICS[1:]), duration=2.0, seed=SEED)
    graph.start("ground_motion", record="white_noise", duration=2.0)
    graph.start("excitation", duration=2.0)
    graph.run_to_the_end()
    assert graph.output_of("plant")[-1].startswith("plant: done: 1000 samples")
    return bag


@pytest.fixture(scope="module")
def bags(new_graph: Callable) -> list[Path]:
    """The bags of two such runs."""
    made = []
    for _ in range(2):
        with new_graph() as graph:
            made.append(record(graph))
    return made


@contextlib.contextmanager
def held_up(process: int) -> Iterator[None]:
    """Let a process run for 10 ms of each 0.4 s: one that stands still for a second Fast DDS takes for dead."""
    done = threading.Event()

    def hold() -> None:
        while not done.is_set():
            os.kill(process, signal.SIGSTOP)
            done.wait(0.4)
            os.kill(process, signal.SIGCONT)
            done.wait(0.01)

    holding = threading.Thread(target=hold)
    holding.start()
    try:
        yield
    finally:
        done.set()
        holding.join()


@pytest.mark.parametrize("duration", [16.0, 2.0], ids=["meanwhile", "at the end"])
def test_the_rig_waits_for_a_logger_that_is_behind(graph, monkeypatch, duration):
    """A logger that hardly runs for longer than a node's end takes, in a run or at its end, misses no sample."""
    for name, value in lockstep_environment().items():
        monkeypatch.setenv(name, value)
    bag, samples = graph.folder / "bag", round(500 * duration)
    responses = graph.listen(Response, "response")
    graph.start("logger", output=str(bag), topics=list(TOPICS), lockstep=True)
    lockstep = {"lockstep": True, "wait_for": list(TOPICS[1:])}
    graph.start("plant", autostart=False, duration=duration, seed=SEED, **lockstep)
    graph.start("ground_motion", record="white_noise", duration=duration)
    graph.start("excitation", duration=duration)
    assert graph.change_state("plant", "configure")
    graph.until_matched("plant", response=4, brace_command=1, ground_motion=1)
    for name, answers in (("excitation", "brace_command"), ("ground_motion", "ground_motion")):
        graph.until_matched(name, response=1, **{answers: 2})
    graph.until_matched("logger", response=1, brace_command=1, ground_motion=1)
    with held_up(graph.started["logger"].group):
        began = time.monotonic()
        graph.may_end.add("plant")
        assert graph.change_state("plant", "activate")
        graph.play("excitation", "ground_motion")
        graph.until(lambda: responses and responses[-1].sequence >= 100, "sample 100", SLOW)
        graph.until(lambda: time.monotonic() > began + ACKNOWLEDGEMENT_TIMEOUT + 1.0, "the logger to be behind")
        # what the shorter run has sent the logger's middleware has got: it remains to be recorded
        assert len(responses) < samples or duration == 2.0, "the rig waits"
    assert graph.ended("plant", SLOW) == 0
    for name in ("excitation", "ground_motion", "logger"):
        assert graph.stop(name) == 0
    recorded = fields(bag)
    for topic in ("response", "brace_command"):
        np.testing.assert_array_equal(recorded[topic]["sequence"], np.arange(samples), err_msg=topic)
    assert len(recorded["ground_motion"]["accel.linear.x"]) == samples


def fields(bag: Path) -> dict[str, dict[str, np.ndarray]]:
    """The fields of each topic, by the last part of its name."""
    opened = Bag(bag)
    contents = opened.arrays()
    assert opened.warnings == ()
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


def test_the_bag_is_a_run_of_the_rig(bags):
    run = read_run(bags[0])
    assert (len(run.sequence), run.floors, run.groups, run.sample_period) == (SAMPLES, 3, 1, 0.002)
    assert Bag(bags[0]).facts["sample_period"] == "0.002"
    assert (bags[0] / "metadata.yaml").is_file()


def test_a_missing_answer_ends_the_run_and_is_named(graph):
    graph.start("plant", lockstep=True, wait_for=list(TOPICS[1:]), lockstep_timeout=0.5)
    graph.start("ground_motion")
    responses = graph.listen(Response, "response")
    graph.publisher(BraceCommand, "brace_command")
    assert graph.ended("plant") == 1
    (line,) = graph.output_of("plant")
    assert line.startswith("[ERROR]")
    assert line.endswith("no answer to sample 0 on brace_command within 0.5 s (lockstep_timeout)")
    assert [message.sequence for message in responses] == [0]


class Answers:
    """Answers of the test itself to each sample, on `brace_command` or `ground_motion`, from its n-th message on."""

    def __init__(self, graph: Any, message_type: type, topic: str, begin: int) -> None:
        self.responses: list[Response] = []
        self.begin, self.type = begin, message_type
        graph.node.create_subscription(Response, "response", self.answer, STREAM)
        self.publisher = graph.publisher(message_type, topic)

    def answer(self, response: Response) -> None:
        self.responses.append(response)
        if len(self.responses) >= self.begin:
            answer = self.type(header=response.header)
            if self.type is BraceCommand:
                answer.run, answer.sequence, answer.force = response.run, response.sequence, [0.0]
            self.publisher.publish(answer)


def test_a_first_sample_whose_answer_was_lost_is_said_again_until_it_is_answered(graph):
    graph.start("plant", autostart=False, lockstep=True, duration=0.2)
    assert graph.change_state("plant", "configure")
    answers = Answers(graph, BraceCommand, "brace_command", begin=3)
    graph.until_matched("plant", response=1, brace_command=1)
    graph.may_end.add("plant")
    assert graph.change_state("plant", "activate")
    assert graph.ended("plant") == 0, graph.output_of("plant")
    first, second, third = answers.responses[:3]
    assert first.sequence == 0
    assert first == second == third
    numbers = [one.sequence for one in answers.responses]
    assert [number for number in numbers if number] == list(range(1, 100)), "each of the others once"


def test_a_first_sample_that_is_said_again_changes_nothing_in_the_bag(new_graph, tmp_path):
    """With the real controller, which answers it twice; the table's answer is the one that was lost."""
    law = LinearModel([[0.5]], [[0.5]], [[1000.0]], [[0.0]], ("a1",), ("U",), 0.002)
    file = tmp_path / "law.yaml"
    save_controller(
        Controller("law", law, np.zeros((1, 1)), np.zeros((1, 2)), np.array([20e3]), "none", "none", "none"), file
    )
    recorded = []
    for begin in (1, 3):
        with new_graph() as graph:
            bag = graph.folder / "bag"
            graph.start("logger", output=str(bag), topics=list(TOPICS))
            graph.start("plant", autostart=False, lockstep=True, wait_for=list(TOPICS[1:]), duration=1.0, seed=SEED)
            graph.start("controller", "--params-file", file)
            commands = graph.listen(BraceCommand, "brace_command")
            assert graph.change_state("plant", "configure")
            answers = Answers(graph, AccelStamped, "ground_motion", begin)
            graph.until_matched("plant", response=3, brace_command=1, ground_motion=1)
            graph.until_matched("controller", response=1, brace_command=3)
            graph.until_matched("logger", response=1, brace_command=1, ground_motion=1)
            graph.may_end.add("plant")
            assert graph.change_state("plant", "activate")
            assert graph.ended("plant") == 0, graph.output_of("plant")
            run = answers.responses[0].run.to_bytes(8, "little")
            assert graph.values("controller")["old"] == "0"
            for name in ("controller", "logger"):
                assert graph.stop(name) == 0, graph.output_of(name)
            again = [one.sequence for one in commands].count(0) - 1
            assert (again >= 2) is (begin == 3), "it was answered again"
        with AnyReader([bag]) as reader:
            messages = [(connection.topic, raw.replace(run, bytes(8))) for connection, _, raw in reader.messages()]
        by_topic = {name: [raw for topic, raw in messages if topic.endswith(name)] for name in TOPICS}
        assert [len(by_topic[name]) for name in TOPICS] == [500] * 3
        recorded.append(by_topic)
        assert np.abs(fields(bag)["brace_command"]["force"]).max() > 0
    assert recorded[0] == recorded[1]


def test_the_first_sample_waits_for_a_node_that_gets_and_answers_it(graph, domain):
    """One that listens and another that could answer are none: the first sample would be lost to who joins then."""
    context = rclpy.Context()
    context.init(domain_id=domain)
    graph.start("plant", lockstep=True, duration=1.0)
    responses = graph.listen(Response, "response")
    deaf = rclpy.create_node("deaf", namespace=graph.namespace, context=context)
    deaf.create_publisher(BraceCommand, "brace_command", 10)
    deaf.create_subscription(BraceCommand, "response", lambda _: None, 10)  # of another type: it gets none
    graph.until_matched("plant", response=1, brace_command=1)
    assert "plant: waiting for a node that gets response and publishes brace_command" in graph.reported()
    graph.start("excitation")
    graph.may_end.add("plant")
    graph.play("excitation")
    assert graph.ended("plant") == 0, graph.output_of("plant")
    graph.until(lambda: len(responses) >= 500, "all samples")
    deaf.destroy_node()
    context.try_shutdown()


def test_an_answer_to_an_earlier_run_neither_ends_nor_begins_the_next_one(graph):
    graph.start("plant", lockstep=True, wait_for=list(TOPICS[1:]), duration=1.0)
    responses = graph.listen(Response, "response")
    graph.publisher(BraceCommand, "brace_command").publish(BraceCommand(run=1, sequence=9, force=[0.0]))
    graph.until(
        lambda: graph.values("plant").get("answers_to_unknown_samples") == "1", "the old answer in the diagnostics"
    )
    assert graph.state("plant") == "active"
    assert not responses, "nobody plays the table's motion yet"


def test_a_run_that_ends_with_a_fault_is_not_done(graph):
    graph.start("plant", lockstep=True, wait_for=["ground_motion"], duration=1.0, sensor_faults=["a1=stuck@0.8"])
    graph.start("ground_motion", record="white_noise", duration=4.0)
    graph.may_end.add("plant")
    graph.play("ground_motion")
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
    for run in range(1, 4):
        count = len(responses) + 100
        assert graph.change_state("plant", "activate")
        graph.play("excitation")
        graph.until(lambda count=count: len(responses) > count, "samples")
        assert graph.change_state("plant", "deactivate")
        graph.until(lambda: responses[-1].flags & Response.LAST, "the last sample")
        assert sum(bool(one.flags & Response.LAST) for one in responses) == run
