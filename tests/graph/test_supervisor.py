# SPDX-License-Identifier: Apache-2.0
"""The supervisor of a launch begins a test when all are matched, ends it after its signal, and says what was wrong."""

import numpy as np
import pytest
from rcl_interfaces.srv import ListParameters

from abrace_bags import read_run, read_runs
from abrace_interfaces.msg import BraceCommand, Response
from abrace_node.transport import LOCKSTEP_STREAM_QOS

pytestmark = pytest.mark.usefixtures("domain")

BOTH = ["brace_command=excitation", "ground_motion=ground_motion"]


def test_a_test_begins_when_it_is_recorded_and_ends_after_its_signal_whoever_listens(graph):
    bag = graph.folder / "bag"
    viewer = graph.listen(Response, "response", LOCKSTEP_STREAM_QOS)
    graph.start("plant", autostart=False, lockstep=True)
    graph.start("supervisor", inputs=["brace_command=excitation"], signals=["excitation"], free_decay=0.5)
    graph.start("excitation", duration=2.0)
    graph.until(lambda: graph.values("plant").get("subscribers of response") == "2", "the viewer and the excitation")
    assert not viewer, "nothing is sampled before the logger is there"
    answer = graph.call(ListParameters, "supervisor/list_parameters", ListParameters.Request())
    assert {"inputs", "signals"} <= set(answer.result.names)
    graph.start("logger", output=str(bag), lockstep=True)
    assert graph.ended("supervisor") == 0, graph.output_of("supervisor")
    assert graph.state("plant") == "inactive"
    assert graph.stop("logger") == 0
    run = read_run(bag)
    assert run.sequence[0] == 0
    assert len(run.sequence) == run.sequence[-1] + 1 > 2.0 * 500
    graph.until(lambda: len(viewer) == len(run.sequence), "the viewer to have them all")


def test_a_rig_that_runs_elsewhere_is_joined_when_it_is_recorded_and_a_broken_off_signal_is_an_error(graph):
    bag = graph.folder / "bag"
    graph.by_the_clock, rig = True, graph.slow_rig()
    graph.start("plant", rig=rig, command_timeout=1.0, late_limit=1000)
    graph.start("ground_motion", rig=rig, record="white_noise", duration=1000.0, autostart=False)
    options = {"plant": False, "signals": ["ground_motion"], "free_decay": 0.6}
    graph.start("supervisor", inputs=["ground_motion=ground_motion"], **options)
    graph.start("logger", output=str(bag))
    graph.until(lambda: float(graph.values("ground_motion").get("elapsed", 0)) > 0.2, "the motion")
    graph.emergency_stop()(True)
    assert graph.ended("supervisor") == 1
    last = graph.output_of("supervisor")[-1]
    assert "ground_motion: cancelled after" in last, last
    assert f"protective stop: pressed by {graph.namespace}/test" in last, last
    assert graph.state("ground_motion") == "inactive"
    assert graph.stop("logger") == 0
    # six standard deviations of the sensor's noise; the motion has 0.25 m/s^2
    assert np.abs(read_runs(bag)[0].ground_acceleration[:3]).max() < 6 * 0.00084, "recorded from before the motion on"


def test_who_is_missing_and_who_is_too_many_is_named(graph):
    graph.start("plant", autostart=False)
    graph.until(lambda: "plant" in graph.statuses, "the plant")
    graph.start("supervisor", inputs=BOTH, patience=8.0)
    assert graph.ended("supervisor") == 1
    (line,) = graph.output_of("supervisor")
    assert "did not find each other within 8 s" in line
    for node in ("logger", "excitation", "ground_motion"):
        assert f"{node} has 0 of 1" in line
    assert graph.change_state("plant", "cleanup")
    for _ in range(2):
        graph.node.create_publisher(BraceCommand, "brace_command", 10)
    graph.start("supervisor", name="second", inputs=BOTH)
    assert graph.ended("second") == 1
    assert "plant has 2 publishers of brace_command" in graph.output_of("second")[0]
