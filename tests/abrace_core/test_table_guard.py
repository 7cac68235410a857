# SPDX-License-Identifier: Apache-2.0
"""What the shake table is allowed to do."""

import math

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
