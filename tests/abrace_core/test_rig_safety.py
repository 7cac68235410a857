# SPDX-License-Identifier: Apache-2.0
"""What may act: every state with every event, and what acts on the way."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from state_table import EXPECTED, REQUESTS, StateWalk, cells

from abrace_core import AbraceError
from abrace_core.safety.command_guard import CommandGuard
from abrace_core.safety.rig_safety import ACTING, RAMP_TIME, REST_TIME, RigSafety, State
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
    safety.begin()
    until(safety, State.RUNNING)
    safety.act([[1000.0], [0.5]])
    return safety


def until(safety: RigSafety, state: State) -> None:
    for _ in range(1000):
        if safety.state is state:
            return
        safety.act([None, None])
    raise AssertionError(f"not {state.words}")


def faulty() -> RigSafety:
    safety = running()
    safety.fault("late")
    return safety


def latched() -> RigSafety:
    safety = faulty()
    until_rest(safety)
    return safety


def until_rest(safety: RigSafety) -> int:
    for count in range(3000):
        if safety.at_rest:
            return count
        safety.act([[5000.0], [1.0]])
    raise AssertionError("does not come to rest")


def test_every_event_in_every_state_leads_where_it_should():
    assert not list(StateWalk().differences())


@pytest.mark.parametrize(
    ("state", "event", "reason"),
    [
        ("unconfigured", "activate", "unconfigured"),
        ("standby", "configure", "inactive"),
        ("running", "cleanup", "active"),
        ("running", "clear_fault while active", "no fault"),
        ("ramping down", "activate", r"still ramping down \(planted\)"),
        ("latched", "activate", r"a fault is latched, expected a person to clear it first \(planted\)"),
        ("protective stop", "activate", r"a stop is pressed, expected it to be released and cleared first \(planted\)"),
        ("protective stop", "clear_fault while active", r"a stop is still pressed \(planted\)"),
    ],
)
def test_a_refusal_has_its_reason_and_changes_no_output(state, event, reason):
    safety = StateWalk().prepared(state)
    before = [list(output.value) for output in safety.outputs]
    with pytest.raises(AbraceError, match=f"^{reason}$"):
        StateWalk().do(safety, event)
    assert [output.value for output in safety.outputs] == before


@pytest.mark.parametrize(("state", "event"), list(cells(EXPECTED)))
def test_nothing_jumps_whatever_is_asked_for_in_whatever_state(state, event):
    walk = StateWalk(outputs, PERIOD)
    safety = walk.prepared(state, event)
    owned = safety.outputs
    before = [output.value[0] for output in owned]
    if event in REQUESTS:
        with contextlib.suppress(AbraceError):
            walk.do(safety, event)
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
    safety.press("pressed by panel")
    until_rest(safety)
    assert (safety.state, safety.cause, safety.pressed) == (State.PROTECTIVE_STOP, "late", "pressed by panel")
    with pytest.raises(AbraceError, match="a stop is still pressed"):
        safety.clear()
    safety.release()
    assert safety.state is State.LATCHED
    assert safety.clear() == "late"
    assert (safety.state, safety.cause) == (State.ARMING, "")


def test_a_stop_that_is_released_during_the_ramp_stays_latched():
    safety = running()
    safety.press("pressed by panel")
    safety.act([None, None])
    safety.release()
    until_rest(safety)
    assert (safety.state, safety.cause) == (State.LATCHED, "protective stop: pressed by panel")


def test_who_pressed_may_become_known_later():
    safety = running()
    safety.press("pressed by a node of unknown name")
    safety.press("pressed by panel")
    assert safety.cause == "protective stop: pressed by panel"
    safety.press("pressed by panel, pressed by desk")
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
    assert safety.state is State.ARMING


def test_it_is_not_cleared_while_an_input_moves():
    safety = latched()
    with pytest.raises(AbraceError, match=r"^brace_command still requests 8900$"):
        safety.clear("brace_command still requests 8900")
    assert safety.state is State.LATCHED


@pytest.mark.parametrize("way", ["activate", "clear"])
def test_after_activate_as_after_clear_commands_fade_in(way):
    safety = configured() if way == "activate" else latched()
    getattr(safety, way)()
    safety.act([[20_000.0], [0.0]])
    assert safety.outputs[0].value == [0.0], "the target is not armed yet"
    safety.begin()
    forces = []
    while safety.state is State.FADING_IN:
        safety.act([[20_000.0], [0.0]])
        forces.append(safety.outputs[0].value[0])
    assert len(forces) == STEPS
    steps = np.diff(forces, prepend=0.0)
    assert (steps > 0).all()
    assert steps.max() < 20_000 * np.pi / 2 / STEPS * 1.01
    assert forces[-1] == 20_000.0


@pytest.mark.parametrize("way", ["activate", "clear"])
@pytest.mark.parametrize(
    ("moving", "measured", "cause"),
    [
        ("brace_command still requests 24000", "", "brace_command still requests 24000"),
        ("", "fa 20000 N", "measured fa 20000 N, expected the rig at rest first"),
    ],
)
def test_neither_activate_nor_clear_lets_commands_act_while_something_is_not_at_rest(way, moving, measured, cause):
    safety = configured() if way == "activate" else latched()
    getattr(safety, way)()
    safety.look(measured)
    safety.begin(moving)
    assert safety.state is State.LATCHED
    assert safety.cause.startswith(cause)


def test_a_force_that_is_measured_after_the_ramp_is_a_state_of_its_own_until_it_has_gone():
    safety = running()
    safety.press("pressed by panel")
    samples = 0
    while safety.state is State.RAMPING_DOWN:
        safety.act([None, None])
        safety.look("fa 20000 N")
        samples += 1
    assert safety.state is State.NOT_AT_REST
    assert not safety.at_rest
    assert samples <= STEPS + round(REST_TIME / PERIOD) + 1
    safety.release()
    for clear in (safety.clear, safety.activate):
        with pytest.raises(AbraceError, match="not at rest"):
            clear()
    for _ in range(round(REST_TIME / PERIOD) + 1):
        assert safety.state is State.NOT_AT_REST, "one reading within the limit is not rest"
        safety.look("")
    assert safety.state is State.LATCHED
    safety.look("fa 20000 N")
    with pytest.raises(AbraceError, match="measured fa 20000 N, expected the rig at rest first"):
        safety.clear()
    for _ in range(round(REST_TIME / PERIOD)):
        safety.look("fa 20000 N")
    assert safety.state is State.NOT_AT_REST, "a force that comes later, too"


def test_a_stop_is_still_pressed_after_a_cleanup_that_did_not_come_to_rest():
    safety = StateWalk().prepared("not at rest")
    safety.press("pressed by panel")
    safety.clean_up()
    assert safety.state is State.PROTECTIVE_STOP


def test_missed_samples_do_not_lengthen_the_ramp():
    safety = faulty()
    count = 0
    while not safety.outputs[0].at_rest:
        safety.act([None, None], 5)
        count += 1
    assert count == STEPS // 5 + 1, "the first step is one sample: it begins now"


class Recording(RigSafety):
    """Notes which events are asked for in which states."""

    def __init__(self) -> None:
        super().__init__()
        self.asked = set()

    def _outcome(self, event):
        self.asked.add((self.state.words, event.value))
        return super()._outcome(event)


@settings(max_examples=100)
@given(st.lists(st.one_of(st.sampled_from(REQUESTS), st.lists(st.floats(), max_size=2)), max_size=80))
def test_nothing_acts_but_while_acting_whatever_happens(events):
    walk, safety = StateWalk(outputs, PERIOD), Recording()
    before = 0.0
    for event in events:
        if isinstance(event, str):
            with contextlib.suppress(AbraceError):
                walk.do(safety, event)
        elif safety.outputs:
            safety.act([event, None])
        now = safety.outputs[0].value[0] if safety.outputs else 0.0
        assert np.isfinite(now)
        if safety.outputs and event != "configure":
            assert abs(now - before) <= 5e6 * PERIOD * (1 + 1e-12)
        before = now
        if safety.state not in (*ACTING, State.RAMPING_DOWN):
            assert not now
    assert safety.asked <= cells(EXPECTED).keys(), "what cannot happen by the table has happened"
