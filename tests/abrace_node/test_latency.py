# SPDX-License-Identifier: Apache-2.0
"""Times from sample to answer, over the last of them."""

from __future__ import annotations

import subprocess
import sys

from abrace_node.latency import WINDOW, Latency

MS = 1_000_000


def test_median_99_percent_and_worst_are_those_of_the_times():
    latency = Latency(0.002)
    for k in range(1, 101):
        latency.add(1000 * k, 2000 * k)
    report = latency.report()
    assert (report["answer_median_us"], report["answer_99_percent_us"], report["answer_worst_us"]) == (50, 99, 100)
    assert (report["stamp_to_command_median_us"], report["stamp_to_command_worst_us"]) == (100, 200)
    assert report["late"] == 0


def test_answers_that_fall_behind_by_more_than_a_sample_period_are_late():
    latency = Latency(0.002)
    for age in (100, 101, 102, 104, 109, 107, 105, 100, 103):
        latency.add(1000, age * MS)
    assert latency.report()["late"] == 2, "the one of 109 and the one of 103 ms; stamps may be behind the clock"


def test_stamps_of_another_clock_tell_nothing():
    latency = Latency(0.002)
    latency.add(1000, 1_700_000_000 * 10**9)
    latency.add(1000, -5 * MS)
    report = latency.report()
    assert report["late"] == 0
    assert not any(key.startswith("stamp") for key in report)


def test_what_was_long_ago_is_forgotten_but_the_count():
    latency = Latency(0.002)
    latency.add(1000, 1000)
    latency.add(90 * MS, 90 * MS)
    for _ in range(WINDOW):
        latency.add(1000, 1000)
    assert (latency.report()["answer_worst_us"], latency.report()["late"]) == (1, 1)


def test_a_report_imports_nothing():
    """While samples are answered an import would hold the interpreter for some 40 ms."""
    made = "import sys; from abrace_node.latency import Latency; latency = Latency(0.002); latency.add(1, 1)"
    compared = "before = set(sys.modules); latency.report(); print(sorted(set(sys.modules) - before))"
    output = subprocess.run([sys.executable, "-c", f"{made}; {compared}"], capture_output=True, text=True, check=True)
    assert output.stdout == "[]\n"
