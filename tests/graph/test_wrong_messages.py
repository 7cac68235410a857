# SPDX-License-Identifier: Apache-2.0
"""Messages of right types and wrong content on every topic and service: no node dies, and nothing wrong acts."""

from __future__ import annotations

import random

from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
from rosgraph_msgs.msg import Clock
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


def test_a_wrong_time_on_clock_ends_no_node_that_uses_it_and_is_counted(graph):
    """A life cycle node, whose loop has the time, and one with a single thread."""
    graph.start("plant", use_sim_time=True)
    graph.start("logger", output=str(graph.folder / "bag"), use_sim_time=True)
    clock = graph.publisher(Clock, "/clock", subscribers=2)
    wrong, right = Clock(), Clock()
    wrong.clock.sec, right.clock.sec = -1, 12345
    for name in ("plant", "logger"):

        def counted(name=name):
            clock.publish(wrong)
            clock.publish(right)
            return graph.values(name).get("ignored messages of /clock", "0") not in ("0", "1")

        graph.until(counted, f"{name} to count")
        (line,) = (line for line in graph.output_of(name) if "/clock" in line)
        assert line.endswith("/clock: time of -1 s, expected 0 or more: this and later ones are ignored")
