# SPDX-License-Identifier: Apache-2.0
"""Samples that are old, lost, late, or of a rig that has started anew."""

import pytest

from abrace_core.safety.sample_watch import LONGEST_GAP, NEW_RUN, OLD, SampleWatch

PERIOD = 2_000_000
RUN = 7


@pytest.fixture
def watch() -> SampleWatch:
    watch = SampleWatch(0.002)
    assert watch.update(RUN, 10, 10 * PERIOD) == NEW_RUN
    return watch


def test_the_first_sample_begins_a_run():
    watch = SampleWatch(0.002)
    assert watch.update(RUN, 0, 123) == NEW_RUN
    assert watch.problem is None


def test_samples_in_a_row_are_fine(watch):
    assert [watch.update(RUN, k, k * PERIOD) for k in range(11, 20)] == [0] * 9
    assert watch.problem is None
    assert (watch.missing, watch.old) == (0, 0)


@pytest.mark.parametrize("lost", range(1, LONGEST_GAP + 1))
def test_a_few_lost_samples_are_counted_and_no_problem(watch, lost):
    assert watch.update(RUN, 11 + lost, (11 + lost) * PERIOD) == lost
    assert watch.missing == lost
    assert watch.problem is None


def test_more_are_a_problem_that_names_the_sample(watch):
    sequence = 12 + LONGEST_GAP
    watch.update(RUN, sequence, sequence * PERIOD)
    assert f"{LONGEST_GAP + 1} samples lost before sample {sequence}" in watch.problem


@pytest.mark.parametrize("gap", [0, 12])
def test_how_many_may_be_lost_can_be_told(gap):
    watch = SampleWatch(0.002, gap)
    watch.update(RUN, 10, 10 * PERIOD)
    watch.update(RUN, 11 + gap, (11 + gap) * PERIOD)
    assert watch.problem is None
    watch.update(RUN, 13 + 2 * gap, (13 + 2 * gap) * PERIOD)
    assert f"{gap + 1} samples lost before sample {13 + 2 * gap}, at most {gap} can be bridged" in watch.problem


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_another_sample_rate_is_a_problem_within_0_1_s(watch, factor):
    problems = []
    for k in range(1, 52):
        watch.update(RUN, 10 + k, 10 * PERIOD + round(factor * k * PERIOD))
        problems.append(watch.problem)
    assert "expected 2 ms (sample rate)" in problems[-1]


@pytest.mark.parametrize("factor", [0.8, 0.97, 1.03, 1.25])
def test_a_rate_that_is_slightly_wrong_is_a_problem_within_3_s(watch, factor):
    problems = set()
    for k in range(1, 1500):
        watch.update(RUN, 10 + k, 10 * PERIOD + round(factor * k * PERIOD))
        problems.add(watch.problem)
    (problem,) = problems - {None}
    assert f"come {factor * 2:g} ms apart, expected 2 ms (sample rate)" in problem


def test_a_rig_that_is_held_up_now_and_then_has_its_rate(watch):
    for k in range(1, 5000):
        held_up = 40_000_000 if 505 <= k % 1000 < 515 else 0
        watch.update(RUN, 10 + k, (10 + k) * PERIOD + held_up)
        assert watch.problem is None


def test_a_clock_that_is_set_once_is_no_wrong_rate(watch):
    for k in range(1, 3000):
        watch.update(RUN, 10 + k, (10 + k) * PERIOD + (25_000_000 if k > 700 else 0))
        assert watch.problem is None


def test_jitter_of_the_stamps_is_no_problem(watch):
    for k in range(11, 500):
        watch.update(RUN, k, k * PERIOD + (k * 7919 % 5) * PERIOD)
        assert watch.problem is None


@pytest.mark.parametrize("sequence", [10, 9, 0])
def test_old_and_repeated_samples_are_dropped_and_counted(watch, sequence):
    assert watch.update(RUN, sequence, sequence * PERIOD) == OLD
    assert watch.old == 1
    assert watch.update(RUN, 11, 11 * PERIOD) == 0, "as if it had not come"


def test_another_run_is_a_new_beginning_and_the_one_before_is_old(watch):
    assert watch.update(RUN + 1, 0, 500 * PERIOD) == NEW_RUN
    assert watch.problem is None
    assert watch.update(RUN, 11, 11 * PERIOD) == OLD
    assert watch.update(RUN + 1, 1, 501 * PERIOD) == 0


def test_a_problem_ends_with_the_next_good_sample(watch):
    watch.update(RUN, 100, 100 * PERIOD)
    assert watch.problem
    watch.update(RUN, 101, 101 * PERIOD)
    assert watch.problem is None


def test_a_node_that_begins_anew_takes_the_next_sample_of_the_same_run_as_a_first_one(watch):
    watch.restart()
    assert watch.update(RUN, 40, 40 * PERIOD) == NEW_RUN
    assert watch.missing == 0
