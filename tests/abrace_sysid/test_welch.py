# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from abrace_sysid.recorded.test import Test
from abrace_sysid.spectra.welch import coherence_of, welch

BAND = (5.0, 100.0)
GAIN = 3.0


def noisy(plain_run, seed, samples=100_000, output_noise=1.0):
    random = np.random.default_rng(seed)
    excitation = random.standard_normal(samples)
    outputs = GAIN * excitation + output_noise * random.standard_normal(samples)
    return Test.of(plain_run(outputs, excitation))


def test_sigma_holds(plain_run):
    found = welch([noisy(plain_run, 2)], "w", BAND, 2048)
    ratio = np.sqrt(np.mean(np.abs(found.response[:, 0] - GAIN) ** 2) / np.mean(found.sigma[:, 0] ** 2))
    assert 0.9 < ratio < 1.1, ratio


def test_coherence_is_the_share_of_power_that_the_input_explains(plain_run):
    run = noisy(plain_run, 3, output_noise=GAIN)
    coherence, averages = coherence_of(run, "w", BAND, 512)
    assert np.mean(coherence) == pytest.approx(0.5, abs=0.02)
    assert averages == pytest.approx(0.947 * (2 * 100_000 / 512 - 1), rel=0.01)
    silent = Test.of(plain_run(np.zeros(100_000), run.channel("w")))
    assert not coherence_of(silent, "w", BAND, 512)[0].any()
    assert not welch([silent], "w", BAND, 512).response.any()


def test_repeated_tests_of_any_length_average(plain_run):
    runs = [noisy(plain_run, seed, samples) for seed, samples in ((4, 20_000), (5, 60_000))]
    one, both = welch(runs[:1], "w", BAND, 1024), welch(runs, "w", BAND, 1024)
    error = [np.sqrt(np.mean(np.abs(found.response[:, 0] - GAIN) ** 2)) for found in (one, both)]
    assert error[0] / error[1] == pytest.approx(2, rel=0.15), "four times the averages"
    assert np.median(one.sigma) / np.median(both.sigma) == pytest.approx(2, rel=0.1)
