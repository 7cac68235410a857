# SPDX-License-Identifier: Apache-2.0
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from abrace_core import AbraceError
from abrace_core.safety.command_guard import CommandGuard, rate_problem

CAPACITY, RATE, PERIOD, RAMP = 24516.625, 5.0e6, 0.002, 0.1


def guard(groups: int = 1) -> CommandGuard:
    return CommandGuard([CAPACITY] * groups, [RATE] * groups, PERIOD, RAMP)


def followed(guarded: CommandGuard, *commands) -> list:
    """The forces after these commands."""
    forces = []
    for command in commands:
        guarded.follow(command)
        forces.append(guarded.value)
    return forces


def test_command_with_nothing_wrong_passes_bit_for_bit():
    commands = np.random.default_rng(0).normal(0.0, 1500.0, (2000, 2))
    guarded = guard(2)
    assert np.array(followed(guarded, *commands)).tobytes() == commands.tobytes()
    assert (guarded.saturations, guarded.rate_limits) == (0, 0)


def test_last_command_holds_until_the_next_and_before_the_first_it_is_zero():
    assert followed(guard(), None, [120.0], None) == [[0.0], [120.0], [120.0]]


def test_the_given_command_stays_the_callers_own():
    guarded = guard()
    command = np.array([100.0])
    guarded.follow(command)
    command[0] = 9.0
    assert followed(guarded, None) == [[100.0]]


def test_command_beyond_capacity_is_cut_to_it_and_counted():
    guarded = CommandGuard([1000.0, 2000.0], [1e9, 1e9], PERIOD, RAMP)
    assert followed(guarded, [1500.0, -1500.0]) == [[1000.0, -1500.0]]
    assert guarded.saturated
    assert followed(guarded, [-999.0, -9000.0]) == [[-999.0, -2000.0]]
    assert followed(guarded, [1000.0, -2000.0]) == [[1000.0, -2000.0]]
    assert (guarded.saturations, guarded.saturated) == (2, False)


def test_command_too_fast_is_followed_at_the_rate_limit_and_counted():
    guarded = CommandGuard([1000.0], [50_000.0], PERIOD, RAMP)  # 100 N a sample
    assert followed(guarded, [250.0], None, None) == [[100.0], [200.0], [250.0]]
    assert not guarded.rate_limited
    assert followed(guarded, [-1000.0]) == [[150.0]]
    assert (guarded.rate_limits, guarded.rate_limited) == (3, True)


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (np.array([np.nan, 0.0]), "finite"),
        (np.array([1.0]), r"shape \(1,\), expected \(2,\)"),
        ((1.0, 2.0, 3.0), "shape"),
        (np.array([[1.0, 2.0]]), "shape"),
        (np.array(["one", "two"]), "expected 2 numbers"),
        (None, "expected 2 numbers|shape"),
    ],
)
def test_why_a_command_cannot_act_is_said(command, reason):
    assert re.search(reason, guard(2).problem(command))


def test_it_comes_to_rest_monotonically_within_the_ramp_time_and_stays():
    guarded = guard(2)
    start = np.array(followed(guarded, *[[20_000.0, -10_000.0]] * 5)[-1])
    assert start.tolist() == [20_000.0, -10_000.0]
    guarded.begin_to_rest()
    steps, forces = round(RAMP / PERIOD), []
    for _ in range(steps + 20):
        guarded.come_to_rest()
        forces.append(guarded.value)
        assert guarded.at_rest is (len(forces) >= steps)
    fall = np.diff(np.vstack([start, forces[:steps]]), axis=0)
    assert (fall[:, 0] < 0).all()
    assert (fall[:, 1] > 0).all()
    assert not np.array(forces[steps - 1 :]).any()
    assert np.abs(fall).max() == pytest.approx(20_000.0 * np.pi / 2 / steps, rel=0.01), "a half cosine"
    assert np.abs(fall[0]).max() < 0.1 * np.abs(fall).max(), "no jerk at its start"


