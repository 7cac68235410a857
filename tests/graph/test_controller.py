# SPDX-License-Identifier: Apache-2.0
"""The real controller in a rig's loop: its force comes in, changes laws and bridges lost samples without a jump."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters

from abrace_core.model.controller_file import Controller, save_controller
from abrace_core.model.linear_model import LinearModel
from abrace_core.safety.rig_safety import RAMP_TIME
from abrace_interfaces.msg import BraceCommand, Response

if TYPE_CHECKING:
    from pathlib import Path

PERIOD = 2_000_000
RAMP = 0.1
STEPS = round(RAMP / 0.002)
REST = round(RAMP_TIME / 0.002)
"""Samples in which the force of a fault goes to zero."""
STEEPEST = np.pi / 2 / STEPS
LIMIT = np.array([20e3])


def controller(name: str, gain: float, inputs: tuple[str, ...] = ("a1",)) -> Controller:
    """A law that answers a steady a1 = 1 with `gain` newtons."""
    law = LinearModel([[0.5]], [[0.5]], [[gain]], [[0.0]], inputs, ("U",), 0.002)
    return Controller(name, law, np.zeros((1, 1)), np.zeros((1, 2)), LIMIT, "none", "none", "none")


class Rig:
    """The hand of the test in a rig's place: sends samples of its choice and takes the answers."""

    def __init__(self, graph: Any) -> None:
        self.graph = graph
        self.commands = graph.listen(BraceCommand, "brace_command")
        self.publisher = graph.publisher(Response, "response")
        self.sequence = 0

    def publish(self, a1: float, lost: int = 0) -> None:
        """Publish the next sample, after so many that are lost."""
        self.sequence += 1 + lost
        sample = Response(run=1, sequence=self.sequence, state=Response.RUNNING, flags=Response.LOCKSTEP)
        sample.displacement, sample.acceleration = [0.0] * 3, [a1, 0.0, 0.0]
        sample.braces = [1]
        sample.stroke = sample.force = sample.command = [0.0]
        nanoseconds = self.sequence * PERIOD
        sample.header.stamp.sec, sample.header.stamp.nanosec = divmod(nanoseconds, 10**9)
        self.publisher.publish(sample)

    def send(self, a1: float, lost: int = 0) -> float:
        """Send the next sample, after so many that are lost; returns the force that answers it."""
        count = len(self.commands)
        self.publish(a1, lost)
        self.graph.until(lambda: len(self.commands) > count, "an answer")
        assert self.commands[-1].sequence == self.sequence
        return float(self.commands[-1].force[0])

    def hold(self, a1: float, samples: int) -> np.ndarray:
        """(samples,) forces that answer a steady a1."""
        return np.array([self.send(a1) for _ in range(samples)])


@pytest.fixture
def files(tmp_path: Path) -> dict[str, Path]:
    """Controller files by name."""
    made = {}
    for one in (controller("one", 1000.0), controller("two", -2000.0), controller("other", 1.0, ("a9",))):
        made[one.name] = tmp_path / f"{one.name}.yaml"
        save_controller(one, made[one.name])
    return made


@pytest.fixture
def rig(graph: Any, files: dict[str, Path]) -> Rig:
    """With the controller `one` at its braces."""
    graph.start("controller", "--params-file", files["one"], ramp_time=RAMP)
    hand = Rig(graph)
    graph.until_matched("controller", response=1, brace_command=1)
    return hand


def set_next(graph: Any, path: Path | str) -> Any:
    value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=str(path))
    request = SetParameters.Request(parameters=[Parameter(name="next", value=value)])
    return graph.call(SetParameters, "controller/set_parameters", request).results[0]


