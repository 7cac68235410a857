"""The life cycle of the rig and of those who drive it: nothing before it is asked for, nothing lost in between."""

from __future__ import annotations

import numpy as np

from abrace_interfaces.msg import Response


def until_samples(graph, responses: list[Response], count: int) -> None:
    """Wait for so many samples."""
    graph.until(lambda: len(responses) >= count, f"{count} samples")


def test_the_plant_does_nothing_until_it_is_configured_and_activated(graph):
    graph.start("plant", autostart=False)
    responses = graph.listen(Response, "response")
    assert graph.state("plant") == "unconfigured"
    graph.until_well("plant")
    assert graph.statuses["plant"].message == "not configured"
    assert graph.node.count_publishers("response") == 0
    assert graph.change_state("plant", "configure")
    graph.until_matched("plant", response=1)
    graph.until_well("plant")
    assert graph.statuses["plant"].message == "not active"
    assert not responses
    assert graph.change_state("plant", "activate")
    until_samples(graph, responses, 10)
    assert responses[0].sequence == 0
    assert graph.state("plant") == "active"

    assert graph.change_state("plant", "deactivate")
    graph.until_well("plant")
    seen = len(responses)
    graph.until_well("plant")
    assert len(responses) == seen, "no sample after deactivation"


def test_a_transition_out_of_turn_is_refused_and_the_node_goes_on(graph):
    graph.start("plant", autostart=False)
    for transition, goes in (("activate", False), ("configure", True), ("configure", False), ("activate", True)):
        assert graph.change_state("plant", transition) == goes, transition
    assert not graph.change_state("plant", "cleanup")
    responses = graph.listen(Response, "response")
    until_samples(graph, responses, 10)


def test_a_rig_configured_anew_publishes_each_sample_once(graph):
    graph.start("plant", autostart=False)
    for transition in ("configure", "activate", "deactivate", "cleanup", "configure", "activate"):
        assert graph.change_state("plant", transition), transition
    responses = graph.listen(Response, "response")
    until_samples(graph, responses, 100)
    assert (np.diff([response.sequence for response in responses]) == 1).all()
    assert graph.node.count_publishers("response") == 1


def test_a_table_and_braces_configured_anew_answer_each_sample_once(graph):
    graph.start("plant", lockstep=True, wait_for=["brace_command", "ground_motion"], duration=1.0, autostart=False)
    graph.start("ground_motion", record="white_noise", duration=9.0, autostart=False)
    graph.start("excitation", duration=9.0, autostart=False)
    for name in ("ground_motion", "excitation"):
        for transition in ("configure", "cleanup", "configure", "activate"):
            assert graph.change_state(name, transition), transition
    assert graph.change_state("plant", "configure")
    graph.until_matched("plant", response=2, brace_command=1, ground_motion=1)
    graph.until_matched("excitation", response=1, brace_command=1)
    graph.until_matched("ground_motion", response=1, ground_motion=1)
    graph.may_end.add("plant")
    assert graph.change_state("plant", "activate")
    assert graph.ended("plant") == 0
    assert graph.output_of("plant")[-1].startswith("plant: done: 500 samples")


def test_a_fault_outlasts_deactivation(graph):
    graph.start("plant")
    press = graph.emergency_stop()
    press(True)
    graph.until_fault("plant", "emergency stop")
    press(False)
    assert graph.change_state("plant", "deactivate")
    assert graph.change_state("plant", "activate")
    graph.statuses.clear()
    graph.until_fault("plant", "emergency stop")
    graph.until(lambda: graph.clear_fault("plant").success, "the released button's fault to be cleared")
    graph.until_well("plant")


def test_an_emergency_stop_while_not_active_is_not_forgotten(graph):
    graph.start("plant")
    graph.start("excitation", duration=60.0)
    graph.until_matched("excitation", brace_command=1)
    assert graph.change_state("excitation", "deactivate")
    press = graph.emergency_stop()
    graph.until(lambda: graph.node.count_subscribers("emergency_stop") == 2, "both to hear the button")
    press(True)
    graph.until_fault("plant", "emergency stop")
    assert graph.change_state("excitation", "activate")
    graph.until_fault("excitation", "emergency stop")


def test_a_node_that_is_shut_down_while_active_lets_go(graph):
    graph.start("plant", command_timeout=0.5)
    graph.start("excitation", duration=60.0, rms=5000.0)
    responses = graph.listen(Response, "response")
    graph.until(lambda: responses and abs(responses[-1].command[0]) > 2000, "the braces to push")
    assert graph.change_state("excitation", "shutdown")
    assert graph.state("excitation") == "finalized"
    graph.until(lambda: not responses[-1].command[0], "the force to go to zero")
    graph.until_well("plant")


def test_a_rig_that_cannot_be_configured_says_so_and_stays(graph):
    graph.start("plant", autostart=False, rig="none")
    assert not graph.change_state("plant", "configure")
    assert graph.state("plant") == "unconfigured"
    assert "rig 'none': unknown" in "\n".join(graph.output_of("plant"))
    assert graph.node.count_publishers("response") == 0
