# SPDX-License-Identifier: Apache-2.0
"""Deviations of samples from the clock, and what is told of them."""

from __future__ import annotations

import json

import numpy as np
import pytest

from abrace_core.errors import AbraceError
from abrace_plant.live.jitter import EDGES, Arrivals, Jitter, as_json, bare_timer
from abrace_plant.live.jitter_figure import jitter_figure

PERIOD = 2_000_000


def arrivals(sequences: list[int], late: dict[int, int]) -> Arrivals:
    """Samples received on time, but for those that are `late` by some nanoseconds."""
    stamps = [PERIOD * sequence for sequence in sequences]
    received = [10**12 + stamp + late.get(sequence, 0) for sequence, stamp in zip(sequences, stamps, strict=True)]
    return Arrivals(received, stamps, sequences)


def test_a_sample_that_comes_late_counts_twice_and_one_that_does_not_come_is_missed():
    sequences = [sequence for sequence in range(100, 1101) if sequence != 500]
    jitter, period = arrivals(sequences, {300: 700_000}).jitter()
    assert period == 0.002
    assert jitter.missed == 1
    assert np.count_nonzero(jitter.times) == 2
    statistics = jitter.statistics()
    assert statistics["events"] == 999
    assert statistics["median_us"] == 0
    assert statistics["worst_us"] == pytest.approx(700.0)


def test_quantiles_are_exact():
    times = np.arange(1, 100_001) * 1e-6
    found = Jitter(np.random.default_rng(1).permutation(times)).statistics()
    assert [found[key] for key in ("p99_us", "p999_us", "p9999_us", "worst_us")] == pytest.approx(
        [99001, 99901, 99991, 100000], abs=1
    )


@pytest.mark.parametrize(
    ("sequences", "expected"), [([1, 2], "2 samples"), ([5, 6, 0, 1], "restarted"), ([5, 5, 6], "restarted")]
)
def test_what_is_no_run_of_samples_is_refused(sequences, expected):
    with pytest.raises(AbraceError, match=expected):
        arrivals(sequences, {}).jitter()


def test_a_histogram_counts_every_event_once_in_intervals_that_are_the_same_in_every_run():
    times = np.array([0.0, 5e-8, 150e-6, 151e-6, 2e-3, 60.0])
    counts = np.array(Jitter(times).counts())
    assert counts.sum() == len(times)
    assert (counts[0], counts[-1]) == (2, 1), "those beyond the ends"
    for time, count in ((150e-6, 2), (2e-3, 1)):
        i = int(np.searchsorted(EDGES, 1e6 * time)) - 1
        assert (EDGES[i] <= 1e6 * time < EDGES[i + 1], counts[i]) == (True, count), time


def test_samples_of_any_number_are_no_run():
    with pytest.raises(AbraceError, match="restarted"):
        Arrivals([0, PERIOD, 2 * PERIOD], [0, PERIOD, 2 * PERIOD], [0, 2**64 - 1, 1]).jitter()


def test_a_bare_timer_is_never_early():
    timer = bare_timer(0.001, 0.05)
    assert len(timer.times) == 50
    assert timer.times.min() >= 0


def test_the_figure_is_drawn_from_the_file_and_takes_a_part_without_deviations():
    times = np.geomspace(1e-5, 1e-2, 50)
    found = {"rig": Jitter(np.zeros(50), missed=2), "timer": Jitter(times), "echo": Jitter(2 * times)}
    content = json.loads(json.dumps(as_json(found, 0.001, {"thread_priority": 0})))
    above, below = jitter_figure(content).axes
    assert [text.get_text() for text in above.get_legend().get_texts()] == [
        "rig, 2 missed",
        "timer, 0 missed",
        "echo, 0 missed",
    ]
    assert [patch.get_data().values.sum() for patch in above.patches] == [50, 50, 50]
    assert above.patches[0].get_data().values[0] == 50
    edges, shares = below.lines[2].get_data()
    assert shares[edges < 20].tolist() == [1.0] * int((edges < 20).sum())
    assert shares[-1] == 0.0
    assert np.interp(0.5, shares[::-1], edges[::-1]) == pytest.approx(1e6 * np.median(2 * times), rel=0.15)
