# SPDX-License-Identifier: Apache-2.0
"""Control laws of one's own as nodes: an example in a closed loop, and one that breaks."""

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

from abrace import simulate
from abrace.processes.parameter_file import parameter_file
from abrace_bags import read_run
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
HOLD = """
from abrace_node.law_node import run_law
class Hold:
    def __init__(self, seen: str = ""):
        self.seen = open(seen, "w", buffering=1)
    def begin(self, floors, groups, sample_period):
        self.period, self.integral, self.asked, self.samples = sample_period, 0.0, [0.0, 0.0], 0
    def force(self, sample):
        print(sample.number, sample.applied[0].hex(), file=self.seen)
        error = (0.005 if self.samples < 600 else -0.005) - sample.displacement[0]
        self.integral += self.period * (2e7 * error + 20.0 * (sample.applied[0] - self.asked.pop(0)))
        self.asked.append(self.integral + 2e6 * error)
        self.samples += 1
        return [self.asked[-1]]
if __name__ == "__main__":
    run_law(Hold)
"""
SAMPLES = 1000
CAPACITY = 24516.625

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


def seen_in(file):
    """Numbers and applied commands of the samples that a `Hold` was given."""
    numbers, values = zip(*map(str.split, file.read_text().splitlines()), strict=True)
    return np.array(numbers, dtype=int), np.array([float.fromhex(value) for value in values])


def test_an_integrator_is_given_the_command_that_acted_as_the_bag_has_it_and_as_simulated(graph, start_law, tmp_path):
    file, bag = tmp_path / "hold.py", tmp_path / "bag"
    file.write_text(HOLD)
    graph.start("logger", output=str(bag), topics=["response"])
    graph.start("plant", lockstep=True, wait_for=["brace_command"], duration=2.7, seed=3, autostart=False)
    start_law("hold", file, force_limit=[CAPACITY], seen=str(tmp_path / "node"))
    assert graph.change_state("plant", "configure")
    graph.until_matched("plant", response=2, brace_command=1)
    graph.until_matched("logger", response=1)
    graph.may_end.add("plant")
    assert graph.change_state("plant", "activate")
    assert graph.ended("plant") == 0
    assert graph.stop("logger") == 0
    recorded = read_run(bag)
    numbers, applied = seen_in(tmp_path / "node")
    assert len(numbers) > SAMPLES
    np.testing.assert_array_equal(applied, recorded.command[numbers - int(recorded.sequence[0]), 0])
    law = runpy.run_path(str(file))["Hold"](str(tmp_path / "simulated"))
    simulated = simulate("ncree_three_storey", np.zeros(SAMPLES), controller=law, seed=3)
    np.testing.assert_array_equal(seen_in(tmp_path / "simulated")[1], simulated.command[:, 0])
    np.testing.assert_array_equal(applied[:SAMPLES], simulated.command[:, 0])
    assert np.abs(applied).max() == CAPACITY, "some of what it wants is cut"
    assert np.abs(np.diff(applied)).max() == 5000.0, "and its rate limited"


def test_a_wrong_parameter_of_a_law_is_refused_as_everywhere(graph, start_law):
    start_law("sliding_mode", EXAMPLES / "6_sliding_mode/sliding_mode/sliding_mode.py", boundry=1.0)
    assert graph.ended("sliding_mode") == 2
    (line,) = graph.output_of("sliding_mode")
    assert "parameter boundry: unknown, sliding_mode has" in line
    assert ", weights, did you mean boundary?" in line
