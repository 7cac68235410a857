# SPDX-License-Identifier: Apache-2.0
"""What may act: every state with every event, and what acts on the way."""

import contextlib
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from abrace_core.errors import AbraceError
from abrace_core.safety.command_guard import CommandGuard
from abrace_core.safety.rig_safety import ACTING, RAMP_TIME, TRANSITIONS, Event, RigSafety, State
from abrace_core.safety.table_guard import TableGuard
from abrace_core.safety.table_stop import Table

PERIOD = 0.002
TABLE = Table(10.0, 2000.0, 1.0, 0.25)
STEPS = round(RAMP_TIME / PERIOD)


def outputs() -> list:
    return [CommandGuard([24_000.0], [5e6], PERIOD, RAMP_TIME), TableGuard(TABLE, PERIOD)]


def configured() -> RigSafety:
    safety = RigSafety()
    safety.configure(outputs(), PERIOD)
    return safety


def running() -> RigSafety:
    safety = configured()
    safety.activate()
    safety.act([[1000.0], [0.5]])
    return safety


def faulty() -> RigSafety:
    safety = running()
    safety.fault("late")
    return safety


def latched() -> RigSafety:
    safety = faulty()
    until_rest(safety)
    return safety


def stopped() -> RigSafety:
    safety = latched()
    safety.stop("pressed by panel")
    return safety


def fading() -> RigSafety:
    safety = latched()
    safety.clear()
    safety.act([[0.0], [0.0]])
    return safety


def until_rest(safety: RigSafety) -> int:
    for count in range(3000):
        if safety.at_rest:
            return count
        safety.act([[5000.0], [1.0]])
    raise AssertionError("does not come to rest")


MADE = {
    State.UNCONFIGURED: RigSafety,
    State.STANDBY: configured,
    State.FADING_IN: fading,
    State.RUNNING: running,
    State.RAMPING_DOWN: faulty,
    State.LATCHED: latched,
    State.PROTECTIVE_STOP: stopped,
}
ASKED = {
    Event.CONFIGURE: lambda safety: safety.configure(outputs(), PERIOD),
    Event.CLEAN_UP: RigSafety.clean_up,
    Event.ACTIVATE: RigSafety.activate,
    Event.DEACTIVATE: RigSafety.deactivate,
    Event.FAULT: lambda safety: safety.fault("a fault"),
    Event.STOP: lambda safety: safety.stop("pressed by panel"),
    Event.RELEASE: lambda safety: safety.stop(""),
    Event.CLEAR_ACTIVE: RigSafety.clear,
}
"""What people and nodes do; the other events come by themselves."""


def test_the_table_has_every_state_with_every_event():
    assert set(TRANSITIONS) == set(State)
    assert all(set(row) == set(Event) for row in TRANSITIONS.values())
    assert len(State) * len(Event) == sum(map(len, TRANSITIONS.values()))


@pytest.mark.parametrize(("state", "event"), list(itertools.product(State, Event)))
def test_every_state_goes_with_every_event_where_the_table_says(state, event):
    safety = MADE[state]()
    assert safety.state is state
    expected = TRANSITIONS[state][event]
    before = [list(output.value) for output in safety.outputs]
    if isinstance(expected, str):
        with pytest.raises(AbraceError, match=expected[:20]):
            safety._take(event)
        assert safety.state is state
        assert [output.value for output in safety.outputs] == before
    else:
        safety._take(event)
        assert safety.state is expected


@pytest.mark.parametrize(("state", "event"), list(itertools.product(State, ASKED)))
def test_nothing_jumps_whatever_is_asked_for_in_whatever_state(state, event):
    safety = MADE[state]()
    owned = safety.outputs
    before = [output.value[0] for output in owned]
    try:
        ASKED[event](safety)
    except AbraceError:
        assert safety.state is state
    for _ in range(600):
        safety.act([[24_000.0], [5.0]] if safety.outputs else [])
        if not owned or safety.outputs is not owned:
            break
        now = [output.value[0] for output in owned]
        assert abs(now[0] - before[0]) <= 5e6 * PERIOD * (1 + 1e-12)
        assert abs(now[1] - before[1]) <= 2000.0 * PERIOD * (1 + 1e-12)
        if safety.state not in (*ACTING, State.RAMPING_DOWN):
            assert not any(now)
        before = now


def test_what_is_commanded_passes_bit_for_bit_while_running():
    safety = running()
    for force, acceleration in np.random.default_rng(1).normal(0, (1500.0, 0.3), (500, 2)):
        safety.act([[force], [acceleration]])
        assert [output.value for output in safety.outputs] == [[force], [acceleration]]


