# SPDX-License-Identifier: Apache-2.0
"""What may act, tried on running nodes in lockstep: motions of the table, a law with the wrong sign, samples of old.

Each case is a function of a graph of its own kind that fails with an AssertionError, as in `safety_cases`.
"""

from __future__ import annotations

import itertools
import random
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from controller_speed import SOURCE, lqg3
from geometry_msgs.msg import AccelStamped
from rclpy.action import ActionClient
from safety_cases import (
    RATE,
    Hands,
    heartbeat_silent,
    motion_cut,
    repeating_button,
    start_plant_in_hand,
    worst_step,
)
from std_msgs.msg import Bool

from abrace_core.model.controller_file import save_controller
from abrace_core.model.noise import banded_noise
from abrace_interfaces.action import PlayGroundMotion
from abrace_interfaces.msg import BraceCommand, Response
from abrace_node.transport import LOCKSTEP_STREAM_QOS

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

from running_graph import LATCHED, Graph

PERIOD_NS = round(1e9 / RATE)
EL_CENTRO: dict[str, Any] = {"record": "el_centro", "peak_acceleration": 7.84532}
"""At 0.8 g, where a tapered acceleration would leave up to 0.9 m/s."""
DEMO_NOISE: dict[str, Any] = {"record": "white_noise", "rms": 0.25, "duration": 240.0}
DEMO_BAND = [0.1, 10.0]
COASTING = 2e-3
"""Greatest velocity [m/s] that the table may be left with, as its accelerometer's readings sum up, noise included."""


def wide_rig(folder: Path) -> Path:
    """The paper's rig with sensors that reach far, and interlocks that only warn: a strong motion is played on it."""
    text = (SOURCE / "abrace_plant/config/ncree_three_storey.yaml").read_text(encoding="utf-8")
    text = text.replace("action: stop", "action: warn").replace("range: 1.5, noise", "range: 20.0, noise")
    file = folder / "wide.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def wide_in_hand(graph: Graph) -> Hands:
    """A rig whose sensors reach far, in lockstep, with its braces and its table in our hands."""
    start_plant_in_hand(graph, rig=str(wide_rig(graph.folder)))
    return Hands(graph)


class StrongMotion:
    """El Centro at 0.8 g on a rig in lockstep whose braces are at rest, and a stop button."""

    def __init__(self, graph: Graph) -> None:
        self.graph, self.moments = graph, random.Random(1)
        self.responses: list[Response] = graph.listen(Response, "response")
        rig = str(wide_rig(graph.folder))
        graph.start("plant", rig=rig, lockstep=True, wait_for=["ground_motion"], autostart=False)
        graph.start("ground_motion", rig=rig, autostart=False, **EL_CENTRO)
        for name in ("plant", "ground_motion"):
            assert graph.change_state(name, "configure")
        self.button = graph.publisher(Bool, "emergency_stop", LATCHED)
        for name in ("ground_motion", "plant"):
            graph.until_matched(name, response=1, ground_motion=1)
            assert graph.change_state(name, "activate")

    played = False
    """Whether a motion has been played."""

    def begin(self) -> None:
        """Play from the beginning, in a new run."""
        graph, again, self.played = self.graph, self.played, True
        if again:
            run = self.responses[-1].run
            for name in ("plant", "ground_motion"):
                assert graph.change_state(name, "deactivate")
            if self.responses[-1].cause:
                graph.until(lambda: graph.clear_fault("plant").success, "the rig to be cleared")
            self.responses.clear()
            # where the stop left the table there may be no room for the record: a person moves it to the middle
            for name, change in itertools.product(("plant", "ground_motion"), ("cleanup", "configure")):
                assert graph.change_state(name, change)
            for name in ("ground_motion", "plant"):
                graph.until_matched(name, ground_motion=1)
                assert graph.change_state(name, "activate")
            graph.until(lambda: self.responses and self.responses[-1].run != run, "a new run")
            self.responses[:] = [one for one in self.responses if one.run != run]
        graph.play("ground_motion")

    def press(self) -> None:
        """Press at a random moment of the strong part, until the table is at rest."""
        moment = 1000 + self.moments.randrange(1500)
        self.graph.until(lambda: len(self.responses) > moment, "the strong part")
        self.button.publish(Bool(data=True))
        self.graph.until(lambda: self.responses[-1].state == Response.PROTECTIVE_STOP, "the table to be at rest")

    def release(self) -> None:
        """Release, so that a person can clear the stop."""
        self.button.publish(Bool(data=False))
        self.graph.until(lambda: self.responses[-1].state == Response.LATCHED, "the release")

    def stop(self) -> None:
        """The table ends at rest, not with a velocity."""
        self.press()
        count = len(self.responses) + 20
        self.graph.until(lambda: len(self.responses) > count, "the table to stand still")
        sequences = [one.sequence for one in self.responses]
        assert sequences == list(range(len(sequences))), "we have not seen every sample"
        acceleration = np.array([one.ground_acceleration for one in self.responses])
        moving = np.array([one.state == Response.RUNNING for one in self.responses])
        velocity = acceleration.cumsum() / RATE
        assert abs(velocity[moving]).max() > 10 * COASTING, "the table moved"
        assert abs(velocity[-1]) < COASTING, f"{velocity[-1]:.2g} m/s are left"
        assert abs(acceleration[-10:]).max() < 0.01, "the table is at rest"
        self.release()

    def stay_at_rest(self) -> None:
        """After release and clearing the rig runs, and the record does not play again by itself."""
        graph = self.graph
        self.press()
        self.release()
        graph.until(lambda: graph.clear_fault("plant").success, "the rig to be cleared")
        graph.until(lambda: self.responses[-1].state == Response.RUNNING, "the rig to run")
        first = len(self.responses)
        graph.until(lambda: len(self.responses) > first + 2 * RATE, "samples of 2 s")
        moved = max(abs(one.ground_acceleration) for one in self.responses[first:])
        assert moved < 0.01, f"{moved:.2g} m/s^2"


