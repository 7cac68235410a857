"""When samples are due."""

import pytest

from abrace_plant.live.schedule import LONGEST_CATCH_UP, Schedule


def test_stamps_and_sequences_belong_together():
    schedule = Schedule(500.0, 7_000, 0.0, 0.0)
    assert [schedule.stamp(k) for k in (0, 1, 500)] == [7_000, 2_007_000, 1_000_007_000]
    for k in (0, 1, 499, 123_456_789):
        assert schedule.sequence(schedule.stamp(k)) == k


def test_rounding_does_not_accumulate_where_the_period_is_no_whole_number_of_nanoseconds():
    schedule = Schedule(300.0, 0, 0.0, 0.0)
    assert schedule.stamp(300 * 3600) == 3600 * 10**9
    assert all(schedule.sequence(schedule.stamp(k)) == k for k in range(1000))


def test_due_times_are_counted_from_the_start():
    schedule = Schedule(500.0, 0, 100.0, 0.0)
    assert schedule.next_due(0, 100.0001) == pytest.approx(100.002, abs=1e-12)
    assert schedule.next_due(499_999, 1099.9991) == pytest.approx(1100.0, abs=1e-9)
    assert schedule.overruns == 0


def test_a_short_overrun_is_caught_up_and_counted():
    schedule = Schedule(500.0, 0, 0.0, 0.0)
    assert schedule.next_due(0, 0.002 + LONGEST_CATCH_UP / 2) == pytest.approx(0.002)
    assert schedule.overruns == 1
    assert schedule.shift == 0


def test_a_long_overrun_shifts_the_schedule():
    schedule = Schedule(500.0, 0, 0.0, 0.0)
    assert schedule.next_due(0, 1.0) == 1.0
    assert schedule.shift == pytest.approx(0.998)
    assert schedule.next_due(1, 1.0001) == pytest.approx(1.002)


@pytest.mark.parametrize(("duration", "last"), [(4.0, 1999), (0.0001, 0)])
def test_the_last_sample_is_that_of_the_duration(duration, last):
    schedule = Schedule(500.0, 0, 0.0, duration)
    assert [k for k in range(3000) if schedule.is_last(k)] == [last]


def test_without_a_duration_no_sample_is_the_last():
    schedule = Schedule(500.0, 0, 0.0, 0.0)
    assert not any(schedule.is_last(k) for k in range(3000))
