# SPDX-License-Identifier: Apache-2.0
"""A rig on one host, its commander and its operator on another: network namespaces with a link that is disturbed."""

from __future__ import annotations

import hosts
import pytest
import two_hosts

from abrace_core.safety.rig_safety import State

CASES = (
    two_hosts.Case("cut for 0.3 s", 0.3, {"cut": True}),
    two_hosts.Case("stop pressed, 5 % loss", 0.5, {"loss": 0.05}, press=True),
)


@pytest.mark.alone
@pytest.mark.skipif(bool(hosts.missing()), reason=f"no two hosts here: {hosts.missing()}")
def test_a_cut_and_a_stop_over_a_poor_link_take_the_force_along_the_ramp_to_zero(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cut, stop = two_hosts.run_cases(CASES)
    assert cut["expected"] == "fault"
    assert stop["expected"] == "stop"
    for row in (cut, stop):
        assert row["force_at_fault"], row
        assert row["cleared_s"] > 0.0, "cleared from the other host"
        assert not row["problems"], row
    assert stop["cause"] == "protective stop: pressed by /operator"


PROMISED = {
    "conditions": {"cut": True},
    "name": "",
    "seconds": 0.3,
    "press": False,
    "command_timeout": 0.02,
    "worst_step_over_limit": 0.5,
    "worst_step_at_device": 0.5,
    "controller": "fault: no response for more than 0.1 s",
    "fault_ms": 22.0,
    "zero_ms": 522.0,
    "gap_ms": 2.0,
    "falls_only": True,
    "at_zero_until_cleared": True,
    "cause": "no brace_command for 11 samples",
    "state_at_end": State.LATCHED,
}


def test_what_the_rig_promises_is_judged():
    assert not two_hosts.problems(PROMISED)
    for broken in (
        {"worst_step_over_limit": 1.01},
        {"worst_step_at_device": 1.01},
        {"controller": "running"},
        {"fault_ms": None},
        {"fault_ms": 40.0, "zero_ms": 540.0},
        {"zero_ms": 600.0},
        {"zero_ms": 30.0},
        {"falls_only": False},
        {"at_zero_until_cleared": False},
        {"cause": "samples missed"},
        {"state_at_end": State.PROTECTIVE_STOP},
        {"seconds": 0.005},
    ):
        assert two_hosts.problems(PROMISED | broken), broken