def test_after_the_ramp_the_command_before_does_not_come_back():
    guarded = guard()
    guarded.follow([5000.0])
    guarded.begin_to_rest()
    guarded.come_to_rest(60)
    assert followed(guarded, None, [24_000.0]) == [[0.0], [RATE * PERIOD]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"capacity": [-1.0]}, "capacity"),
        ({"rate_limit": [0.0]}, "rate_limit"),
        ({"rate_limit": [1.0, 2.0]}, "one number for each brace group"),
        ({"capacity": 5.0, "rate_limit": 5.0}, "one number for each brace group"),
        ({"sample_period": 0.0}, "sample_period"),
        ({"ramp_time": -1.0}, "ramp_time"),
        ({"ramp_time": 0.001}, "command guard: ramp_time 0.001 s, expected at least a sample_period, 0.002 s"),
        (
            {"ramp_time": 0.006},
            r"guard: rate_limit: 5e\+06 N/s, expected at least 6.13e\+06 N/s to bring 24516.6 N to zero in 0.006 s",
        ),
        ({"ramp_time": 0.006, "rate_name": "parameter rate_limit"}, r"^parameter rate_limit: 5e\+06 N/s, expected"),
    ],
)
def test_limits_that_cannot_be_kept_are_refused(change, message):
    arguments = {"capacity": [CAPACITY], "rate_limit": [RATE], "sample_period": PERIOD, "ramp_time": RAMP} | change
    with pytest.raises(AbraceError, match=message):
        CommandGuard(**arguments)


@pytest.mark.parametrize("ramp", [PERIOD, 0.006, 0.5, 0.7])
@pytest.mark.parametrize("capacity", [3.7, 24_516.625, 1e5, 9e8])
def test_least_rate_limit_that_the_refusal_names_is_accepted_and_not_much_less(capacity, ramp):
    least = float(rate_problem(capacity, 1e-3, PERIOD, ramp).split("at least ")[1].split()[0])
    guarded = CommandGuard([capacity], [least], PERIOD, ramp)
    assert rate_problem(capacity, 0.998 * least, PERIOD, ramp)
    guarded.value = [capacity]
    guarded.begin_to_rest()
    for _ in range(round(ramp / PERIOD)):
        guarded.come_to_rest()
    assert guarded.at_rest, "the rate limit does not make the ramp longer"


@settings(max_examples=150)
@given(
    commands=st.lists(st.one_of(st.none(), st.lists(st.floats(-2e5, 2e5), min_size=2, max_size=2)), max_size=120),
    share=st.floats(0.0, 1.0),
    rate=st.floats(5e6, 1e9),
    ramp=st.floats(0.02, 0.3),
)
def test_force_is_within_capacity_and_rate_and_off_within_the_ramp_time(commands, share, rate, ramp):
    capacity, rates = np.array([24_000.0, 5_000.0]), np.array([rate, 2 * rate])
    guarded = CommandGuard(capacity, rates, PERIOD, ramp)
    forces = [np.zeros(2)]
    for command in commands:
        guarded.follow(command, share)
        forces.append(np.array(guarded.value))
    guarded.begin_to_rest()
    while not guarded.at_rest:
        guarded.come_to_rest()
        forces.append(np.array(guarded.value))
    assert (len(forces) - 1 - len(commands)) * PERIOD <= ramp * (1 + 1e-9)
    assert (np.abs(forces) <= capacity).all()
    assert (np.abs(np.diff(forces, axis=0)) <= rates * PERIOD * (1 + 1e-12)).all()


def test_a_reset_is_at_rest_without_a_command():
    guarded = guard()
    guarded.follow([5000.0])
    guarded.reset()
    assert guarded.at_rest
    assert followed(guarded, None) == [[0.0]]


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.floats(-3e4, 3e4), st.integers(0, 3)), min_size=5, max_size=60), st.booleans())
def test_commands_on_the_way_make_no_step_beyond_the_rate_limit_in_whichever_tick_they_arrive(commands, to_rest):
    guarded = guard()
    guarded.commands_in_flight = 3
    sent = [0.0] * 4
    acted = [0.0]
    arrived = 0
    for number, (command, late) in enumerate(commands):
        if to_rest and number == 30:
            guarded.begin_to_rest()
        if to_rest and number >= 30:
            guarded.come_to_rest()
        elif late == 2 and number % 3 == 0:
            guarded.repeat()
        else:
            guarded.follow([command])
        sent.append(guarded.value[0])
        arrived = max(arrived, len(sent) - 1 - late)
        acted.append(sent[arrived])
    assert np.abs(np.diff(acted)).max() <= RATE * PERIOD * (1 + 1e-12)


def test_a_command_on_the_way_halves_the_rate_of_change_and_nothing_else():
    guarded = CommandGuard([1000.0], [50_000.0], PERIOD, RAMP)  # 100 N a sample
    guarded.commands_in_flight = 1
    assert followed(guarded, [60.0], [90.0], [50.0]) == [[60.0], [90.0], [50.0]]
    assert followed(guarded, *[[1000.0]] * 4) == [[150.0], [150.0], [250.0], [250.0]]
    assert (guarded.rate_limits, guarded.rate_limited) == (4, True)
    guarded.commands_in_flight = 3
    guarded.reset()
    assert followed(guarded, [60.0]) == [[60.0]]
