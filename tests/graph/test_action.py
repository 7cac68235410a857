# SPDX-License-Identifier: Apache-2.0
"""The action play_ground_motion: played, cancelled, refused."""

from collections.abc import Iterator

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import AccelStamped
from rclpy.action import ActionClient
from rosbags.rosbag2 import Reader
from running_graph import SLOW, STREAM
from std_srvs.srv import Trigger

from abrace_bags import Bag
from abrace_interfaces.action import PlayGroundMotion
from abrace_interfaces.msg import BraceCommand, Response
from abrace_plant.records.measures import integrate


class Player:
    """A slow rig in lockstep with a table, and a client of its action; every sample is answered with zero force."""

    def __init__(self, graph, **parameters) -> None:
        self.graph = graph
        self.responses, self.feedback = [], []
        self.rig = {"rig": graph.slow_rig()}
        self.start("plant")
        graph.start("ground_motion", **self.rig, **parameters)
        self.braces = graph.publisher(BraceCommand, "brace_command")
        graph.node.create_subscription(Response, "response", self.on_response, STREAM)
        self.played = graph.listen(AccelStamped, "ground_motion")
        self.client = ActionClient(graph.node, PlayGroundMotion, "play_ground_motion")
        graph.until(self.client.server_is_ready, "the action")
        graph.until_matched("ground_motion", response=1)
        self.until_running()

    def start(self, name: str) -> None:
        self.graph.start("plant", name=name, lockstep=True, wait_for=["brace_command", "ground_motion"], **self.rig)

    def until_running(self) -> None:
        self.graph.until(lambda: self.responses and self.responses[-1].state == Response.RUNNING, "the rig to run")

    def on_response(self, sample: Response) -> None:
        self.responses.append(sample)
        self.braces.publish(BraceCommand(run=sample.run, sequence=sample.sequence, force=[0.0]))

    @property
    def ground(self) -> np.ndarray:
        return np.array([response.ground_acceleration for response in self.responses])

    def send(self, **goal):
        future = self.client.send_goal_async(
            PlayGroundMotion.Goal(**goal), feedback_callback=lambda message: self.feedback.append(message.feedback)
        )
        self.graph.until(future.done, "an answer to the goal")
        return future.result()

    def result(self, handle):
        assert handle.accepted, self.graph.reported()
        future = handle.get_result_async()
        self.graph.until(future.done, "the result")
        ended = future.result()
        if ended.result.message.startswith("stopped: "):
            statuses, error = self.graph.statuses, DiagnosticStatus.ERROR
            self.graph.until(lambda: any(one.level == error for one in statuses.values()), "the report of the stop")
            pytest.fail(self.graph.reported())
        return ended


def until_samples(player: Player, count: int) -> None:
    """Wait for so many more samples."""
    more = len(player.responses) + count
    player.graph.until(lambda: len(player.responses) > more, "samples")


@pytest.fixture(scope="module")
def played(new_graph) -> Iterator[Player]:
    """One rig and its table for all goals."""
    with new_graph() as graph:
        yield Player(graph)


@pytest.fixture
def player(played) -> Player:
    """The table at rest, no goal; what is seen begins anew."""
    until_samples(played, 50)
    for seen in (played.responses, played.played, played.feedback):
        seen.clear()
    until_samples(played, 10)
    return played


def test_a_record_is_played_with_feedback_to_its_end(player):
    graph, names = player.graph, [f"play_ground_motion/_action/{topic}" for topic in ("feedback", "status")]
    bag = graph.folder / "bag"
    graph.start("logger", output=str(bag), topics=names)
    graph.until(lambda: all(graph.values("logger").get(f"publishers of {name}") == "1" for name in names), "a match")
    handle = player.send(record="el_centro", peak_acceleration=0.5, duration=3.0)
    assert handle.accepted
    ended = player.result(handle)
    assert ended.status == GoalStatus.STATUS_SUCCEEDED
    assert ended.result.success
    assert ended.result.samples == 3 * SLOW
    elapsed = [feedback.elapsed for feedback in player.feedback]
    assert len(elapsed) > 4
    assert elapsed == sorted(elapsed)
    assert {feedback.duration for feedback in player.feedback} == {3.0}
    assert graph.stop("logger") == 0
    recorded = Bag(bag).arrays()[f"{graph.namespace}/{names[0]}"]
    of_bag = list(recorded.fields["feedback.elapsed"])
    # rclpy's client drops feedback that it reads after the result
    assert of_bag[: len(elapsed)] == elapsed, "hidden topics are recorded by name"
    assert of_bag == sorted(of_bag)
    assert of_bag[-1] > 2.4
    assert {bytes(identifier) for identifier in recorded.fields["goal_id.uuid"]} == {bytes(handle.goal_id.uuid)}
    with Reader(bag) as reader:
        assert {connection.topic for connection in reader.connections} == {
            f"{graph.namespace}/{name}" for name in names
        }
    graph.until(lambda: np.abs(player.ground).max() > 0.49, "the responses until the peak")
    assert np.abs(player.ground).max() == pytest.approx(0.5, abs=0.01)


