# SPDX-License-Identifier: Apache-2.0
"""What is missing in a `sequence`, counted message by message and in an array."""

from __future__ import annotations

import numpy as np

from abrace_bags.sequence import NumberRanges, SequenceCounter, breaks


def missing_numbers(sequence: np.ndarray) -> tuple[int, int]:
    ranges = NumberRanges()
    ranges.add(sequence)
    return ranges.gaps, ranges.missing


def test_a_stream_and_an_array_of_rising_numbers_have_the_same_gaps() -> None:
    rising = np.array([3, 4, 7, 8, 20], np.uint64)
    counter = SequenceCounter()
    assert [counter.add(number) for number in rising.tolist()] == [-1, 0, 2, 0, 11]
    assert (counter.gaps, counter.missing) == missing_numbers(rising) == (2, 13)
    assert breaks(rising).tolist() == [1, 3]


def test_a_number_that_does_not_rise_begins_a_new_run() -> None:
    counter = SequenceCounter()
    assert [counter.add(number) for number in (5, 5, 0, 2)] == [-1, -1, -1, 1]
    assert (counter.gaps, counter.missing) == (1, 1)
    assert breaks(np.array([5, 5, 0, 2], np.uint64)).tolist() == [0, 1, 2]


def test_after_a_restart_the_next_message_has_no_gap_before_it() -> None:
    counter = SequenceCounter()
    counter.add(1)
    counter.restart()
    assert counter.add(50) == -1
    assert counter.missing == 0


def test_missing_numbers_do_not_depend_on_the_order_of_the_messages() -> None:
    assert missing_numbers(np.array([9, 2, 3, 2], np.int32)) == (1, 5)
    assert missing_numbers(np.array([0, 2**64 - 1], np.uint64)) == (1, 2**64 - 2)
    assert missing_numbers(np.empty(0, np.uint64)) == (0, 0)
