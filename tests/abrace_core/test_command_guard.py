from array import array

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from abrace_core.errors import AbraceError
from abrace_core.safety.command_guard import CommandGuard

CAPACITY, RATE, PERIOD, RAMP = 24516.625, 5.0e6, 0.002, 0.1


def guard(groups: int = 1) -> CommandGuard:
    return CommandGuard([CAPACITY] * groups, [RATE] * groups, PERIOD, RAMP)


def test_command_with_nothing_wrong_passes_bit_for_bit():
    commands = np.random.default_rng(0).normal(0.0, 1500.0, (2000, 2))
    guarded = guard(2)
    passed = np.array([guarded.check(command) for command in commands])
    assert passed.tobytes() == commands.tobytes()
    assert (guarded.saturations, guarded.rate_limits, guarded.fault_reason) == (0, 0, None)


def test_message_arrays_are_taken_as_they_come():
    assert guard(2).check(array("d", [1.5, -2.5])).tolist() == [1.5, -2.5]


def test_last_command_holds_until_the_next_and_before_the_first_it_is_zero():
    guarded = guard()
    assert guarded.check(None).tolist() == [0.0]
    guarded.check(np.array([120.0]))
    assert guarded.check(None).tolist() == [120.0]


def test_returned_array_and_given_array_are_the_callers_own():
    guarded = guard()
    command = np.array([100.0])
    force = guarded.check(command)
    force[0], command[0] = 7.0, 9.0
    assert guarded.check(None).tolist() == [100.0]


def test_command_beyond_capacity_is_cut_to_it_and_counted():
    guarded = CommandGuard([1000.0, 2000.0], [1e9, 1e9], PERIOD, RAMP)
    assert guarded.check(np.array([1500.0, -1500.0])).tolist() == [1000.0, -1500.0]
    assert guarded.check(np.array([-999.0, -9000.0])).tolist() == [-999.0, -2000.0]
    assert guarded.check(np.array([1000.0, -2000.0])).tolist() == [1000.0, -2000.0]
    assert guarded.saturations == 2


def test_command_too_fast_is_followed_at_the_rate_limit_and_counted():
    guarded = CommandGuard([1000.0], [50_000.0], PERIOD, RAMP)  # 100 N a sample
    forces = [guarded.check(np.array([250.0]))[0], guarded.check(None)[0], guarded.check(None)[0]]
    assert forces == [100.0, 200.0, 250.0]
    assert guarded.check(np.array([-1000.0])).tolist() == [150.0]
    assert guarded.rate_limits == 3


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (np.array([np.nan, 0.0]), "finite"),
        (np.array([0.0, -np.inf]), "finite"),
        (np.array([1.0]), "shape"),
        (np.array([1.0, 2.0, 3.0]), "shape"),
        (np.array([]), "shape"),
        (np.array([[1.0, 2.0]]), "shape"),
        (np.array(["one", "two"]), "expected numbers"),
    ],
)
def test_command_that_cannot_act_is_a_latched_fault(command, reason):
    guarded = guard(2)
    guarded.check(np.array([500.0, -500.0]))
    for _ in range(50):
        force = guarded.check(command)
        command = np.array([500.0, -500.0])
    assert reason in guarded.fault_reason
    assert force.tolist() == [0.0, 0.0], "a fault stays, whatever is commanded later"


def test_fault_brings_the_force_down_monotonically_within_the_ramp_time_and_keeps_it_at_zero():
    guarded = guard(2)
    for _ in range(5):
        start = guarded.check(np.array([20_000.0, -10_000.0]))
    assert start.tolist() == [20_000.0, -10_000.0]
    guarded.fault("emergency stop")
    steps = round(RAMP / PERIOD)
    forces = np.array([guarded.check(np.array([20_000.0, -10_000.0])) for _ in range(steps + 20)])
    fall = np.diff(np.vstack([start, forces[:steps]]), axis=0)
    assert (fall[:, 0] < 0).all()
    assert (fall[:, 1] > 0).all()
    assert not forces[steps - 1 :].any()
    assert np.abs(fall).max() == pytest.approx(20_000.0 * np.pi / 2 / steps, rel=0.01), "a half cosine"
    assert np.abs(fall[0]).max() < 0.1 * np.abs(fall).max(), "no jerk at its start"


def test_only_the_first_reason_is_kept_until_the_guard_is_cleared():
    guarded = guard()
    guarded.fault("stroke beyond its limit")
    guarded.fault("late command")
    guarded.check(np.array([np.nan]))
    assert guarded.fault_reason == "stroke beyond its limit"
    guarded.clear()
    assert guarded.fault_reason is None


