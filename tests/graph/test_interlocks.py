# SPDX-License-Identifier: Apache-2.0
"""Interlocks of the node `plant`: samples and diagnostics name the planted cause, and only a person clears it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
import yaml
from planted_causes import PATIENCE, PLANTED, START, names
from running_graph import Commander
from safety_cases import RATE, Hands, start_plant_in_hand
from udp_target import CONFIG

from abrace_core.safety.table_stop import LONGEST
from abrace_interfaces.msg import Response

if TYPE_CHECKING:
    from pathlib import Path

    from planted_causes import Planted

AFTER = 50
"""Samples in which nothing may change."""


def rig_file(folder: Path, planted: Planted) -> Path:
    """The paper's rig with the limits of a planted cause."""
    content = yaml.safe_load((CONFIG / "ncree_three_storey.yaml").read_text())
    for interlock, value in planted.limits.items():
        content["interlocks"][interlock]["value"] = value
    file = folder / "rig.yaml"
    file.write_text(yaml.safe_dump(content))
    return file


def drive(hands: Hands, planted: Planted, begin: int) -> None:
    """Answer a sample as a commander and a table with the cause in them do, from sample `begin` on."""
    time = (hands.last.sequence - begin) / RATE
    more = hands._more()
    hands.send_table(planted.table(time))
    Commander.send(hands, [planted.force(time)])
    hands.graph.until(more, "the next sample")


@pytest.mark.parametrize("interlock", ["oscillation", "stuck"])
def test_a_planted_cause_is_named_and_latched_until_a_person_clears_it(graph: Any, interlock: str):
    planted = PLANTED[interlock]
    failing = {"sensor_faults": [f"{planted.fault}@{START}"]} if planted.fault else {}
    start_plant_in_hand(graph, rig=str(rig_file(graph.folder, planted)), seed=1, **failing)
    hands = Hands(graph)
    hands.until(lambda: hands.last.state == Response.RUNNING, 0.0)
    begin = hands.last.sequence
    while not hands.last.cause and hands.last.sequence < PATIENCE * RATE:
        drive(hands, planted, begin)
    cause = hands.last.cause
    assert cause.startswith(planted.says)
    assert names(cause, interlock), cause
    graph.until_fault("plant", cause)

    first = hands.last.sequence
    while hands.last.state != Response.LATCHED and hands.last.sequence < first + LONGEST * RATE:
        drive(hands, planted, begin)
    for _ in range(AFTER):
        drive(hands, planted, begin)
    assert not hands.commands[-AFTER:].any(), "whatever is commanded"
    hands.hold(0.0, AFTER)
    assert hands.last.state == Response.LATCHED, "nobody asks for anything any more"
    assert hands.last.cause == cause
    assert graph.change_state("plant", "deactivate")
    assert not graph.change_state("plant", "activate"), "nobody has cleared it"
    answer = graph.clear_fault("plant")
    assert answer.success, answer.message
    assert answer.message == f"cleared: {cause}"
    assert graph.change_state("plant", "activate")
    graph.until(lambda: hands.last.state == Response.ARMING, "a new run")
    hands.until(lambda: hands.last.state == Response.RUNNING, 0.0)