class WrongSign:
    """El Centro at 0.1 g on a rig in lockstep with LQG3 of the wrong sign."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.responses: list[Response] = graph.listen(Response, "response", LOCKSTEP_STREAM_QOS)
        right = lqg3()
        law = replace(right.law, c=-right.law.c, d=-right.law.d)
        save_controller(replace(right, law=law, correction=0 * right.correction), graph.folder / "wrong.yaml")
        inputs = ["brace_command", "ground_motion"]
        graph.start("plant", lockstep=True, wait_for=inputs, autostart=False)
        graph.start("ground_motion", record="el_centro", peak_acceleration=0.980665, autostart=False)
        graph.start("controller", "--params-file", graph.folder / "wrong.yaml")
        for name in ("plant", "ground_motion"):
            assert graph.change_state(name, "configure")
        graph.until_matched("plant", response=3, ground_motion=1, brace_command=1)
        for name in ("ground_motion", "plant"):
            assert graph.change_state(name, "activate")

    played = False
    begin = StrongMotion.begin

    def trip(self) -> None:
        """An interlock stops braces and table while the building is elastic."""
        self.graph.until(lambda: self.responses and self.responses[-1].state == Response.LATCHED, "an interlock")
        assert "(interlocks." in self.responses[-1].cause, self.responses[-1].cause
        drift = np.diff([one.displacement for one in self.responses], prepend=0.0)
        assert np.abs(drift).max() < 0.045, f"a drift of {np.abs(drift).max():.3f} m"
        assert abs(self.responses[-1].command[0]) < 1.0, "what was in force until then: the end of the ramp"
        assert worst_step(self.responses) <= 1.0, f"a step of {worst_step(self.responses):.6g} times the rate limit"


class Table:
    """A rig with its `ground_motion`, and others that are refused."""

    def __init__(self, graph: Graph) -> None:
        self.graph, self.seed = graph, itertools.count(1)
        self.responses: list[Response] = []
        graph.start("plant", lockstep=True, wait_for=["ground_motion"])
        graph.start("ground_motion")
        self.client = ActionClient(graph.node, PlayGroundMotion, "play_ground_motion")
        graph.until(self.client.server_is_ready, "the action")
        graph.until(lambda: "ground_motion: ready" in graph.reported(), "the node to be active")
        graph.until(lambda: graph.values("ground_motion").get("sequence", "-1") != "-1", "samples")

    def begin(self) -> None:
        """Nothing moves, and something may, also after motions of two senders."""
        for name in ("ground_motion", "plant"):
            self.graph.clear_any_fault(name)
        self.graph.until(lambda: "plant: running" in self.graph.reported(), "the rig to run")

    def refuse(self) -> None:
        """El Centro with a PGA of 30 m/s^2, where the table has 10, is refused before it is played."""
        goal = PlayGroundMotion.Goal(record="el_centro", peak_acceleration=30.0)
        asked = self.client.send_goal_async(goal)
        self.graph.until(asked.done, "an answer")
        ended = asked.result().get_result_async()
        self.graph.until(ended.done, "its result")
        result = ended.result().result
        assert not result.success
        assert not result.samples
        assert "acceleration 30 m/s^2" in result.message, result.message

    def noise(self) -> None:
        """The demo's noise is within the stroke, whatever its seed; from 0 Hz on it is not, and is refused."""
        seed, graph = next(self.seed), self.graph
        graph.start("ground_motion", name="demo", band=DEMO_BAND, seed=seed, **DEMO_NOISE)
        graph.start("ground_motion", name="from_zero", band=[0.0, 10.0], seed=seed, **DEMO_NOISE)
        assert graph.ended("from_zero") == 2
        (line,) = graph.output_of("from_zero")
        assert re.search("exceeds the table's limits: .*displacement [0-9.]+ m at", line), line
        graph.until(lambda: "demo" in graph.statuses, "the demo's motion")
        assert graph.stop("demo") == 0
        graph.stop("from_zero")
        for name in ("demo", "from_zero"):
            graph.started.pop(name)
            graph.statuses.pop(name, None)