def test_cleared_guard_starts_from_zero_and_needs_a_new_command():
    guarded = guard()
    guarded.check(np.array([5000.0]))
    guarded.fault("test")
    for _ in range(60):
        guarded.check(None)
    guarded.clear()
    assert guarded.check(None).tolist() == [0.0], "the command before the fault does not come back"
    assert guarded.check(np.array([24_000.0])).tolist() == [RATE * PERIOD]


def test_guard_cleared_during_its_ramp_goes_on_without_a_jump():
    guarded = CommandGuard([1000.0], [50_000.0], PERIOD, RAMP)
    for _ in range(12):
        guarded.check(np.array([1000.0]))
    guarded.fault("test")
    for _ in range(10):
        before = guarded.check(None)[0]
    guarded.clear()
    assert guarded.check(None)[0] == pytest.approx(before - 100.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"capacity": [-1.0]}, "capacity"),
        ({"capacity": [np.nan]}, "capacity"),
        ({"rate_limit": [0.0]}, "rate_limit"),
        ({"rate_limit": [1.0, 2.0]}, "one number for each brace group"),
        ({"capacity": 5.0, "rate_limit": 5.0}, "one number for each brace group"),
        ({"sample_period": 0.0}, "sample_period"),
        ({"ramp_time": -1.0}, "ramp_time"),
        ({"ramp_time": 0.001}, "expected at least 0.008 s to bring 24516.6 N to zero at 5e\\+06 N/s"),
        ({"ramp_time": 0.006}, "at least 0.008 s"),
    ],
)
def test_limits_that_cannot_be_kept_are_refused(change, message):
    arguments = {"capacity": [CAPACITY], "rate_limit": [RATE], "sample_period": PERIOD, "ramp_time": RAMP} | change
    with pytest.raises(AbraceError, match=message):
        CommandGuard(**arguments)


def test_shortest_ramp_time_that_the_refusal_names_is_accepted():
    guarded = CommandGuard([CAPACITY], [RATE], PERIOD, 0.008)
    assert guarded.fault_reason is None


EVENTS = st.lists(
    st.one_of(
        st.none(),
        st.sampled_from(["fault", "clear"]),
        st.lists(st.floats(-2e5, 2e5), min_size=2, max_size=2),
        st.lists(st.floats(), min_size=0, max_size=3),
    ),
    max_size=120,
)


@settings(max_examples=150, deadline=None)
@given(
    events=EVENTS,
    rate=st.floats(5e6, 1e9),
    ramp=st.floats(0.02, 0.3),
)
def test_force_is_finite_within_capacity_and_rate_and_off_within_the_ramp_time_whatever_happens(events, rate, ramp):
    capacity, rates = np.array([24_000.0, 5_000.0]), np.array([rate, 2 * rate])
    guarded = CommandGuard(capacity, rates, PERIOD, ramp)
    last, since_fault = np.zeros(2), 0
    for event in events + [None] * 5:
        command = None
        if event == "fault":
            guarded.fault("property")
        elif event == "clear":
            guarded.clear()
            since_fault = 0
        elif event is not None:
            command = np.array(event)
        force = guarded.check(command)
        assert np.isfinite(force).all()
        assert (np.abs(force) <= capacity).all()
        assert (np.abs(force - last) <= rates * PERIOD * (1 + 1e-12)).all()
        if guarded.fault_reason is not None:
            since_fault += 1
            if since_fault * PERIOD >= ramp:
                assert not force.any(), f"{since_fault} samples after the fault"
        last = force


def test_the_force_is_told_and_goes_on_from_zero_for_a_rig_that_has_begun_anew():
    guarded = CommandGuard([24_000.0], [5e6], PERIOD, 0.5)
    assert guarded.force.tolist() == [0.0]
    for _ in range(3):
        guarded.check(np.array([15_000.0]))
    assert guarded.force.tolist() == [15_000.0]
    guarded.reset_force()
    assert guarded.force.tolist() == [0.0]
    assert guarded.check(None).tolist() == [0.0], "no command of the rig before"
    assert guarded.check(np.array([15_000.0])).tolist() == [5e6 * PERIOD], "at the rate limit"


def test_a_rig_that_begins_anew_during_a_fault_is_at_rest_and_stays_so():
    guarded = CommandGuard([24_000.0], [5e6], PERIOD, 0.5)
    for _ in range(3):
        guarded.check(np.array([15_000.0]))
    guarded.fault("test")
    guarded.check(None)
    guarded.reset_force()
    assert not any(guarded.check(np.array([15_000.0])).any() for _ in range(300))
