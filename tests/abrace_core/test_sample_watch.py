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


@pytest.mark.parametrize("lost", range(1, LONGEST_GAP + 1))
def test_a_few_lost_samples_are_counted_and_no_problem(watch, lost):
    assert watch.update(RUN, 11 + lost, (11 + lost) * PERIOD) == lost
    assert watch.missing == lost
    assert watch.problem is None


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
    assert len(problems) > 1
    for problem in problems - {None}:
        assert f"come {factor * 2:g} ms apart, expected 2 ms (sample rate)" in problem


@pytest.mark.parametrize("late", [-40_000_000, 40_000_000, 10**12])
@pytest.mark.parametrize("samples", [1, 10, 400])
def test_samples_with_wrong_stamps_are_no_wrong_rate_wherever_they_come(samples, late):
    """A rig that was delayed, for one sample or many, at every distance from the first sample that is compared."""
    for begin in (*range(1, 60), *range(60, 520, 49)):
        watch = SampleWatch(0.002)
        for k in range(begin + samples + 520):
            watch.update(RUN, k, k * PERIOD + (late if begin <= k < begin + samples else 0))
            assert watch.problem is None


@pytest.mark.parametrize("by", [-(10**12), -25_000_000, 25_000_000, 10**12])
def test_a_clock_that_is_set_once_is_no_wrong_rate_whenever_it_is(by):
    for when in (*range(1, 60), *range(60, 1100, 97)):
        watch = SampleWatch(0.002)
        for k in range(when + 1100):
            watch.update(RUN, k, k * PERIOD + (by if k >= when else 0))
            assert watch.problem is None


@pytest.mark.parametrize("factor", [0.5, 0.97, 1.03, 2.0])
def test_a_rate_that_becomes_wrong_is_found_whenever_it_does(factor):
    for when in (*range(1, 60), *range(60, 1100, 97)):
        watch, stamp, problems = SampleWatch(0.002), 0, []
        for k in range(when + 1100):
            stamp += round(PERIOD * (factor if k >= when else 1))
            watch.update(RUN, k, stamp)
            problems.append(watch.problem)
        assert not any(problems[:when])
        assert any(problems[when:]), f"wrong from sample {when} on"


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
