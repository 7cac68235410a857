# SPDX-License-Identifier: Apache-2.0
"""What the shake table is allowed to do."""

import math
import random

import numpy as np
import pytest

from abrace_core.safety.table_guard import TableGuard
from abrace_core.safety.table_stop import Table

PERIOD = 0.002
TABLE = Table(10.0, 2000.0, 1.0, 0.25)


def test_a_motion_within_the_limits_passes_bit_for_bit():
    motion = np.cumsum(np.random.default_rng(1).normal(0, 0.05, 500))
    guard = TableGuard(TABLE, PERIOD)
    for value in motion:
        guard.follow([value])
        assert guard.value == [value]
    assert (guard.limits, guard.limited) == (0, False)


def test_acceleration_and_jerk_are_limited_and_counted():
    guard = TableGuard(TABLE, PERIOD)
    guard.follow([30.0])
    assert (guard.value, guard.limited) == ([4.0], True)
    for _ in range(5):
        guard.follow(None)
    assert guard.value == [10.0]
    assert guard.limits == 6
    guard.follow([9.0])
    assert (guard.value, guard.limited, guard.limits) == ([9.0], False, 6)


@pytest.mark.parametrize("bad", [[], [1.0, 2.0], [math.nan], [math.inf]])
def test_what_cannot_act_is_said(bad):
    assert "expected one finite number" in TableGuard(TABLE, PERIOD).problem(bad)


def test_it_comes_to_rest_at_zero_velocity_and_stays_where_it_is():
    guard = TableGuard(TABLE, PERIOD)
    for k in range(300):
        guard.follow([2.0 * math.sin(2 * math.pi * k * PERIOD)])
    assert abs(guard.state.velocity) > 0.3
    guard.begin_to_rest()
    while not guard.at_rest:
        guard.come_to_rest()
    assert guard.value == [0.0]
    assert abs(guard.state.velocity) < 1e-9
    there = guard.state.displacement
    guard.reset()
    assert guard.state.displacement == there


def test_samples_without_a_command_are_counted_as_if_the_last_acceleration_went_on():
    guard, counted = TableGuard(TABLE, PERIOD), TableGuard(TABLE, PERIOD)
    for k in range(100):
        value = 2.0 * math.sin(2 * math.pi * k * PERIOD)
        guard.follow([value])
        counted.follow([value])
    guard.hold(7)
    for _ in range(7):
        counted.follow(None)
    assert guard.state.velocity == pytest.approx(counted.state.velocity, rel=1e-12)
    assert guard.state.displacement == pytest.approx(counted.state.displacement, rel=1e-12)


def test_a_stop_that_misses_samples_ends_and_knows_its_velocity():
    guard, velocity = TableGuard(TABLE, PERIOD), 0.0
    for k in range(100):
        last = guard.value[0]
        guard.follow([2.0 * math.sin(2 * math.pi * k * PERIOD)])
        velocity += PERIOD / 2 * (last + guard.value[0])
    guard.begin_to_rest()
    step = 0
    while not guard.at_rest:
        last, samples = guard.value[0], 6 if step % 10 == 5 else 1
        guard.come_to_rest(samples)
        velocity += PERIOD * (samples - 1) * last + PERIOD / 2 * (last + guard.value[0])
        step += 1
    assert 100 < step < 1000
    assert guard.state.velocity == pytest.approx(velocity, abs=1e-12)
    assert abs(velocity) < 0.02 * TABLE.peak_velocity


@pytest.mark.parametrize("share", [0.0, 0.05, 0.3])
def test_no_stop_exceeds_the_limit_of_jerk_however_many_samples_it_misses(share):
    chance = random.Random(1)
    for _ in range(300):
        guard = TableGuard(TABLE, PERIOD)
        for _ in range(chance.randint(1, 7)):
            acceleration = chance.choice((1e9, -1e9, 0.0, 1.0))
            for _ in range(chance.randint(1, 20)):
                guard.follow([acceleration])
        guard.begin_to_rest()
        step = 0
        while not guard.at_rest:
            last = guard.value[0]
            guard.come_to_rest(chance.randint(2, 12) if chance.random() < share else 1)
            assert abs(guard.value[0] - last) <= TABLE.peak_jerk * PERIOD * (1 + 1e-9)
            assert abs(guard.value[0]) <= TABLE.peak_acceleration * (1 + 1e-9)
            step += 1
            assert step < 2000, "it ends"
        assert guard.value == [0.0]
        assert abs(guard.state.velocity) <= 0.02 * TABLE.peak_velocity


def test_a_table_that_is_left_alone_does_not_drift():
    guard = TableGuard(TABLE, PERIOD)
    for value in (1.0, 2.0, 1.0, 0.0):
        guard.follow([value])
    assert guard.state.velocity > 0.005
    for _ in range(501):
        guard.follow([0.0])
    there = guard.state.displacement
    for _ in range(20_000):
        guard.follow([0.0])
    assert guard.state.displacement == there


def test_a_table_that_moves_on_is_no_table_at_rest():
    guard = TableGuard(TABLE, PERIOD)
    for value in [1.0] * 20 + [0.0] * 2000:
        guard.follow([value])
    assert guard.state.velocity > 0.03


def test_a_motion_that_begins_while_forces_fade_in_ends_at_rest_as_well():
    guard, whole = TableGuard(TABLE, PERIOD), TableGuard(TABLE, PERIOD)
    for k in range(500):
        value = math.sin(2 * math.pi * k / 500) - math.sin(4 * math.pi * k / 500) / 2
        guard.follow([value], min(1.0, k / 250))
        whole.follow([value])
    assert guard.value == whole.value
    assert guard.state.velocity == whole.state.velocity


def test_a_table_that_moves_without_acceleration_moves():
    guard = TableGuard(TABLE, PERIOD)
    assert not guard.moving
    for value in [1.0] * 20:
        guard.follow([value])
        assert guard.moving
    for _ in range(3):
        guard.follow([0.0])
    assert guard.moving, "at 0.04 m/s"
    guard.begin_to_rest()
    while not guard.at_rest:
        guard.come_to_rest()
    assert not guard.moving
