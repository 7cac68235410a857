# SPDX-License-Identifier: Apache-2.0
"""What a node that commands braces refuses when it is configured."""

from __future__ import annotations

from typing import TYPE_CHECKING

import domain_coordinator
import pytest
import rclpy

from abrace_core.errors import AbraceError
from abrace_core.node.brace_commander import BraceCommander

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture
def commander() -> Iterator[BraceCommander]:
    with domain_coordinator.domain_id() as domain, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        rclpy.init(args=["--ros-args", "-p", "rate_limit:=250000.0"], domain_id=domain)
        node = BraceCommander("pusher", [])
        yield node
        node.destroy_node()
        rclpy.try_shutdown()


def test_a_rate_limit_too_low_for_the_ramp_is_refused_by_its_parameter(commander):
    with pytest.raises(AbraceError) as refused:
        commander.create_topics(0.002, [1e3, 1e5, 2e3])
    assert str(refused.value) == (
        "parameter rate_limit: 250000 N/s, expected at least 314200 N/s to bring 100000 N to zero in 0.5 s"
    )
    commander.create_topics(0.002, [1e3, 7e4, 2e3])
    assert commander.guard.at_rest
