# SPDX-License-Identifier: Apache-2.0
"""An exception in any callback or task: what a node drives comes to rest along its ramp, one line, exit code 1."""

from __future__ import annotations

import json
import os
import re
import subprocess
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from planted_exceptions import Case, hosted, planted_in_every_node
from running_graph import LATCHED, PATIENCE, STREAM, TRANSITIONS
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from abrace.processes.group import find_executable
from abrace_core.files.installed import find_file
from abrace_core.safety.rig_safety import RAMP_TIME
from abrace_interfaces.msg import BraceCommand, Response

if TYPE_CHECKING:
    from pathlib import Path

RATE = 60.0
FORCE = 1000.0
PLACES = (
    "show",
    "report_fault",
    "on_command",
    "poll_stops",
    "publish_diagnostics",
    "on_clear_fault",
    "_log_fault",
    "come_to_rest",
    "deactivate",
)
"""Methods of the plant: work that its loop defers, its thread, a subscription, timers, a service, transitions."""


@pytest.fixture
def slow_rig(tmp_path: Path) -> Path:
    """A rig of few samples: the subject is how a node ends, not how fast a machine is."""
    text = find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig").read_text()
    file = tmp_path / "slow.yaml"
    file.write_text(re.sub(r"(?m)^sample_rate:.*$", f"sample_rate: {RATE}", text))
    return file


def push(graph: Any, namespace: str) -> list[Response]:
    """Answer each sample of the rig in a namespace; once it is armed with a force that grows to FORCE."""
    responses: list[Response] = []
    publisher = graph.node.create_publisher(BraceCommand, f"{namespace}/brace_command", STREAM)

    def answer(sample: Response) -> None:
        responses.append(sample)
        acts = sample.state in (Response.FADING_IN, Response.RUNNING)
        force = min(FORCE, sample.command[0] + 50.0) if acts else 0.0
        publisher.publish(BraceCommand(header=sample.header, run=sample.run, sequence=sample.sequence, force=[force]))

    graph.node.create_subscription(Response, f"{namespace}/response", answer, STREAM)
    return responses


def test_a_rig_ramps_its_force_to_zero_whatever_raises(graph, slow_rig):
    spaces = {place: f"{graph.namespace}/{place.strip('_')}" for place in PLACES}
    responses = {place: push(graph, space) for place, space in spaces.items()}
    deactivate = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_DEACTIVATE))
    answered = {
        "come_to_rest": lambda space: graph.ask(ChangeState, f"{space}/plant/change_state", deactivate),
        "deactivate": lambda space: graph.ask(ChangeState, f"{space}/plant/change_state", deactivate),
        "on_clear_fault": lambda space: graph.ask(Trigger, f"{space}/plant/clear_fault", Trigger.Request()),
        "_log_fault": lambda space: graph.publisher(Bool, f"{space}/emergency_stop", LATCHED).publish(Bool(data=True)),
    }
    parameters = f"-p rig:={slow_rig} -p command_timeout:=10.0 -p late_limit:=1000".split()
    cases = [
        Case(place, "abrace_plant.nodes.plant", ["-r", f"__ns:={space}", *parameters], place)
        for place, space in spaces.items()
    ]
    with hosted(cases, graph.folder):

        def acts(place: str) -> bool:
            return bool(responses[place]) and responses[place][-1].command[0] == FORCE

        graph.until(lambda: all(map(acts, PLACES)), "the force of every rig")
        before = {place: len(one) for place, one in responses.items()}
        for place, space in spaces.items():
            (graph.folder / f"{place}.go").touch()
            if place in answered:
                answered[place](space)
        codes = [graph.folder / f"{place}.code" for place in PLACES]
        graph.until(lambda: all(code.exists() for code in codes), "the end of every rig")
    assert {place: code.read_text() for place, code in zip(PLACES, codes, strict=True)} == dict.fromkeys(PLACES, "1")
    for place in PLACES:
        output = (graph.folder / f"{place}.log").read_text()
        (line,) = (line for line in output.splitlines() if "Planted" in line)
        assert re.search(rf": Planted: {place} \(planted_exceptions.py, line \d+, in planted\)$", line), output
        assert "Traceback" not in output
        samples = responses[place][before[place] - 1 :]
        force = np.array([one.command[0] for one in samples])
        sequence = np.array([one.sequence for one in samples])
        begin, end = np.argmax(force < FORCE) - 1, np.argmax(force == 0.0)
        assert np.all(force[end:] == 0.0), (place, force)
        # each force is one of the cosine's, at a whole number of its steps
        steps = int(RATE * RAMP_TIME) / np.pi * np.arccos(2 * force / FORCE - 1)
        assert np.allclose(steps, np.round(steps), rtol=0.0, atol=1e-6), (place, force)
        # the ramp goes on by the clock: it is held by missed samples and late commands, for three samples at most
        held = (sequence - steps)[begin : end + 1]
        missed = np.convolve(np.diff(sequence, prepend=sequence[0] - 1) - 1, np.ones(4))[begin : end + 1]
        assert np.all(held - held.min() <= 2.01 + missed), (place, force, held, missed)


def test_every_callback_and_task_of_every_node_takes_that_course(graph, slow_rig):
    folder, codes = graph.folder, planted_in_every_node(graph, slow_rig, 3 * PATIENCE)
    for name, code in codes.items():
        output = (folder / f"{name}.log").read_text()
        assert (folder / f"{name}.json").exists(), (name, code.read_text(), output)
        found = json.loads((folder / f"{name}.json").read_text())
        left = {place: state for place, state in found["places"].items() if state != "caught"}
        assert (left, found["not caught"]) == ({}, []), (name, output)
        assert len(found["places"]) >= 10, found
        assert code.read_text() == "1", output
        (line,) = (line for line in output.splitlines() if "FATAL" in line)
        assert line.endswith(": Planted: the last"), output


def test_deactivate_and_cleanup_sent_together_while_a_force_acts_are_done_in_turn(graph, slow_rig):
    responses = push(graph, graph.namespace)
    graph.start("plant", rig=str(slow_rig), command_timeout=10.0)
    graph.until(lambda: responses and responses[-1].command[0] == FORCE, "the force")
    answers = [
        graph.ask(ChangeState, "plant/change_state", ChangeState.Request(transition=Transition(id=TRANSITIONS[name])))
        for name in ("deactivate", "cleanup")
    ]
    graph.until(lambda: all(answer.done() for answer in answers), "both answers")
    assert [answer.result().success for answer in answers] == [True, True]
    assert graph.state("plant") == "unconfigured"
    assert responses[-1].command[0] == 0.0
    assert graph.stop("plant") == 0, graph.output_of("plant")


@pytest.mark.parametrize("output", ["closed", "/dev/full"])
@pytest.mark.usefixtures("domain")
def test_an_output_that_takes_nothing_is_one_line_and_exit_code_1(slow_rig, output):
    command = [find_executable("abrace_plant", "plant"), "--ros-args", "-p", f"rig:={slow_rig}", "-p", "duration:=1.0"]
    if output == "closed":
        reading, writing = os.pipe()
        os.close(reading)
    else:
        writing = os.open(output, os.O_WRONLY)
    ended = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True, timeout=PATIENCE, check=False)
    os.close(writing)
    (line,) = [line for line in ended.stderr.splitlines() if "fault" not in line]
    assert re.search(r"(BrokenPipeError|OSError): .* in finish\)$", line), ended.stderr
    assert ended.returncode == 1
