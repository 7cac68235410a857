# SPDX-License-Identifier: Apache-2.0
"""What a node makes of the samples that it answers."""

import pytest

from abrace_core import AbraceError
from abrace_core.safety.command_guard import CommandGuard
from abrace_core.safety.rig_safety import State
from abrace_core.safety.sample_gate import DROP, HOLD, RESPONSE_TIMEOUT, RESTART, SampleGate
from abrace_core.safety.wire import LAST, LOCKSTEP, Head

PERIOD = 2_000_000


@pytest.fixture
def gate() -> SampleGate:
    gate = SampleGate()
    gate.configure([CommandGuard([20e3], [5e6], 0.002, 0.5)], 0.002)
    gate.activate()
    return gate


def receive(gate, sequence, state=State.RUNNING, cause="", run=1, flags=0) -> int:
    return gate.receive(sequence * PERIOD, Head(sequence, run, 0, flags, state), cause, sequence * 0.002)


def test_it_begins_with_the_first_sample_and_goes_on(gate):
    assert [receive(gate, k) for k in (5, 6, 8)] == [RESTART, 0, 1]


def test_an_old_sample_is_dropped_and_nothing_begins_anew(gate):
    receive(gate, 5)
    gate.safety.act([[8000.0]])
    assert receive(gate, 4) == DROP
    assert receive(gate, 5) == DROP
    gate.safety.act([None])
    assert gate.safety.outputs[0].value == [8000.0]
    assert receive(gate, 6) == 0


def test_another_run_of_the_rig_is_answered_from_rest(gate):
    receive(gate, 5, flags=LAST)
    gate.safety.act([[8000.0]])
    assert receive(gate, 0, run=2) == RESTART
    assert gate.safety.outputs[0].value == [0.0]
    assert not gate.safety.cause


def test_a_rig_that_begins_while_another_one_runs_is_commanded_nothing(gate):
    """A bridge that is started beside the simulated rig of the rehearsal."""
    receive(gate, 5, flags=LOCKSTEP)
    gate.safety.act([[8000.0]])
    assert receive(gate, 0, run=2) == RESTART
    gate.safety.act([None])
    assert gate.safety.outputs[0].value == [0.0]
    assert gate.safety.cause == "a run began during another one: two rigs publish response, expected one"
    for k in range(6, 10):
        for run, first in ((1, 0), (2, 6)):
            assert receive(gate, k - first, run=run, state=State.LATCHED) == HOLD, "both learn of it"
    gate.safety.clear()
    gate.begin_anew()
    assert [receive(gate, k) for k in (10, 11)] == [RESTART, 0], "one that is left goes on"
    assert not gate.safety.cause


@pytest.mark.parametrize(("flags", "pause"), [(LAST, 0), (0, 60), (LOCKSTEP, 0)])
def test_a_rig_that_begins_after_another_one_is_no_fault(gate, flags, pause):
    """After its last sample, its end without one, or where runs in lockstep follow each other."""
    receive(gate, 5, flags=flags)
    assert receive(gate, 6 + pause, run=2, flags=flags & LOCKSTEP) == RESTART
    assert not gate.safety.cause


def test_while_the_rig_is_stopped_nothing_is_wanted_and_then_it_begins_anew(gate):
    receive(gate, 5)
    gate.safety.act([[8000.0]])
    for k, state in enumerate((State.RAMPING_DOWN, State.LATCHED, State.PROTECTIVE_STOP), 6):
        assert receive(gate, k, state, "protective stop: pressed by panel") == HOLD
        gate.safety.act([None])
        assert gate.safety.outputs[0].value == [0.0]
    assert gate.held == "rig in protective stop (pressed by panel)"
    assert receive(gate, 9, State.ARMING) == HOLD
    assert gate.held == "rig arming"
    assert receive(gate, 10, State.FADING_IN) == HOLD
    assert gate.held == "rig fading in"
    assert receive(gate, 11) == RESTART
    assert not gate.held
    assert receive(gate, 12) == 0


def test_a_state_that_it_does_not_know_lets_nothing_act(gate):
    assert receive(gate, 5, 99) == HOLD
    assert gate.held == "rig in state 99"


def test_samples_lost_before_anything_was_sent_are_no_fault_and_it_begins_anew(gate):
    receive(gate, 5)
    gate.safety.act([[0.0]])
    assert receive(gate, 50) == RESTART
    assert gate.watch.missing == 44
    assert not gate.safety.cause


def test_lost_samples_are_a_latched_fault_of_its_own(gate):
    receive(gate, 5)
    gate.safety.act([[500.0]])
    assert receive(gate, 50) == 44
    assert "44 samples lost" in gate.safety.cause
    assert gate.safety.state is State.RAMPING_DOWN
    gate.safety.deactivate()
    gate.safety.rest()
    gate.safety.clean_up()
    gate.configure([CommandGuard([20e3], [5e6], 0.002, 0.5)], 0.002)
    with pytest.raises(AbraceError, match="a fault is latched"):
        gate.activate()


def test_the_silence_of_a_rig_that_samples_by_the_clock_is_a_fault(gate):
    gate.look_for_silence(100.0)
    assert not gate.safety.cause, "none has been heard"
    receive(gate, 5)
    gate.safety.act([[8000.0]])
    gate.look_for_silence(0.01 + RESPONSE_TIMEOUT * 0.9)
    assert not gate.safety.cause
    gate.look_for_silence(0.01 + RESPONSE_TIMEOUT * 1.1)
    assert gate.safety.cause == "no response for more than 0.1 s"
    assert (gate.safety.state, gate.safety.outputs[0].value) == (State.LATCHED, [0.0])


@pytest.mark.parametrize("flags", [LOCKSTEP, LAST])
def test_a_rig_in_lockstep_and_one_whose_run_has_ended_may_be_silent(gate, flags):
    receive(gate, 5, flags=flags)
    gate.look_for_silence(100.0)
    assert not gate.safety.cause


@pytest.mark.parametrize(
    ("state", "reason"),
    [
        (State.STANDBY, "rig in standby"),
        (State.FADING_IN, "rig fading in"),
        (State.PROTECTIVE_STOP, "rig in protective stop"),
        (State.LATCHED, "rig latched"),
    ],
)
def test_a_goal_is_refused_with_the_reason_until_the_rig_runs(gate, state, reason):
    with pytest.raises(AbraceError, match=r"^no rig is running$"):
        gate.begin_goal(0.0)
    receive(gate, 5, state)
    with pytest.raises(AbraceError, match=f"^{reason}$"):
        gate.begin_goal(0.01)
    receive(gate, 6)
    gate.begin_goal(0.012)
    assert gate.goal_run == 1
    with pytest.raises(AbraceError, match=r"^no rig is running$"):
        gate.begin_goal(0.012 + 2 * RESPONSE_TIMEOUT)
    gate.safety.act([[8000.0]])
    gate.safety.deactivate()
    with pytest.raises(AbraceError, match=r"^the node's commands are ramping down$"):
        gate.begin_goal(0.012)


def test_a_goal_is_awaited_once_in_each_run_of_a_rig_in_lockstep(gate):
    receive(gate, 5, flags=LAST)
    assert not gate.awaits_goal, "by the clock nobody waits"
    for run in (2, 3):
        receive(gate, 0, State.FADING_IN, run=run, flags=LOCKSTEP)
        assert not gate.awaits_goal
        receive(gate, 1, run=run, flags=LOCKSTEP)
        assert gate.awaits_goal
        gate.begin_goal(100.0)
        receive(gate, 2, run=run, flags=LOCKSTEP)
        assert not gate.awaits_goal
