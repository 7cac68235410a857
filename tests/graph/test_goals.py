# SPDX-License-Identifier: Apache-2.0
"""Signals begin when a person says so, in the run that is running then, and never again by themselves."""

import numpy as np
import pytest
from forked import run_forked
from geometry_msgs.msg import AccelStamped
from running_graph import SLOW
from std_srvs.srv import Trigger

from abrace_interfaces.msg import BraceCommand, Response


@pytest.mark.alone
def test_a_rig_that_is_activated_again_moves_nothing_until_a_person_plays_a_signal(graph):
    graph.by_the_clock, rig = True, graph.slow_rig()
    responses, sent = graph.listen(Response, "response"), graph.listen(BraceCommand, "brace_command")
    motion = graph.listen(AccelStamped, "ground_motion")
    graph.start("plant", rig=rig, command_timeout=1.0, late_limit=1000)
    graph.start("excitation", duration=60.0, rms=500.0, band=[0.5, 20.0], sample_rate=SLOW)
    graph.start("ground_motion", rig=rig, record="white_noise", duration=60.0, rms=0.05)

    def largest() -> tuple[float, float]:
        return (
            max((abs(one.force[0]) for one in sent), default=0.0),
            max((abs(one.accel.linear.x) for one in motion), default=0.0),
        )

    def nothing_for_two_seconds() -> None:
        sent.clear()
        motion.clear()
        graph.until(lambda: min(len(sent), len(motion)) > 2 * SLOW, "answers of 2 s")
        assert largest() == (0.0, 0.0)

    def both_move() -> None:
        graph.until(lambda: np.greater(largest(), (100.0, 0.01)).all(), "force and motion")

    nothing_for_two_seconds()
    graph.play("excitation", "ground_motion")
    both_move()
    refused = graph.call(Trigger, "excitation/play", Trigger.Request())
    assert (refused.success, refused.message) == (False, "not played: a signal is playing")
    assert graph.change_state("plant", "deactivate")
    assert not graph.call(Trigger, "excitation/play", Trigger.Request()).success
    run = responses[-1].run
    assert graph.change_state("plant", "activate")
    graph.until(lambda: responses[-1].run > run, "the next run")
    nothing_for_two_seconds()
    for name in ("excitation", "ground_motion"):
        graph.until(lambda name=name: graph.values(name).get("signal") == "cancelled", f"{name} to say so")
        assert f"{name}: cancelled: " in graph.reported()
    for transition in ("deactivate", "activate"):
        assert graph.change_state("excitation", transition)
    nothing_for_two_seconds()
    assert max(abs(one.command[0]) for one in responses if one.run > run) == 0.0
    ended = run_forked(["abrace", "play", "excitation"])
    assert (ended.returncode, ended.stdout) == (0, f"{graph.namespace}/excitation: playing\n"), ended.stderr
    graph.play("ground_motion")
    both_move()
    ended = run_forked(["abrace", "play", "excitation"])
    assert (ended.returncode, ended.stdout) == (1, "")
    assert ended.stderr == f"{graph.namespace}/excitation: not played: a signal is playing\n"


def test_a_signal_is_refused_while_no_rig_has_been_heard_and_the_node_says_so(graph):
    graph.start("excitation")
    graph.until(lambda: "excitation: no sample of a rig has come yet" in graph.reported(), "the node to say so")
    refused = graph.call(Trigger, "excitation/play", Trigger.Request())
    assert (refused.success, refused.message) == (False, "not played: no rig is running")


def test_a_motion_that_a_dead_rig_left_is_over_in_the_next_run_in_lockstep_whose_first_sample_waits_for_play(graph):
    graph.start("ground_motion", record="white_noise", duration=60.0, rms=0.25)
    sent, publisher = graph.listen(AccelStamped, "ground_motion"), graph.publisher(Response, "response", subscribers=0)
    graph.until_matched("ground_motion", response=1, ground_motion=1)

    def sample(run: int, number: int) -> None:
        message = Response(run=run, sequence=number, state=Response.RUNNING, flags=Response.LOCKSTEP, braces=[1])
        message.displacement = message.acceleration = [0.0] * 3
        message.stroke = message.force = message.command = [0.0]
        message.header.stamp.sec, message.header.stamp.nanosec = run, 2_000_000 * number
        publisher.publish(message)

    def answered(run: int, number: int) -> bool:
        stamp = sent[-1].header.stamp if sent else None
        return stamp is not None and (stamp.sec, stamp.nanosec) == (run, 2_000_000 * number)

    sample(5, 0)
    graph.play("ground_motion")
    graph.until(lambda: answered(5, 0), "the first answer")
    for number in range(1, 100):
        sample(5, number)
        graph.until(lambda number=number: answered(5, number), "an answer")
    assert sent[-1].accel.linear.x != 0.0, "the table moves, and the rig dies"
    sample(6, 0)
    graph.until(lambda: graph.values("ground_motion").get("signal") == "cancelled", "the end of its motion")
    graph.play("ground_motion")
    graph.until(lambda: answered(6, 0), "the first answer of the next run")


def test_an_answer_to_the_last_run_in_lockstep_does_not_act_in_the_next_one(graph):
    """A ground motion is known by its stamp alone: no two runs of a rig have the same ones."""
    responses = graph.listen(Response, "response")
    graph.start("plant", lockstep=True, wait_for=["ground_motion"], autostart=False)
    assert graph.change_state("plant", "configure")
    table = graph.publisher(AccelStamped, "ground_motion")

    def answer(sample: Response, acceleration: float) -> None:
        message = AccelStamped()
        message.header.stamp = sample.header.stamp
        message.accel.linear.x = acceleration
        table.publish(message)

    assert graph.change_state("plant", "activate")
    for count in range(1, 20):
        graph.until(lambda count=count: len(responses) == count, "a sample")
        answer(responses[-1], 0.0)
    assert graph.change_state("plant", "deactivate")
    graph.until(lambda: responses[-1].flags & Response.LAST, "the last sample")
    assert graph.change_state("plant", "activate")
    graph.until(lambda: responses[-1].run != responses[0].run, "the next run")
    old, new = responses[0], responses[-1]
    assert (old.sequence, new.sequence) == (0, 0)
    answer(old, 1.5)
    graph.until(lambda: graph.values("plant").get("answers_to_unknown_samples") == "1", "the old answer to be counted")
    answer(new, 0.0)
    graph.until(lambda: responses[-1].sequence == 1, "the next sample")
    assert abs(responses[-1].ground_acceleration) < 0.1
    assert responses[-1].state != Response.LATCHED