def test_the_force_ramps_in_and_is_at_zero_before_the_controller_is_inactive(rig: Rig):
    found = rig.hold(1.0, STEPS + 20)
    assert np.abs(np.diff(found)).max() < 1.01 * STEEPEST * 1000.0
    np.testing.assert_allclose(found[-10:], 1000.0)
    request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE))
    inactive = rig.graph.ask(ChangeState, "controller/change_state", request)
    begin = len(rig.commands)
    while not inactive.done() and rig.commands[-1].force[0]:
        rig.publish(1.0)
        rig.graph.until(lambda: rig.commands[-1].sequence == rig.sequence or inactive.done(), "an answer")
        time.sleep(0.003)  # not within the time that a rig by the clock may take
    rig.graph.until(inactive.done, "the controller to be inactive")
    falling = [float(command.force[0]) for command in rig.commands[begin:]]
    assert falling[-1] == 0.0
    assert np.abs(np.diff([1000.0, *falling])).max() < 1.01 * STEEPEST * 1000.0
    assert inactive.result().success
    assert rig.graph.change_state("controller", "activate")
    rising = rig.hold(1.0, STEPS + 20)
    assert np.abs(np.diff([0.0, *rising])).max() < 1.01 * STEEPEST * 1000.0
    np.testing.assert_allclose(rising[-10:], 1000.0)


def test_another_controller_takes_over_without_a_jump(rig: Rig, files: dict[str, Path]):
    before = rig.hold(1.0, STEPS + 20)[-1]
    for path, said in ((files["other"], "other measures a9"), ("absent.yaml", "No such file")):
        answer = set_next(rig.graph, path)
        assert not answer.successful
        assert said in answer.reason
    answer = set_next(rig.graph, files["two"])
    assert answer.successful, answer.reason
    found = rig.hold(1.0, 1000 + STEPS + 20)
    np.testing.assert_allclose(found[:1000], before, rtol=1e-6, err_msg="two seconds beside the one in use")
    assert np.abs(np.diff(found)).max() < 1.01 * STEEPEST * 3000.0
    np.testing.assert_allclose(found[-10:], -2000.0)
    values = rig.graph.values
    rig.graph.until(lambda: values("controller").get("controller_state") == "in use", "the change in the diagnostics")
    assert values("controller")["controller"] == "two"
    assert "expected a controller file" in set_next(rig.graph, "").reason


def test_a_few_lost_samples_are_bridged_and_more_are_a_fault_that_a_person_clears(rig: Rig):
    rig.hold(1.0, STEPS + 20)
    assert rig.send(1.0, lost=5) == pytest.approx(1000.0)
    values = rig.graph.values
    rig.graph.until(lambda: values("controller").get("lost") == "5", "5 lost samples in the diagnostics")
    assert {"answer_median_us", "answer_99_percent_us", "answer_worst_us", "late"} <= set(values("controller"))
    assert float(values("controller")["innovation_rms a1"]) == pytest.approx(1.0)
    falling = [rig.send(1.0, lost=6), *rig.hold(1.0, REST + 5)]
    rig.graph.until_fault("controller", "6 samples lost before sample")
    assert np.abs(np.diff([1000.0, *falling])).max() < 1.01 * STEEPEST * 1000.0
    assert falling[-1] == 0.0
    assert "6 samples lost before sample" in rig.commands[-1].fault, "the rig is told"
    assert rig.graph.clear_fault("controller").success
    rising = rig.hold(1.0, REST + 20)
    # the law fades in, and so does what the node lets act: the square of a half cosine is 1.3 times as steep
    assert np.abs(np.diff([0.0, *rising])).max() < 1.31 * STEEPEST * 1000.0, "it begins anew, from zero"
    np.testing.assert_allclose(rising[-10:], 1000.0)


def test_a_file_that_cannot_be_run_ends_the_node_with_one_line(graph: Any, files: dict[str, Path]):
    text = files["one"].read_text()
    assert "a_d: [\n      0.5" in text
    files["one"].write_text(text.replace("a_d: [\n      0.5", "a_d: [\n      1.5"))
    graph.start("controller", "--params-file", files["one"])
    assert graph.ended("controller") == 2
    (line,) = graph.output_of("controller")
    assert "not stable (spectral radius of a_d 1.5), expected less than 1" in line
