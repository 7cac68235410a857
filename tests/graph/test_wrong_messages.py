# SPDX-License-Identifier: Apache-2.0
"""Messages of right types and wrong content on every topic and service: no node dies, and nothing wrong acts."""

from __future__ import annotations

import random

from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
from wrong_endurance import CAPACITY, RATE_STEP, wrong_endurance


def test_nothing_wrong_reaches_the_device_and_no_node_dies(graph):
    found = wrong_endurance(graph, 100, 5, random.Random(1))
    assert found["topics"] == 3
    assert found["services"] >= 30
    assert found["not_finite"] == 0
    assert found["greatest_force"] <= CAPACITY
    assert found["worst_step"] <= RATE_STEP * (1 + 1e-12), found["worst_between"]
    nothing = SetParameters.Request(parameters=[Parameter(name="seed", value=ParameterValue(type=200))])
    (refused,) = graph.call(SetParameters, "plant/set_parameters", nothing).results
    assert not refused.successful
    assert "seed: type 200" in refused.reason
