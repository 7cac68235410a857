# SPDX-License-Identifier: Apache-2.0
"""A table's velocity and displacement, and the stop that brings it to rest."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.integrate import quad

from abrace_core.safety.table_stop import LONGEST, RAMP_TIME, Table, TableState, TableStop, turning_point

TABLE = Table(peak_acceleration=10.0, peak_jerk=2000.0, peak_velocity=1.0, peak_displacement=0.25)
PERIOD = 0.002

tables = st.builds(
    Table,
    peak_acceleration=st.floats(1.0, 30.0),
    peak_jerk=st.floats(50.0, 5000.0),
    peak_velocity=st.floats(0.2, 3.0),
    peak_displacement=st.floats(0.02, 1.0),
)
shares = st.floats(-1.0, 1.0) | st.sampled_from([0.0, 1.0, -1.0]) | st.floats(-1e-6, 1e-6)
periods = st.sampled_from([0.0005, 0.001, 0.002, 0.005])


def run(stop: TableStop, start: tuple[float, float, float], period: float = PERIOD) -> tuple[np.ndarray, np.ndarray]:
    """Accelerations from the last one before the stop on, and displacements; the end is at rest."""
    state = TableState(period, start[2])
    state.acceleration, state.velocity = start[:2]
    states = [(state.acceleration, state.displacement)]
    while not stop.done:
        state.update(stop.next())
        states.append((state.acceleration, state.displacement))
    scale = max(1e-300, abs(start[1]), abs(start[0]) * RAMP_TIME)
    assert abs(state.velocity) < 1e-9 * scale
    assert state.acceleration == 0.0
    assert state.displacement == pytest.approx(stop.displacement, rel=1e-9, abs=1e-12)
    assert (stop.next(), stop.done) == (0.0, True)
    accelerations, displacements = np.array(states).T
    return accelerations, displacements


def least_distance(acceleration: float, velocity: float, table: Table) -> float:
    """How far the table goes on, at the least, from a velocity above zero and an acceleration of 0 or more [m].

    Down at the greatest jerk to the greatest deceleration that is needed, held, and back at the greatest jerk.
    """
    a, j = table.peak_acceleration, table.peak_jerk
    peak = min(a, math.sqrt(j * velocity + acceleration**2 / 2))
    down, up = (acceleration + peak) / j, peak / j
    held = max(0.0, (velocity + acceleration**2 / (2 * j) - peak**2 / j) / peak)

    def path(now: float, rate: float, time: float, speed: float) -> tuple[float, float]:
        return speed * time + now * time**2 / 2 + rate * time**3 / 6, speed + now * time + rate * time**2 / 2

    whole, speed = 0.0, velocity
    for now, rate, time in ((acceleration, -j, down), (-peak, 0.0, held), (-peak, j, up)):
        distance, speed = path(now, rate, time, speed)
        whole += distance
    assert speed == pytest.approx(0.0, abs=1e-9 * (1 + velocity))
    return whole


@example(table=Table(1.0, 50.0, 0.744140625, 1.0), period=0.0005, a=1.0, v=0.22508385622652405, d=0.0)
@given(table=tables, period=periods, a=shares, v=shares, d=shares)
def test_any_stop_ends_at_rest_within_acceleration_and_jerk(table, period, a, v, d):
    start = a * table.peak_acceleration, v * table.peak_velocity, d * table.peak_displacement
    stop = TableStop(*start, table, period)
    accelerations, displacements = run(stop, start, period)
    assert np.abs(accelerations).max() <= table.peak_acceleration * (1 + 1e-12)
    if len(accelerations) > 1:
        assert np.abs(np.diff(accelerations)).max() <= table.peak_jerk * period * (1 + 1e-9)
    beyond = np.abs(displacements).max() - table.peak_displacement
    assert stop.within_stroke == (beyond <= 0) or abs(beyond) < 1e-12
    acceleration, velocity = (abs(value) for value in start[:2])
    least = velocity / table.peak_acceleration + 2 * (acceleration + table.peak_acceleration) / table.peak_jerk
    assert len(stop.profile) * period <= max(LONGEST, least + 10 * period)


@given(table=tables, a=st.floats(0.0, 1.0), v=st.floats(0.001, 1.0), d=st.floats(-1.0, 1.0))
def test_the_stroke_is_left_only_where_no_stop_keeps_within_it(table, a, v, d):
    start = a * table.peak_acceleration, v * table.peak_velocity, d * table.peak_displacement
    stop = TableStop(*start, table, 1e-4)
    needed = start[2] + least_distance(*start[:2], table)
    if not stop.within_stroke:
        assert needed > 0.98 * table.peak_displacement
    if needed > table.peak_displacement:
        assert not stop.within_stroke
        assert stop.displacement == pytest.approx(needed, rel=0.02), "the greatest deceleration was used"


@given(v=st.floats(-0.5, 0.5), a=st.floats(-3.0, 3.0))
def test_a_stop_in_the_middle_of_the_stroke_takes_half_a_second(v, a):
    stop = TableStop(a, v, 0.0, TABLE, PERIOD)
    assert len(stop.profile) == (RAMP_TIME / PERIOD if a or v else 0)
    assert stop.within_stroke


def test_the_state_is_the_exact_integral_of_an_acceleration_that_is_linear_between_samples():
    accelerations = np.random.default_rng(3).standard_normal(20)
    state = TableState(0.1, displacement=0.5)
    for value in accelerations:
        state.update(value)
    times = 0.1 * np.arange(21)
    line = np.concatenate([[0.0], accelerations])
    velocity, displacement = (
        quad(lambda t, power=power: np.interp(t, times, line) * (2.0 - t) ** power, 0, 2.0, points=times, limit=200)[0]
        for power in (0, 1)
    )
    assert state.velocity == pytest.approx(velocity, abs=1e-9)
    assert state.displacement == pytest.approx(0.5 + displacement, abs=1e-9)
    assert state.acceleration == accelerations[-1]


@given(
    table=tables, acceleration=shares, velocity=st.floats(0.01, 1.0), sign=st.sampled_from([1, -1]), displacement=shares
)
@example(table=TABLE, acceleration=0.0, velocity=0.9, sign=1, displacement=0.2)
@example(table=TABLE, acceleration=-1.0, velocity=0.01, sign=-1, displacement=0.0)
@example(table=Table(13.0, 50.0, 1.0, 1.0), acceleration=-1.0, velocity=0.015625, sign=1, displacement=0.0)
def test_the_turning_point_is_where_the_greatest_deceleration_ends_the_motion(
    table, acceleration, velocity, sign, displacement
):
    now, speed, most = acceleration * table.peak_acceleration, velocity * table.peak_velocity, table.peak_acceleration
    step = (speed / most + 2 * most / table.peak_jerk) / 200_000  # the standstill may come after a hundredth of them
    fall = np.maximum(now - table.peak_jerk * step * np.arange(200_002), -most)
    speeds = speed + np.concatenate([[0.0], np.cumsum((fall[1:] + fall[:-1]) / 2 * step)])
    way = step * (np.sum(np.maximum(speeds, 0.0)) - speed / 2)
    found = turning_point(sign * now, sign * speed, displacement, table)
    assert sign * (found - displacement) == pytest.approx(way, rel=1e-2)
