# SPDX-License-Identifier: Apache-2.0
"""A rig on one host, its commander and its operator on another: network namespaces with a link that is disturbed."""

from __future__ import annotations

import hosts
import pytest
import two_hosts

from abrace_core.safety.rig_safety import RAMP_TIME, State

pytestmark = pytest.mark.skipif(bool(hosts.missing()), reason=f"no two hosts here: {hosts.missing()}")

CASES = (
    two_hosts.Case("cut", 0.3, {"cut": True}),
    two_hosts.Case("stop", 0.5, {"loss": 0.05}, press=True),
)


def test_a_cut_and_a_stop_over_a_poor_link_take_the_force_along_the_ramp_to_zero(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cut, stop = two_hosts.run_cases(CASES)
    for row in (cut, stop):
        assert row["force_at_fault"], row
        assert row["falls_only"], "the force falls from the fault on"
        assert row["at_zero_until_cleared"], "and stays at zero, whatever comes when the link is back"
        assert abs(row["zero_ms"] - row["fault_ms"] - 1e3 * RAMP_TIME) < 5.0, "it takes the rig's ramp"
        assert row["worst_step_over_limit"] <= 1.0 + 1e-9
        assert row["cleared_s"] > 0.0, "cleared from the other host"
    assert cut["cause"].startswith("no brace_command for")
    assert cut["state_at_end"] == State.LATCHED
    assert "fault: no response for more than 0.1 s" in cut["commander"]
    assert stop["cause"] == "protective stop: pressed by /operator"
    assert stop["state_at_end"] == State.PROTECTIVE_STOP
