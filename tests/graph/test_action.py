# SPDX-License-Identifier: Apache-2.0
"""The action play_ground_motion: played, cancelled, refused."""

import numpy as np
import pytest
from action_msgs.msg import GoalStatus
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import AccelStamped
from rclpy.action import ActionClient
from rosbags.rosbag2 import Reader
from running_graph import STREAM

from abrace_bags import read_topics
from abrace_interfaces.action import PlayGroundMotion
from abrace_interfaces.msg import BraceCommand, Response
from abrace_plant.records.intensity import integrate


class Rig:
    """A rig in lockstep with a table, at the pace of the test's node: that answers every sample with zero force."""

    def __init__(self, graph, **parameters) -> None:
        self.graph = graph
        self.responses = []
        graph.start("plant", lockstep=True, wait_for=["brace_command", "ground_motion"])
        graph.start("ground_motion", **parameters)
        self.braces = graph.publisher(BraceCommand, "brace_command")
        graph.node.create_subscription(Response, "response", self.on_response, STREAM)

    def on_response(self, sample: Response) -> None:
        self.responses.append(sample)
        self.braces.publish(BraceCommand(run=sample.run, sequence=sample.sequence, force=[0.0]))

    @property
    def ground(self) -> np.ndarray:
        return np.array([response.ground_acceleration for response in self.responses])


class Player(Rig):
    """The same with a client of the table's action."""

    def __init__(self, graph) -> None:
        super().__init__(graph)
        self.played = graph.listen(AccelStamped, "ground_motion")
        self.client = ActionClient(graph.node, PlayGroundMotion, "play_ground_motion")
        self.feedback = []
        graph.until(self.client.server_is_ready, "the action")
        graph.until_matched("ground_motion", response=1)
        graph.until(lambda: len(self.responses) > 10, "responses")

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


@pytest.fixture
def player(graph) -> Player:
    return Player(graph)


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
    assert ended.result.samples == 1500
    elapsed = [feedback.elapsed for feedback in player.feedback]
    assert len(elapsed) > 10
    assert elapsed == sorted(elapsed)
    assert {feedback.duration for feedback in player.feedback} == {3.0}
    assert graph.stop("logger") == 0
    recorded = read_topics(bag)[f"{graph.namespace}/{names[0]}"]
    of_bag = list(recorded.fields["feedback.elapsed"])
    # rclpy's client drops feedback that it reads after the result
    assert of_bag[: len(elapsed)] == elapsed, "hidden topics are recorded by name"
    assert of_bag == sorted(of_bag)
    assert of_bag[-1] > 2.8
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
    assert 0 < ended.result.samples < 15000
    count = len(player.responses) + 50
    player.graph.until(lambda: len(player.responses) > count, "samples")
    assert np.abs(player.ground[-20:]).max() < 0.01, "the table at rest"
    sent = np.array([message.accel.linear.x for message in player.played])
    assert sent[-1] == 0
    assert np.abs(np.diff(sent)).max() < 0.1
    velocity, _ = integrate(sent, 0.002)
    assert np.abs(velocity).max() > 0.01
    assert abs(velocity[-1]) < 1e-3, "the table is at rest, not only its acceleration zero"


def test_an_unknown_record_is_told_with_those_that_are_known(player):
    ended = player.result(player.send(record="el_centre"))
    assert ended.status == GoalStatus.STATUS_ABORTED
    assert not ended.result.success
    assert "el_centre" in ended.result.message
    assert "el_centro" in ended.result.message
    assert np.abs(player.ground).max() < 0.01


def test_a_motion_that_is_more_than_the_table_has_is_refused_and_nothing_moves(player):
    ended = player.result(player.send(record="el_centro", peak_acceleration=30.0))
    assert ended.status == GoalStatus.STATUS_ABORTED
    assert not ended.result.success
    assert "acceleration 30 m/s^2 at 2.178 s, the table's limit is 10" in ended.result.message
    assert "\n" not in ended.result.message
    assert np.abs(player.ground).max() < 0.01


@pytest.mark.parametrize("wrong", [{"duration": -1.0}, {"peak_acceleration": float("nan")}, {"record": ""}])
def test_a_goal_with_wrong_values_is_told(player, wrong):
    ended = player.result(player.send(**{"record": "el_centro", **wrong}))
    assert ended.status == GoalStatus.STATUS_ABORTED
    assert "goal:" in ended.result.message


def test_a_goal_is_refused_while_another_plays(player):
    assert player.send(record="white_noise", duration=30.0).accepted, player.graph.reported()
    assert not player.send(record="el_centro").accepted


def test_a_goal_whose_rig_has_gone_ends_with_the_clean_up_and_none_is_accepted_until_the_node_is_active_again(player):
    graph = player.graph
    handle = player.send(record="el_centro")
    ended = handle.get_result_async()
    graph.until(lambda: player.feedback, "the motion")
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
    graph.start("plant", name="again", lockstep=True, wait_for=["brace_command", "ground_motion"])
    graph.until(lambda: player.send(record="el_centro").accepted, "a goal that is accepted")


def test_a_record_that_has_no_room_where_a_stop_left_the_table_is_not_begun_again(graph):
    # 0.15 m to one side in 1.5 s, a minute there, and back
    rate, move = 500.0, 1.5
    pulse = 2 * np.pi * 0.15 / move**2 * np.sin(2 * np.pi * np.arange(round(rate * move)) / (rate * move))
    motion = np.concatenate([np.zeros(50), pulse, np.zeros(round(60 * rate)), -pulse, np.zeros(50)])
    path = graph.folder / "aside.csv"
    header = "time [s],acceleration [m/s^2]"
    np.savetxt(
        path, np.column_stack([np.arange(len(motion)) / rate, motion]), delimiter=",", header=header, comments=""
    )
    Rig(graph, record=str(path))
    graph.until(lambda: float(graph.values("ground_motion").get("elapsed", "0")) > 3.0, "the table at the side")
    assert graph.change_state("ground_motion", "deactivate")
    assert not graph.change_state("ground_motion", "activate")
    told = "\n".join(graph.output_of("ground_motion"))
    assert "exceeds the table's limits: displacement 0.3 m" in told
    assert "expected the table in the middle: move it there, cleanup, configure" in told
    for transition in ("cleanup", "configure", "activate"):
        assert graph.change_state("ground_motion", transition)
