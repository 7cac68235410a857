# SPDX-License-Identifier: Apache-2.0
"""The controller through bridge and emulator, and what becomes of the force when it fails: `make verify` in short."""

from __future__ import annotations

import pytest
from safety_by_the_clock import FAILURES, Rig

from abrace_interfaces.msg import Response

SAMPLES = 300


def expect_its_answers_to_act(rig: Rig) -> None:
    """Every sample is answered, nothing but answers acts, and the target follows them."""
    rig.until_driven(1e3)
    first = rig.commands[-1].sequence + 1
    rig.graph.until(lambda: rig.last.sequence > first + SAMPLES, "samples")
    answers = {one.sequence: one.force[0] for one in rig.commands if first <= one.sequence < first + SAMPLES}
    # samples that a busy machine missed are in neither
    assert list(answers) == [one.sequence for one in rig.responses if first <= one.sequence < first + SAMPLES]
    acted = {one.command[0] for one in rig.responses if first + 20 < one.sequence < first + SAMPLES}
    assert acted <= set(answers.values())
    assert len(acted) > SAMPLES / 2
    assert rig.target.report()["following"]
    assert rig.last.state == Response.RUNNING, rig.last.cause


@pytest.mark.alone
def test_the_controller_acts_through_bridge_and_emulator_and_when_it_fails_the_force_is_zero_in_time(graph):
    rig = Rig(graph, "controller", "sensor_bridge")
    rig.begin()
    expect_its_answers_to_act(rig)
    for fails in FAILURES.values():
        rig.begin()
        fails(rig)
    for name in ("sensor_bridge", "controller", "ground_motion"):
        graph.kill(name)  # at the end they would wait for the killed one to acknowledge what they sent
