# SPDX-License-Identifier: Apache-2.0
"""What the supervisor keeps for the end of a test."""

from abrace.nodes.supervisor import MOST_PROBLEMS, Supervisor


def test_the_first_different_problems_are_kept_and_no_more():
    one = Supervisor.__new__(Supervisor)
    one.problems = []
    for number in range(3 * MOST_PROBLEMS):
        one.note(f"plant: fault: {number // 2}")
    assert one.problems == [f"plant: fault: {number}" for number in range(MOST_PROBLEMS)]
