# SPDX-License-Identifier: Apache-2.0
"""The life cycle of the rig and of those who drive it: nothing before it is asked for, nothing lost in between."""

from __future__ import annotations

import os
import time

import numpy as np
from lifecycle_msgs.msg import Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Log, Parameter
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import get_parameter_value
from rclpy.qos import DurabilityPolicy, QoSProfile
from running_graph import SLOW
from std_msgs.msg import Bool

from abrace_core.model.controller_file import Controller, save_controller
from abrace_core.model.linear_model import LinearModel
from abrace_core.safety.stop_senders import UNNAMED
from abrace_interfaces.msg import BraceCommand, Response

LATCHED_QOS = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


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


def test_a_launched_rig_changes_no_state_before_its_transitions_are_received(graph, monkeypatch):
    monkeypatch.setenv("ABRACE_END_WITH", str(os.getpid()))
    graph.start("plant")
    graph.until(lambda: graph.node.count_publishers("plant/transition_event"), "the rig's process")
    seen = time.monotonic()
    graph.until(lambda: time.monotonic() > seen + 1.0, "time in which a rig becomes active")
    assert graph.node.count_publishers("response") == 0
    events = graph.listen(TransitionEvent, "plant/transition_event")
    graph.until(lambda: events and events[-1].goal_state.label == "active", "the transition to active")
    assert [event.goal_state.label for event in events] == ["configuring", "inactive", "activating", "active"]


def test_a_rig_is_cleaned_up_while_commanders_come_and_go(graph):
    graph.start("plant", autostart=False)
    for _ in range(8):
        assert graph.change_state("plant", "configure")
        request = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_CLEANUP))
        answer = graph.ask(ChangeState, "plant/change_state", request)
        publishers = [graph.node.create_publisher(BraceCommand, "brace_command", 10) for _ in range(2)]
        graph.until(answer.done, "the rig to be cleaned up")
        for publisher in publishers:
            graph.node.destroy_publisher(publisher)
    assert graph.state("plant") == "unconfigured"


STATES = {
    "unconfigured": {"configure": "inactive", "shutdown": "finalized"},
    "inactive": {"activate": "active", "cleanup": "unconfigured", "shutdown": "finalized"},
    "active": {"deactivate": "inactive", "shutdown": "finalized"},
    "finalized": {},
}
"""Of a life cycle node: where each of its transitions leads."""
PATHS = {
    "plant": ["configure", "cleanup", "configure", "activate", "deactivate", "activate", "deactivate", "shutdown"],
    "controller": ["configure", "activate", "deactivate", "cleanup", "configure", "activate", "shutdown"],
}


def change(graph, name: str, label: str) -> bool:
    """Ask for a transition by its label, as `ros2 lifecycle set` may; whether it went."""
    return graph.call(
        ChangeState, f"{name}/change_state", ChangeState.Request(transition=Transition(label=label))
    ).success


def test_a_transition_out_of_turn_is_refused_with_a_reason_and_the_node_goes_on(graph, tmp_path):
    law = LinearModel([[0.5]], [[0.5]], [[1.0]], [[0.0]], ("a1",), ("U",), 0.002)
    made = Controller("c", law, np.zeros((1, 1)), np.zeros((1, 2)), np.array([20e3]), "none", "none", "none")
    save_controller(made, tmp_path / "c.yaml")
    graph.start("plant", autostart=False)
    graph.start("controller", "--params-file", tmp_path / "c.yaml", autostart=False)
    responses = graph.listen(Response, "response")
    refused = 0
    for name, path in PATHS.items():
        state = "unconfigured"
        for following in [*path, None]:
            assert graph.state(name) == state
            for label in {"configure", "activate", "deactivate", "cleanup", "shutdown"} - set(STATES[state]):
                assert not change(graph, name, label), f"{label} while {state}"
                refused += 1
                expected = " or ".join(STATES[state]) or "none"
                said = "\n".join(graph.output_of(name))
                assert f"{label} refused: the node is {state}, expected " in said
                assert all(possible in said for possible in STATES[state]), expected
            if following is not None:
                assert change(graph, name, following), f"{following} while {state}"
                state = STATES[state][following]
                if (name, state) == ("plant", "active"):
                    until_samples(graph, responses, len(responses) + 10)
    lines = [line for name in PATHS for line in graph.output_of(name) if "refused" in line]
    assert len(lines) == refused, "each is logged once"
    assert graph.node.count_publishers("response") == 1


