# SPDX-License-Identifier: Apache-2.0
"""What a node makes of the samples that it answers."""

import pytest

from abrace_core.errors import AbraceError
from abrace_core.safety.answering import DROP, HOLD, RESPONSE_TIMEOUT, RESTART, Answering
from abrace_core.safety.command_guard import CommandGuard
from abrace_core.safety.rig_safety import State
from abrace_core.wire import LAST, LOCKSTEP, Head

PERIOD = 2_000_000


@pytest.fixture
def answering() -> Answering:
    answering = Answering()
    answering.configure([CommandGuard([20e3], [5e6], 0.002, 0.5)], 0.002)
    answering.activate()
    return answering


def receive(answering, sequence, state=State.RUNNING, cause="", run=1, flags=0) -> int:
    return answering.receive(sequence * PERIOD, Head(sequence, run, 0, flags, state), cause, sequence * 0.002)


def test_it_begins_with_the_first_sample_and_goes_on(answering):
    assert [receive(answering, k) for k in (5, 6, 8)] == [RESTART, 0, 1]


def test_an_old_sample_is_dropped_and_nothing_begins_anew(answering):
    receive(answering, 5)
    answering.safety.act([[8000.0]])
    assert receive(answering, 4) == DROP
    assert receive(answering, 5) == DROP
    answering.safety.act([None])
    assert answering.safety.outputs[0].value == [8000.0]
    assert receive(answering, 6) == 0


def test_another_run_of_the_rig_is_answered_from_rest(answering):
    receive(answering, 5, flags=LAST)
    answering.safety.act([[8000.0]])
    assert receive(answering, 0, run=2) == RESTART
    assert answering.safety.outputs[0].value == [0.0]
    assert not answering.safety.cause


def test_a_rig_that_begins_while_another_one_runs_is_commanded_nothing(answering):
    """A bridge that is started beside the simulated rig of the rehearsal."""
    receive(answering, 5, flags=LOCKSTEP)
    answering.safety.act([[8000.0]])
    assert receive(answering, 0, run=2) == RESTART
    answering.safety.act([None])
    assert answering.safety.outputs[0].value == [0.0]
    assert answering.safety.cause == "a run began during another one: two rigs publish response, expected one"
    for k in range(6, 10):
        for run, first in ((1, 0), (2, 6)):
            assert receive(answering, k - first, run=run, state=State.LATCHED) == HOLD, "both learn of it"
    answering.safety.clear()
    answering.begin_anew()
    assert [receive(answering, k) for k in (10, 11)] == [RESTART, 0], "one that is left goes on"
    assert not answering.safety.cause


@pytest.mark.parametrize(("flags", "pause"), [(LAST, 0), (0, 60), (LOCKSTEP, 0)])
def test_a_rig_that_begins_after_another_one_is_no_fault(answering, flags, pause):
    """After its last sample, its end without one, or where runs in lockstep follow each other."""
    receive(answering, 5, flags=flags)
    assert receive(answering, 6 + pause, run=2, flags=flags & LOCKSTEP) == RESTART
    assert not answering.safety.cause


def test_while_the_rig_is_stopped_nothing_is_wanted_and_then_it_begins_anew(answering):
    receive(answering, 5)
    answering.safety.act([[8000.0]])
    for k, state in enumerate((State.RAMPING_DOWN, State.LATCHED, State.PROTECTIVE_STOP), 6):
        assert receive(answering, k, state, "protective stop: pressed by panel") == HOLD
        answering.safety.act([None])
        assert answering.safety.outputs[0].value == [0.0]
    assert answering.held == "the rig is protective stop: protective stop: pressed by panel"
    assert receive(answering, 9, State.FADING_IN) == RESTART
    assert not answering.held
    assert receive(answering, 10) == 0


def test_a_state_that_it_does_not_know_lets_nothing_act(answering):
    assert receive(answering, 5, 99) == HOLD
    assert answering.held == "the rig is in state 99"


def test_samples_lost_before_anything_was_sent_are_no_fault_and_it_begins_anew(answering):
    receive(answering, 5)
    answering.safety.act([[0.0]])
    assert receive(answering, 50) == RESTART
    assert answering.watch.missing == 44
    assert not answering.safety.cause


def test_lost_samples_are_a_latched_fault_of_its_own(answering):
    receive(answering, 5)
    answering.safety.act([[500.0]])
    assert receive(answering, 50) == 44
    assert "44 samples lost" in answering.safety.cause
    assert answering.safety.state is State.RAMPING_DOWN
    answering.safety.deactivate()
    answering.safety.rest()
    answering.safety.clean_up()
    answering.configure([CommandGuard([20e3], [5e6], 0.002, 0.5)], 0.002)
    with pytest.raises(AbraceError, match="a fault is latched"):
        answering.activate()


def test_the_silence_of_a_rig_that_samples_by_the_clock_is_a_fault(answering):
    answering.look_for_silence(100.0)
    assert not answering.safety.cause, "none has been heard"
    receive(answering, 5)
    answering.safety.act([[8000.0]])
    answering.look_for_silence(0.01 + RESPONSE_TIMEOUT * 0.9)
    assert not answering.safety.cause
    answering.look_for_silence(0.01 + RESPONSE_TIMEOUT * 1.1)
    assert answering.safety.cause == "no response for more than 0.1 s"
    assert (answering.safety.state, answering.safety.outputs[0].value) == (State.LATCHED, [0.0])


@pytest.mark.parametrize("flags", [LOCKSTEP, LAST])
def test_a_rig_in_lockstep_and_one_whose_run_has_ended_may_be_silent(answering, flags):
    receive(answering, 5, flags=flags)
    answering.look_for_silence(100.0)
    assert not answering.safety.cause
