# SPDX-License-Identifier: Apache-2.0
"""Control laws of one's own as nodes: an example in a closed loop, and one that breaks."""

import sys
from pathlib import Path

import numpy as np
import pytest

from abrace.processes.parameter_file import parameter_file
from abrace_interfaces.msg import Response

EXAMPLES = Path(__file__).parents[2] / "examples"
BROKEN = """
from abrace_node.law_node import run_law
class MyLaw:
    def __init__(self, gain: float = 1.0, floors: tuple = (1, 2)):
        self.gain = gain
    def begin(self, floors, groups, sample_period):
        pass
    def force(self, sample):
        return [self.gain * 1000.0 if sample.number < 600 else 1 / 0]
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


def test_a_law_that_breaks_is_a_latched_fault_that_says_where(graph, start_law, tmp_path):
    file = tmp_path / "my_law.py"
    file.write_text(BROKEN)
    responses = graph.listen(Response, "response")
    graph.start("plant", lockstep=True, duration=2.0, autostart=False)
    start_law("my_law", file, gain=2.0, floors=[1])
    assert graph.change_state("plant", "configure")
    graph.until_matched("plant", response=2, brace_command=1)
    graph.may_end.add("plant")
    assert graph.change_state("plant", "activate")
    assert graph.ended("plant") == 1, "its run ends with a fault"
    graph.until_fault("my_law", "MyLaw.force: ZeroDivisionError: division by zero")
    graph.until(lambda: len(responses) == 1000, "the last sample")
    commands = np.array([response.command[0] for response in responses])
    assert commands[600] == 2000.0, "faded in"
    assert commands[-1] == 0.0
    assert (np.diff(commands[601:]) <= 0).all(), "along the ramp"
    assert responses[-1].state == Response.LATCHED
    assert "MyLaw.force" in responses[-1].cause


def test_a_wrong_parameter_of_a_law_is_refused_as_everywhere(graph, start_law):
    start_law("sliding_mode", EXAMPLES / "6_sliding_mode/sliding_mode/sliding_mode.py", boundry=1.0)
    assert graph.ended("sliding_mode") == 2
    (line,) = graph.output_of("sliding_mode")
    assert "parameter boundry: unknown, sliding_mode has" in line
    assert ", weights, did you mean boundary?" in line
