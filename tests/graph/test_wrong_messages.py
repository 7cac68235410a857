# SPDX-License-Identifier: Apache-2.0
"""Messages of right types and wrong content on every topic and service: no node dies, and nothing wrong acts."""

from __future__ import annotations

import random
from importlib.metadata import entry_points

import pytest
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
from wrong_endurance import CAPACITY, OFFLINE, RATE_STEP, wrong_endurance

MESSAGES = 10


@pytest.mark.parametrize("rig", ["sensor_bridge", "plant"])
def test_nothing_wrong_reaches_the_device_and_no_node_dies(graph, rig):
    found = wrong_endurance(graph, rig, MESSAGES, random.Random(1))
    assert found["not_finite"] == 0
    assert found["greatest_force"] <= CAPACITY
    assert found["worst_step"] <= RATE_STEP * (1 + 1e-12), found["worst_between"]
    assert found["acting"] > 100, "forces acted meanwhile"
    own = {f"{graph.namespace}/{name}" for name in ("response", "brace_command", "ground_motion", "emergency_stop")}
    assert own | {"/emergency_stop"} <= found["topics"].keys()
    assert set(found["topics"].values()) == set(found["services"].values()) == {MESSAGES}
    called = {name.removeprefix(f"{graph.namespace}/").partition("/")[0] for name in found["services"]}
    assert called >= ({"plant"} if rig == "plant" else {*found["nodes"], "supervisor_monitor"})
    assert found["died"] == 0
    assert {f"{graph.namespace}/{rig}/{name}" for name in ("clear_fault", "change_state")} <= found["services"].keys()
    if rig == "sensor_bridge":
        assert max(found["at_device"].values()) <= 1 + 1e-9, found["at_device"]
        assert {"/diagnostics", "/stepped/brace_command", f"{graph.namespace}/joint_states"} <= found["topics"].keys()
        programs = {one.name for one in entry_points(group="console_scripts") if one.value.startswith("abrace_core.")}
        assert programs - OFFLINE - {"plant"} == set(found["programs"]), "every node is in one of the two graphs"
    nothing = SetParameters.Request(parameters=[Parameter(name="seed", value=ParameterValue(type=200))])
    (refused,) = graph.call(SetParameters, f"{rig}/set_parameters", nothing).results
    assert not refused.successful
    assert "seed: type 200" in refused.reason