def test_a_fault_of_one_input_stops_both():
    for bad in ([[float("nan")], [0.1]], [[0.0], [float("inf")]], [[1.0, 2.0], [0.1]]):
        safety = running()
        safety.act(bad)
        assert safety.state is State.RAMPING_DOWN
        until_rest(safety)
        assert safety.state is State.LATCHED
        assert not any(output.value[0] for output in safety.outputs)
        assert abs(safety.outputs[1].state.velocity) < 1e-12


def test_the_first_cause_is_kept_until_a_person_clears_it():
    safety = faulty()
    safety.fault("another")
    safety.stop("pressed by panel")
    until_rest(safety)
    assert (safety.state, safety.cause, safety.pressed) == (State.PROTECTIVE_STOP, "late", "pressed by panel")
    with pytest.raises(AbraceError, match="a stop is still pressed"):
        safety.clear()
    safety.stop("")
    assert safety.state is State.LATCHED
    assert safety.clear() == "late"
    assert (safety.state, safety.cause) == (State.FADING_IN, "")


def test_a_stop_that_is_released_during_the_ramp_stays_latched():
    safety = running()
    safety.stop("pressed by panel")
    safety.act([None, None])
    safety.stop("")
    until_rest(safety)
    assert (safety.state, safety.cause) == (State.LATCHED, "protective stop: pressed by panel")


def test_who_pressed_may_become_known_later():
    safety = running()
    safety.stop("pressed by a node of unknown name")
    safety.stop("pressed by panel")
    assert safety.cause == "protective stop: pressed by panel"
    safety.stop("pressed by panel, pressed by desk")
    assert safety.cause == "protective stop: pressed by panel", "the first cause is kept"


def test_a_fault_outlives_the_life_cycle():
    safety = latched()
    safety.deactivate()
    safety.clean_up()
    safety.configure(outputs(), PERIOD)
    with pytest.raises(AbraceError, match=r"a fault is latched, expected a person to clear it first \(late\)"):
        safety.activate()
    safety.clear()
    assert safety.state is State.STANDBY
    safety.activate()
    assert safety.state is State.RUNNING


def test_it_is_not_cleared_while_an_input_moves():
    safety = latched()
    with pytest.raises(AbraceError, match="brace_command still requests 8900, expected every input at rest first"):
        safety.clear("brace_command still requests 8900")
    assert safety.state is State.LATCHED


def test_after_it_is_cleared_commands_fade_in():
    safety = latched()
    safety.clear()
    forces = []
    while safety.state is State.FADING_IN:
        safety.act([[20_000.0], [0.0]])
        forces.append(safety.outputs[0].value[0])
    assert len(forces) == STEPS
    steps = np.diff(forces, prepend=0.0)
    assert (steps > 0).all()
    assert steps.max() < 20_000 * np.pi / 2 / STEPS * 1.01
    assert forces[-1] == 20_000.0


def test_deactivation_ends_in_standby_within_the_ramp_time():
    safety = running()
    safety.act([[5000.0], [0.0]])
    safety.outputs[1].reset()
    safety.deactivate()
    assert until_rest(safety) <= STEPS
    assert safety.state is State.STANDBY


def test_missed_samples_do_not_lengthen_the_ramp():
    safety = faulty()
    count = 0
    while not safety.outputs[0].at_rest:
        safety.act([None, None], 5)
        count += 1
    assert count == STEPS // 5 + 1, "the first step is one sample: it begins now"


@settings(max_examples=100)
@given(st.lists(st.one_of(st.sampled_from(list(ASKED)), st.lists(st.floats(), max_size=2)), max_size=80))
def test_nothing_acts_but_while_acting_whatever_happens(events):
    safety = RigSafety()
    before = 0.0
    for event in events:
        if isinstance(event, Event):
            with contextlib.suppress(AbraceError):
                ASKED[event](safety)
        elif safety.outputs:
            safety.act([event, None])
        now = safety.outputs[0].value[0] if safety.outputs else 0.0
        assert np.isfinite(now)
        if safety.outputs and event is not Event.CONFIGURE:
            assert abs(now - before) <= 5e6 * PERIOD * (1 + 1e-12) or not safety.outputs
        before = now
        if safety.state in (State.UNCONFIGURED, State.STANDBY, State.LATCHED, State.PROTECTIVE_STOP):
            assert not now