class OldSamples:
    """We in the rig's place before an `excitation` and a `ground_motion`."""

    def __init__(self, graph: Graph) -> None:
        self.graph, self.run = graph, 10
        self.responses: list[Response] = []
        self.commands: list[BraceCommand] = graph.listen(BraceCommand, "brace_command")
        self.motions: list[AccelStamped] = graph.listen(AccelStamped, "ground_motion")
        self.publisher = graph.publisher(Response, "response", subscribers=0)
        graph.start("excitation", rms=5000.0, duration=60.0, seed=2)
        graph.start("ground_motion", record="white_noise", duration=60.0, rms=0.25)
        graph.until_matched("excitation", response=1, brace_command=1)
        graph.until_matched("ground_motion", response=1, ground_motion=1)
        self.signal = banded_noise(round(60.0 * RATE), RATE, (0.0, 30.0), 5000.0, 2)

    def begin(self) -> None:
        """The rig ends a run, of one sample, and begins a new one."""
        for run in (self.run + 5, self.run + 10):
            self.commands.clear()
            self.motions.clear()
            self.run = run
            self.publisher.publish(self._sample(run, 0))
            self.graph.play("excitation", "ground_motion")
            self.graph.until(lambda: self.commands and self.motions, "the answers")
        self.commands.clear()
        self.motions.clear()

    def _sample(self, run: int, sequence: int) -> Response:
        sample = Response(run=run, sequence=sequence, state=Response.RUNNING, flags=Response.LOCKSTEP)
        sample.displacement = sample.acceleration = [0.0] * 3
        sample.braces = [1]
        sample.stroke = sample.force = sample.command = [0.0]
        sample.header.stamp.sec, sample.header.stamp.nanosec = divmod(sequence * PERIOD_NS, 10**9)
        return sample

    def _until_answered(self, sequence: int) -> None:
        """Send a sample, and wait until both have answered."""
        sample = self._sample(self.run, sequence)
        self.publisher.publish(sample)
        self.graph.until(
            lambda: (
                bool(self.commands and self.motions)
                and self.commands[-1].sequence == sequence
                and self.motions[-1].header.stamp == sample.header.stamp
            ),
            "the answers",
        )

    def answer(self) -> None:
        """Old samples, and those of earlier runs, are not answered; the last one, said again, is, and as before."""
        for sequence in range(1, 201):
            if sequence > 100 and sequence % 10 == 0:
                for run, old in ((self.run, sequence - 1), (self.run, sequence - 50), (self.run - 5, sequence)):
                    self.publisher.publish(self._sample(run, old))
            self._until_answered(sequence)
        answers = {one.sequence: one.force[0] for one in self.commands}
        assert list(answers) == list(range(1, 201)), "an old sample was answered"
        assert all(one.force[0] == answers[one.sequence] for one in self.commands), "another answer to the same sample"
        again = [one for one, after in itertools.pairwise(self.commands) if one.sequence == after.sequence]
        assert [one.sequence for one in again] == list(range(109, 200, 10)), "a sample that was said again"
        forces = np.array([*answers.values()])
        steps = np.abs(np.diff(forces))
        assert steps.max() <= np.abs(np.diff(self.signal[:201])).max() + 1e-9, "a step in force"
        assert (forces == self.signal[1:201]).all(), "another force than the signal's"
        stamps = [(one.header.stamp.sec, one.header.stamp.nanosec) for one in self.motions]
        motion = dict(zip(stamps, (one.accel.linear.x for one in self.motions), strict=True))
        assert np.abs(np.diff([*motion.values()])).max() < 0.1, "a step in acceleration"
        assert len(motion) == 200


GRAPHS: dict[Callable[[Graph], Any], dict[str, Callable[[Any], None]]] = {
    repeating_button: {"heartbeat_silent": heartbeat_silent},
    wide_in_hand: {"motion_cut": motion_cut},
    StrongMotion: {
        "stop_during_el_centro": StrongMotion.stop,
        "released_stop_at_ground_motion": StrongMotion.stay_at_rest,
    },
    WrongSign: {"law_with_wrong_sign": WrongSign.trip},
    Table: {"motion_beyond_the_table": Table.refuse, "demo_noise_within_the_stroke": Table.noise},
    OldSamples: {"old_and_repeated_response": OldSamples.answer},
}
