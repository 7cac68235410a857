# SPDX-License-Identifier: Apache-2.0
"""A motion answered sample by sample."""

import numpy as np
import pytest

from abrace_core.safety.table_stop import Table, TableStop, turning_point
from abrace_plant.live.playback import Playback
from abrace_plant.records.files import read_record
from abrace_plant.records.measures import integrate
from abrace_plant.records.options import Treatment
from abrace_plant.records.table_motion import RECORD_REMEDIES, check_motion
from abrace_plant.records.treatment import prepare

MOTION = np.array([0.5, -1.0, 2.0, 0.25])
TABLE = Table(10.0, 2000.0, 1.0, 0.25)


def test_the_motion_is_played_value_by_value_and_then_rests():
    playback = Playback(MOTION, 500.0, TABLE)
    assert [playback.answer(k) for k in range(100, 106)] == [*MOTION, 0.0, 0.0]
    assert playback.done
    assert playback.played == 4


def test_a_lost_sample_does_not_shift_the_motion():
    playback = Playback(MOTION, 500.0, TABLE)
    playback.answer(7)
    assert playback.answer(9) == MOTION[2]
    assert playback.played == 3


def test_elapsed_and_duration_are_seconds():
    playback = Playback(np.ones(1000), 500.0, TABLE)
    playback.answer(0)
    playback.answer(249)
    assert (playback.elapsed, playback.duration) == (0.5, 2.0)


def test_a_motion_whose_stop_the_rig_made_by_itself_is_over():
    finished = Playback(np.sin(np.arange(2000) / 100.0), 500.0, TABLE, 0.02)
    for k in range(700):
        finished.answer(k)
    finished.finish()
    assert finished.done
    assert not any(finished.answer(k) for k in range(800)), "of another run"


@pytest.mark.parametrize("second", [2.1, 2.5, 4.4, 12.3, 25.0])
def test_a_stop_in_el_centro_ends_at_zero_velocity_within_the_stroke(second):
    """Of the record at 0.8 g, whose velocity goes up to 0.88 m/s and its displacement to 0.247 m."""
    motion = prepare(read_record("el_centro"), 500.0, Treatment(peak_acceleration=7.845))
    playback = Playback(motion, 500.0, TABLE)
    played = [playback.answer(k) for k in range(round(500 * second))]
    playback.cancel()
    assert playback.cancelled
    while not playback.done:
        played.append(playback.answer(len(played)))
    assert len(played) - 500 * second <= 250
    assert playback.answer(len(played)) == 0.0
    velocity, displacement = integrate(np.array([0.0, *played]), 0.002)
    assert abs(velocity[-1]) < 1e-12
    assert played[-1] == 0.0
    assert np.abs(displacement).max() <= TABLE.peak_displacement
    assert np.abs(np.diff(played)).max() / 0.002 <= TABLE.peak_jerk


def test_a_motion_that_the_table_has_can_be_stopped_within_the_stroke_at_any_time():
    """It turns round within the stroke itself, with no more than the table has."""
    motion = prepare(read_record("el_centro"), 500.0, Treatment(peak_acceleration=7.9))
    check_motion(motion, 500.0, TABLE, "el_centro", RECORD_REMEDIES)
    velocity, displacement = integrate(motion, 0.002)
    assert np.abs(displacement).max() > 0.245, "nearly all of the stroke"
    states = [*zip(motion.tolist(), velocity.tolist(), displacement.tolist(), strict=True)]
    stops = [TableStop(*state, TABLE, 0.002) for state in states[::23]]
    assert all(stop.within_stroke for stop in stops)
    assert max(len(stop.profile) for stop in stops) <= 350, "0.5 s, or little more"
    peak = np.abs(displacement).max()
    assert all(abs(turning_point(*state, TABLE)) <= peak + 1e-9 for state in states), "no interlock before its own peak"


def test_the_next_motion_begins_where_the_table_is():
    """Its stop is that of a table so near to the end of its stroke; lost samples are moved as well."""
    motion = np.ones(1000)
    playback = Playback(motion, 500.0, TABLE, displacement=0.15)
    for k in (0, 200):
        playback.answer(k)
    playback.cancel()
    velocity, displacement = integrate(np.array([0.0, *motion[:201]]), 0.002)
    stops = [TableStop(1.0, velocity[-1], place + displacement[-1], TABLE, 0.002).profile for place in (0.15, 0.0)]
    answered = [playback.answer(201 + k) for k in range(len(stops[0]))]
    np.testing.assert_allclose(answered, stops[0], atol=1e-9)
    assert len(stops[0]) != len(stops[1]), "from the middle it would be another one"


def test_cancelling_before_the_first_value_plays_nothing():
    playback = Playback(MOTION, 500.0, TABLE)
    playback.cancel()
    assert playback.done
    assert playback.answer(0) == 0.0


def test_cancelling_twice_or_after_the_end_changes_nothing():
    playback = Playback(MOTION, 500.0, TABLE)
    for k in range(4):
        playback.answer(k)
    playback.cancel()
    assert not playback.cancelled
