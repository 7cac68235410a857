"""Samples that are lost, late, or of a rig that has started anew."""

import pytest

from abrace_core.safety.sample_watch import LONGEST_GAP, SampleWatch

PERIOD = 2_000_000


@pytest.fixture
def watch() -> SampleWatch:
    watch = SampleWatch(0.002)
    assert watch.update(10, 10 * PERIOD) == -1
    return watch


def test_the_first_sample_is_a_start():
    watch = SampleWatch(0.002)
    assert watch.update(0, 123) == -1
    assert watch.problem is None


def test_samples_in_a_row_are_fine(watch):
    assert [watch.update(k, k * PERIOD) for k in range(11, 20)] == [0] * 9
    assert watch.problem is None
    assert watch.missing == 0


@pytest.mark.parametrize("lost", range(1, LONGEST_GAP + 1))
def test_a_few_lost_samples_are_counted_and_no_problem(watch, lost):
    assert watch.update(11 + lost, (11 + lost) * PERIOD) == lost
    assert watch.missing == lost
    assert watch.problem is None


def test_more_are_a_problem_that_names_the_sample(watch):
    sequence = 12 + LONGEST_GAP
    watch.update(sequence, sequence * PERIOD)
    assert f"{LONGEST_GAP + 1} samples lost before sample {sequence}" in watch.problem


@pytest.mark.parametrize("gap", [0, 12])
def test_how_many_may_be_lost_can_be_told(gap):
    watch = SampleWatch(0.002, gap)
    watch.update(10, 10 * PERIOD)
    watch.update(11 + gap, (11 + gap) * PERIOD)
    assert watch.problem is None
    watch.update(13 + 2 * gap, (13 + 2 * gap) * PERIOD)
    assert f"{gap + 1} samples lost before sample {13 + 2 * gap}, at most {gap} can be bridged" in watch.problem


@pytest.mark.parametrize("factor", [0.4, 2.0])
def test_another_sample_rate_is_a_problem(watch, factor):
    watch.update(11, 10 * PERIOD + round(factor * PERIOD))
    assert "sample rate" in watch.problem


def test_jitter_of_the_stamps_is_no_problem(watch):
    watch.update(11, 11 * PERIOD + 900_000)
    assert watch.problem is None


def test_a_rig_that_starts_anew_is_a_start(watch):
    assert watch.update(0, 500 * PERIOD) == -1
    assert watch.problem is None
    assert watch.update(1, 501 * PERIOD) == 0


def test_a_problem_ends_with_the_next_good_sample(watch):
    watch.update(100, 100 * PERIOD)
    assert watch.problem
    watch.update(101, 101 * PERIOD)
    assert watch.problem is None