def test_nodes_that_are_configured_anew_answer_each_sample_once(graph):
    graph.start("plant", lockstep=True, wait_for=["brace_command", "ground_motion"], duration=1.0, autostart=False)
    graph.start("ground_motion", record="white_noise", duration=9.0, autostart=False)
    graph.start("excitation", duration=9.0, autostart=False)
    for name in ("ground_motion", "excitation", "plant"):
        for transition in ("configure", "cleanup", "configure", "activate")[: 3 if name == "plant" else 4]:
            assert graph.change_state(name, transition), transition
    graph.until_matched("plant", response=2, brace_command=1, ground_motion=1)
    graph.until_matched("excitation", response=1, brace_command=1)
    graph.until_matched("ground_motion", response=1, ground_motion=1)
    graph.may_end.add("plant")
    assert graph.change_state("plant", "activate")
    graph.play("ground_motion", "excitation")
    assert graph.ended("plant") == 0
    assert graph.output_of("plant")[-1].startswith("plant: done: 500 samples")


def test_a_stop_outlives_every_change_of_the_life_cycle_and_is_logged_once(graph):
    logged = graph.listen(Log, "/rosout")
    graph.start("plant")
    graph.until(lambda: graph.values("plant").get("state") == "running", "the rig to run")
    press = graph.emergency_stop()
    press(True)
    graph.until_fault("plant", "protective stop")
    for transition in ("deactivate", "cleanup", "configure"):
        assert graph.change_state("plant", transition), transition
    assert not graph.change_state("plant", "activate")
    cause = f"protective stop: pressed by {graph.namespace}/test"
    press(False)
    graph.until(lambda: graph.values("plant").get("state") == "latched", "the release")
    assert not graph.change_state("plant", "activate")
    reasons = [
        line.partition("activate refused: ")[2] for line in graph.output_of("plant") if "activate refused" in line
    ]
    assert reasons == [
        f"a stop is pressed, expected it to be released and cleared first ({cause})",
        f"a fault is latched, expected a person to clear it first ({cause})",
    ]
    graph.until(lambda: graph.clear_fault("plant").success, "it to be cleared")
    graph.until_well("plant")
    assert graph.change_state("plant", "activate")
    remedy = f"remove its cause, then: abrace clear {graph.namespace}/plant"
    # the middleware may tell the sender's name after its message
    cause_at_first = cause.replace(f"{graph.namespace}/test", UNNAMED)
    expected = [
        [(b"(", f"fault: {each}; {remedy}"), (b"\x14", f"fault cleared: {cause}")] for each in (cause, cause_at_first)
    ]
    logger = f"{graph.namespace[1:]}.plant"
    graph.until(lambda: len([one for one in logged if one.name == logger]) >= 4, "its log")
    shown = [(bytes([one.level]), one.msg) for one in logged if one.name == logger and "refused" not in one.msg]
    assert shown in expected


def test_a_stop_that_was_pressed_before_the_rig_was_there_is_heard(graph):
    graph.node.create_publisher(Bool, "/emergency_stop", LATCHED_QOS).publish(Bool(data=True))
    graph.start("plant", autostart=False)
    graph.until_fault("plant", "protective stop: pressed by")
    assert graph.change_state("plant", "configure")
    assert not graph.change_state("plant", "activate")


def test_a_node_that_is_shut_down_while_active_lets_go(graph):
    graph.by_the_clock = True
    graph.start("plant", rig=graph.slow_rig(), command_timeout=1.0, late_limit=1000)
    graph.start("excitation", duration=60.0, rms=2500.0, band=[0.5, 5.0], sample_rate=SLOW)
    responses = graph.listen(Response, "response")
    graph.play("excitation")
    graph.until(lambda: responses and abs(responses[-1].command[0]) > 1000, "the braces to push")
    assert graph.change_state("excitation", "shutdown")
    assert graph.state("excitation") == "finalized"
    graph.until(lambda: not responses[-1].command[0], "the force to go to zero")
    graph.until_well("plant")


def test_a_rig_that_started_by_itself_says_too_why_it_is_not_configured_again(graph):
    graph.start("plant")
    for transition in ("deactivate", "cleanup"):
        graph.until(lambda transition=transition: graph.change_state("plant", transition), transition)
    wrong = Parameter(name="sensor_faults", value=get_parameter_value("[a9=stuck]"))
    assert (
        graph.call(SetParameters, "plant/set_parameters", SetParameters.Request(parameters=[wrong]))
        .results[0]
        .successful
    )
    assert not graph.change_state("plant", "configure")
    assert graph.state("plant") == "unconfigured"
    assert any("configure refused: sensor fault 'a9=stuck'" in line for line in graph.output_of("plant"))
