# SPDX-License-Identifier: Apache-2.0
"""Where `ground_motion` takes the table to be: where the rig says that it is."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

import domain_coordinator
import pytest
import rclpy
from rclpy.lifecycle import TransitionCallbackReturn
from std_srvs.srv import Trigger

from abrace_core.safety.rig_safety import State
from abrace_core.safety.wire import LOCKSTEP, Head, Responses
from abrace_plant.nodes.ground_motion import GroundMotion

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

CONFIG = Path(__file__).parents[2] / "src/abrace_plant/config"


@pytest.fixture
def ground_motion(monkeypatch) -> Iterator[Callable[..., GroundMotion]]:
    """A node with these parameters, that has been configured and activated as far as it can be."""
    nodes = []
    with domain_coordinator.domain_id() as domain:
        monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

        def make(**parameters: str) -> GroundMotion:
            arguments = [f"{name}:={value}" for name, value in parameters.items()]
            rclpy.init(args=["--ros-args", *(word for one in arguments for word in ("-p", one))], domain_id=domain)
            nodes.append(GroundMotion())
            return nodes[-1]

        yield make
        for node in nodes:
            node.destroy_node()
        rclpy.try_shutdown()


def sample(node: GroundMotion, sequence: int, table_displacement: float) -> None:
    head = Head(sequence, 1, 0, LOCKSTEP, State.RUNNING)
    zero = [0.0]
    payload = Responses().pack(2_000_000 * sequence, head, "", [1], *[zero] * 5, 0.0, table_displacement)
    node.on_response(payload)


def play(node: GroundMotion) -> str:
    return node.on_play(Trigger.Request(), Trigger.Response()).message


def test_a_record_begins_where_the_rig_says_that_the_table_is_and_nowhere_else(ground_motion):
    node = ground_motion(record="el_centro", peak_acceleration="7.0")  # goes to -0.22 m of 0.25 m
    assert node.trigger_configure() is TransitionCallbackReturn.SUCCESS
    assert node.trigger_activate() is TransitionCallbackReturn.SUCCESS
    sample(node, 0, math.nan)
    assert play(node) == "not played: the rig does not know where the table is"
    sample(node, 1, -0.1)
    assert "exceeds the table's limits: displacement 0.3203 m at 5.140 s" in play(node)
    sample(node, 2, 0.0)
    assert play(node) == "playing"


def test_a_sample_of_a_rig_in_lockstep_that_comes_again_is_answered_again_with_the_same(ground_motion):
    node, sent = ground_motion(record="white_noise", duration="2.0"), []
    node.trigger_configure()
    node.trigger_activate()
    node.publisher = SimpleNamespace(publish=sent.append)
    sample(node, 0, 0.0)
    assert play(node) == "playing"
    for sequence in (0, 1, 1, 2):
        sample(node, sequence, 0.0)
    first, again, second, second_again, third = sent
    assert (first, second) == (again, second_again)
    assert len({first, second, third}) == 3
    assert node.playback.played == 3


def test_a_rig_whose_table_has_its_own_controller_is_refused(ground_motion, tmp_path, capfd):
    rig = tmp_path / "rig.yaml"
    rig.write_text(
        (CONFIG / "ncree_three_storey.yaml").read_text().replace("\ntable:\n", "\ntable:\n  driven: false\n")
    )
    node = ground_motion(record="el_centro", rig=str(rig))
    assert node.trigger_configure() is TransitionCallbackReturn.FAILURE
    assert "the table is driven by its own controller (table.driven: false in the rig file)" in capfd.readouterr().err
