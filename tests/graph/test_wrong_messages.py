# SPDX-License-Identifier: Apache-2.0
"""Messages of right types and wrong content on every topic and service: no node dies, and nothing wrong acts."""

from __future__ import annotations

import random
from importlib.metadata import entry_points

import pytest
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
from rosgraph_msgs.msg import Clock
from wrong_endurance import CAPACITY, OFFLINE, RATE_LIMIT, wrong_endurance

MESSAGES = 3
SAMPLE_RATE = 250.0
"""With 500 samples a second the nodes that drive the rig leave too little of two slow processors to all others."""


@pytest.mark.alone
def test_nothing_wrong_reaches_the_device_and_no_node_dies(graph):
    """All nodes around the bridge; those around the simulated rig are in `make verify PARTS=bounds`."""
    found = wrong_endurance(graph, "sensor_bridge", MESSAGES, random.Random(1), SAMPLE_RATE)
    assert found["not_finite"] == 0
    assert found["greatest_force"] <= CAPACITY
    assert found["worst_step"] <= RATE_LIMIT / SAMPLE_RATE * (1 + 1e-12), found["worst_between"]
    assert found["acting"] > 100, "forces acted meanwhile"
    own = {f"{graph.namespace}/{name}" for name in ("response", "brace_command", "ground_motion", "emergency_stop")}
    assert own | {"/emergency_stop"} <= found["topics"].keys()
    assert set(found["topics"].values()) == set(found["services"].values()) == {MESSAGES}
    called = {name.removeprefix(f"{graph.namespace}/").partition("/")[0] for name in found["services"]}
    assert called >= {*found["nodes"], "supervisor_monitor"}
    assert (found["died"], found["deaf"]) == (0, 0)
    services = {f"{graph.namespace}/sensor_bridge/{name}" for name in ("clear_fault", "change_state")}
    assert services <= found["services"].keys()
    assert max(found["at_device"].values()) <= 1 + 1e-9, found["at_device"]
    assert {"/diagnostics", "/stepped/brace_command", f"{graph.namespace}/joint_states"} <= found["topics"].keys()
    programs = {one.name for one in entry_points(group="console_scripts") if one.value.startswith("abrace_node.")}
    assert programs - OFFLINE - {"plant"} == set(found["programs"]), "every node is in one of the two graphs"
    nothing = SetParameters.Request(parameters=[Parameter(name="seed", value=ParameterValue(type=200))])
    (refused,) = graph.call(SetParameters, "sensor_bridge/set_parameters", nothing).results
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