def test_a_cancelled_motion_comes_smoothly_to_rest(player):
    handle = player.send(record="white_noise", duration=30.0)
    player.graph.until(lambda: np.abs(player.ground[-50:]).max() > 0.1, "motion")
    cancelling = handle.cancel_goal_async()
    player.graph.until(cancelling.done, "the cancelling")
    ended = player.result(handle)
    assert ended.status == GoalStatus.STATUS_CANCELED
    assert "cancelled" in ended.result.message
    assert 0 < ended.result.samples < 30 * SLOW
    until_samples(player, 50)
    assert np.abs(player.ground[-20:]).max() < 0.01, "the table at rest"
    sent = np.array([message.accel.linear.x for message in player.played])
    assert sent[-1] == 0
    assert np.abs(np.diff(sent)).max() < 0.1
    velocity, _ = integrate(sent, 1 / SLOW)
    assert np.abs(velocity).max() > 0.01
    assert abs(velocity[-1]) < 1e-3, "the table is at rest, not only its acceleration zero"


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"record": "el_centre"}, ["el_centre", "el_centro"]),
        ({"peak_acceleration": 30.0}, ["acceleration 30 m/s^2 at 2.180 s, the table's limit is 10"]),
        ({"peak_acceleration": np.nan}, ["goal: peak_acceleration nan m/s^2, expected 0 or more"]),
        ({"duration": -1.0}, ["goal: duration -1 s, expected 0 to 3600 s"]),
        ({"duration": 3601.0, "record": "white_noise"}, ["goal: duration 3601 s"]),
        ({"duration": np.inf, "record": "multisine"}, ["goal: duration inf s"]),
    ],
)
def test_a_goal_that_cannot_be_played_is_told_and_nothing_moves(player, wrong, told):
    ended = player.result(player.send(**{"record": "el_centro", **wrong}))
    assert ended.status == GoalStatus.STATUS_ABORTED
    assert not ended.result.success
    assert all(text in ended.result.message for text in told), ended.result.message
    assert "\n" not in ended.result.message
    assert np.abs(player.ground).max() < 0.01


def test_a_goal_is_refused_while_another_plays(player):
    first = player.send(record="white_noise", duration=30.0)
    assert not player.send(record="el_centro").accepted
    first.cancel_goal_async()
    player.result(first)


def test_a_record_that_has_no_room_where_the_last_run_left_the_table_is_refused_before_it_moves(graph):
    # 0.15 m to one side in 1.5 s, five minutes there, and back
    move = 1.5
    pulse = 2 * np.pi * 0.15 / move**2 * np.sin(2 * np.pi * np.arange(round(SLOW * move)) / (SLOW * move))
    motion = np.concatenate([np.zeros(10), pulse, np.zeros(round(300 * SLOW)), -pulse, np.zeros(10)])
    path = graph.folder / "aside.csv"
    header = "time [s],acceleration [m/s^2]"
    np.savetxt(
        path, np.column_stack([np.arange(len(motion)) / SLOW, motion]), delimiter=",", header=header, comments=""
    )
    player = Player(graph, record=str(path))
    graph.play("ground_motion")
    graph.until(lambda: float(graph.values("ground_motion").get("elapsed", "0")) > 3.0, "the table at the side")
    for transition in ("deactivate", "activate"):
        assert graph.change_state("plant", transition)
    graph.until(lambda: player.responses[-1].sequence == 0, "the rig to wait for a goal")
    refused = graph.call(Trigger, "ground_motion/play", Trigger.Request())
    assert not refused.success
    assert "exceeds the table's limits: displacement 0.3 m" in refused.message
    assert "move it there, then cleanup and configure rig and ground_motion" in refused.message
    for transition in ("deactivate", "cleanup", "configure", "activate"):
        for name in ("ground_motion", "plant"):
            assert graph.change_state(name, transition)
    graph.play("ground_motion")


def test_a_goal_whose_rig_has_gone_ends_with_the_clean_up_and_none_is_accepted_until_the_node_is_active_again(player):
    graph = player.graph
    handle = player.send(record="white_noise", duration=30.0)  # not over before it is looked at
    ended = handle.get_result_async()
    graph.until(lambda: np.abs(player.ground[-50:]).max() > 0.1, "the motion")
    graph.kill("plant")
    for transition in ("deactivate", "cleanup"):
        assert graph.change_state("ground_motion", transition)
    graph.until(ended.done, "the result")
    assert ended.result().status == GoalStatus.STATUS_ABORTED
    assert ended.result().result.message.startswith("stopped: ")
    assert not player.send(record="el_centro").accepted
    for transition in ("configure", "activate"):
        assert not player.send(record="el_centro").accepted
        assert graph.change_state("ground_motion", transition)
    player.start("again")
    graph.until(lambda: player.send(record="el_centro").accepted, "a goal that is accepted")
