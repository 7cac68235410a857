"""A motion answered sample by sample."""

import numpy as np
import pytest

from abrace_plant.live.playback import CANCEL_TIME, Playback

MOTION = np.array([0.5, -1.0, 2.0, 0.25])


def test_the_motion_is_played_value_by_value_and_then_rests():
    playback = Playback(MOTION, 500.0)
    assert [playback.answer(k) for k in range(100, 106)] == [*MOTION, 0.0, 0.0]
    assert playback.done
    assert playback.played == 4


def test_a_lost_sample_does_not_shift_the_motion():
    playback = Playback(MOTION, 500.0)
    playback.answer(7)
    assert playback.answer(9) == MOTION[2]
    assert playback.played == 3


def test_elapsed_and_duration_are_seconds():
    playback = Playback(np.ones(1000), 500.0)
    playback.answer(0)
    playback.answer(249)
    assert (playback.elapsed, playback.duration) == (0.5, 2.0)


def test_a_cancelled_motion_goes_smoothly_to_zero_from_where_it_is():
    playback = Playback(np.full(5000, 3.0), 500.0)
    for k in range(100):
        playback.answer(k)
    playback.cancel()
    steps = round(CANCEL_TIME * 500)
    ramp = np.array([playback.answer(100 + k) for k in range(steps)])
    assert ramp[-1] == pytest.approx(0.0, abs=1e-12)
    assert (np.diff(np.concatenate([[3.0], ramp])) <= 0).all()
    assert np.abs(np.diff(ramp)).max() <= 3.0 * np.pi / 2 / steps * 1.01
    assert playback.done
    assert playback.answer(100 + steps) == 0.0


def test_cancelling_before_the_first_value_plays_nothing():
    playback = Playback(MOTION, 500.0)
    playback.cancel()
    assert playback.done
    assert playback.answer(0) == 0.0


def test_cancelling_twice_or_after_the_end_changes_nothing():
    playback = Playback(MOTION, 500.0)
    for k in range(4):
        playback.answer(k)
    playback.cancel()
    assert not playback.cancelled
