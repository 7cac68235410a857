# SPDX-License-Identifier: Apache-2.0
"""The node `controller`, driven sample by sample in this process."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import domain_coordinator
import numpy as np
import pytest
import rclpy

from abrace_core.model.controller_file import Controller, save_controller
from abrace_core.model.linear_model import LinearModel
from abrace_core.safety.rig_safety import State
from abrace_core.safety.wire import LOCKSTEP, Head, Responses
from abrace_lqg.nodes.controller import ControllerNode

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture
def domain() -> Iterator[int]:
    with domain_coordinator.domain_id() as domain, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield domain
        rclpy.try_shutdown()


def test_an_acceleration_that_is_not_finite_is_a_fault_that_names_it(domain, tmp_path):
    law = LinearModel([[0.9]], [[0.1]], [[1000.0]], [[0.0]], ("a1",), ("U",), 0.002)
    limit, none = np.array([24500.0]), np.zeros((1, 1))
    save_controller(
        Controller("steady", law, none, np.zeros((1, 2)), limit, "none", "none", "none"), tmp_path / "law.yaml"
    )
    rclpy.init(args=["--ros-args", "--params-file", str(tmp_path / "law.yaml")], domain_id=domain)
    node = ControllerNode()
    node.trigger_configure()
    node.trigger_activate()
    responses, forces = Responses(), []
    for number in range(1400):
        head = Head(number, 1, 0, LOCKSTEP, State.RUNNING)
        acceleration = math.nan if number == 1000 else 1.0
        node.on_response(
            responses.pack(2_000_000 * number, head, "", [1], [0.0], [acceleration], [0.0], [0.0], [0.0], 0.0, 0.0)
        )
        forces += node.guard.value
    fault = node.fault
    node.destroy_node()
    assert fault == "acceleration[0] of sample 1000 is nan, expected a finite number"
    assert forces[999] == pytest.approx(1000.0)
    assert np.isfinite(forces).all()
    assert forces[1399] == 0.0
