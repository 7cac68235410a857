# SPDX-License-Identifier: Apache-2.0
"""Control laws of one's own as nodes: an example in a closed loop, and one that breaks."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

from abrace import simulate
from abrace.processes.parameter_file import parameter_file
from abrace_core.own_law import GuardedLaw
from abrace_interfaces.msg import BraceCommand, Response

EXAMPLES = Path(__file__).parents[2] / "examples"
BROKEN = """
from abrace_core.node.law_node import run_law
class MyLaw:
    def __init__(self, gain: float = 1.0, floors: tuple = (1, 2)):
        self.gain = gain
    def begin(self, floors, groups, sample_period):
        pass
    def force(self, sample):
        return [self.gain * 1000.0 if sample.number < 300 else 1 / 0]
run_law(MyLaw)
"""

pytestmark = pytest.mark.usefixtures("domain")


@pytest.fixture
def start_law(graph):
    """Starts a law's node from its source."""

    def start(name: str, file: Path, **parameters: object) -> None:
        given = parameter_file(graph.folder / f"{name}.yaml", parameters)
        command = [sys.executable, file, "--ros-args", "-r", f"__ns:={graph.namespace}", "--params-file", given]
        graph.started[name] = graph.processes.start(name, command, graph.folder / f"{name}.log")

    return start


def test_the_example_answers_every_sample_with_its_law(graph, start_law):
    skyhook = importlib.import_module("skyhook.skyhook").Skyhook
    responses = graph.listen(Response, "response")
    commands = graph.listen(BraceCommand, "brace_command")
    start_law("skyhook", EXAMPLES / "skyhook/skyhook/skyhook.py", damping=90.0e3)
    inputs = ["brace_command", "ground_motion"]
    graph.start("plant", autostart=False, lockstep=True, wait_for=inputs, duration=8.0)
    graph.start("ground_motion", record="el_centro", peak_acceleration=0.98)
    assert graph.change_state("plant", "configure")
    graph.until_matched("plant", response=3, brace_command=1, ground_motion=1)
    graph.until_matched("skyhook", response=1, brace_command=2)
    graph.may_end.add("plant")
    assert graph.change_state("plant", "activate")
    assert graph.ended("plant") == 0, graph.output_of("plant")
    graph.until(lambda: len(responses) == 4000 and len(commands) == 4000, "the last sample")
    law = GuardedLaw(skyhook(damping=90.0e3), 0.002, 0.5)
    law.begin(3, 1)
    measured = [[*r.displacement, *r.stroke, *r.acceleration, sum(r.force) / 2] for r in responses]
    wanted = [law.force(number, z, 0) for number, z in enumerate(measured)]
    np.testing.assert_allclose([list(command.force) for command in commands], wanted, rtol=1e-12)
    assert np.abs(wanted).max() > 5000.0
    motion = {"record": "el_centro", "peak_acceleration": 0.98, "duration": 9.0}
    simulated = simulate("ncree_three_storey", **motion, controller=skyhook(damping=90.0e3)).outputs[:4000]
    np.testing.assert_array_equal(simulated, measured, err_msg="the same test in Python")
    assert graph.stop("skyhook") == 0, graph.output_of("skyhook")


def test_a_law_that_breaks_is_a_latched_fault_that_says_where(graph, start_law, tmp_path):
    file = tmp_path / "my_law.py"
    file.write_text(BROKEN)
    responses = graph.listen(Response, "response")
    graph.start("plant", lockstep=True, duration=1.5, autostart=False)
    start_law("my_law", file, gain=2.0, floors=[1])
    assert graph.change_state("plant", "configure")
    graph.until_matched("plant", response=2, brace_command=1)
    graph.may_end.add("plant")
    assert graph.change_state("plant", "activate")
    assert graph.ended("plant") == 1, "its run ends with a fault"
    graph.until_fault("my_law", "MyLaw.force: ZeroDivisionError: division by zero")
    graph.until(lambda: len(responses) == 750, "the last sample")
    commands = np.array([response.command[0] for response in responses])
    assert commands[300] == 2000.0, "faded in"
    assert commands[-1] == 0.0
    assert (np.diff(commands[301:]) <= 0).all(), "along the ramp"
    assert responses[-1].state == Response.LATCHED
    assert "MyLaw.force" in responses[-1].cause


def test_a_wrong_parameter_of_a_law_is_refused_as_everywhere(graph, start_law):
    start_law("sliding_mode", EXAMPLES / "sliding_mode/sliding_mode/sliding_mode.py", boundry=1.0)
    assert graph.ended("sliding_mode") == 2
    (line,) = graph.output_of("sliding_mode")
    assert "parameter boundry: unknown, sliding_mode has" in line
    assert ", weights, did you mean boundary?" in line
