# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from abrace_core.errors import AbraceError
from abrace_sysid.spectra.welch import coherence_of, welch

BAND = (5.0, 100.0)
GAIN = 3.0


def noisy(plain_run, seed, samples=100_000, output_noise=1.0, input_noise=0.0):
    random = np.random.default_rng(seed)
    excitation = random.standard_normal(samples)
    outputs = GAIN * excitation + output_noise * random.standard_normal(samples)
    return plain_run(outputs, excitation + input_noise * random.standard_normal(samples))


def test_h1_is_unbiased_for_noise_in_the_outputs_h2_in_the_input_hv_in_between(plain_run):
    for output_noise, input_noise, right in ((2.0, 0.0, "H1"), (0.0, 0.7, "H2"), (0.7 * GAIN, 0.7, "Hv")):
        run = noisy(plain_run, 1, output_noise=output_noise, input_noise=input_noise)
        gain = {name: np.abs(welch(run, "w", BAND, 1024, name).response.mean(axis=0)[0]) for name in ("H1", "H2", "Hv")}
        assert gain[right] == pytest.approx(GAIN, rel=0.02)
        assert gain["H1"] < gain["Hv"] < gain["H2"]
        assert max(abs(value - GAIN) for value in gain.values()) > 0.3


@pytest.mark.parametrize(("window", "overlap"), [("hann", 0.5), ("hann", 0.75), ("boxcar", 0.0), ("blackman", 0.5)])
def test_sigma_holds_for_every_window_and_overlap(plain_run, window, overlap):
    found = welch(noisy(plain_run, 2), "w", BAND, 2048, window=window, overlap=overlap)
    ratio = np.sqrt(np.mean(np.abs(found.response[:, 0] - GAIN) ** 2) / np.mean(found.sigma[:, 0] ** 2))
    assert 0.9 < ratio < 1.1, ratio


def test_coherence_is_the_share_of_power_that_the_input_explains(plain_run):
    run = noisy(plain_run, 3, output_noise=GAIN)
    coherence, averages = coherence_of(run, "w", BAND, 512)
    assert np.mean(coherence) == pytest.approx(0.5, abs=0.02)
    assert averages == pytest.approx(0.947 * (2 * 100_000 / 512 - 1), rel=0.01)
    silent = plain_run(np.zeros(100_000), run.ground_acceleration)
    assert not coherence_of(silent, "w", BAND, 512)[0].any()
    assert not welch(silent, "w", BAND, 512).response.any()


def test_repeated_tests_of_any_length_average(plain_run):
    runs = [noisy(plain_run, seed, samples) for seed, samples in ((4, 20_000), (5, 60_000))]
    one, both = welch(runs[0], "w", BAND, 1024), welch(runs, "w", BAND, 1024)
    error = [np.sqrt(np.mean(np.abs(found.response[:, 0] - GAIN) ** 2)) for found in (one, both)]
    assert error[0] / error[1] == pytest.approx(2, rel=0.15), "four times the averages"
    assert np.median(one.sigma) / np.median(both.sigma) == pytest.approx(2, rel=0.1)


def test_options_that_are_none_are_refused(plain_run):
    run = noisy(plain_run, 6, 5_000)
    with pytest.raises(AbraceError, match="estimator 'H3', expected 'H1', 'H2' or 'Hv'"):
        welch(run, "w", BAND, 512, "H3")
    with pytest.raises(AbraceError, match="overlap 1, expected 0 to less than 1"):
        welch(run, "w", BAND, 512, overlap=1.0)
    with pytest.raises(AbraceError, match="window 'round', expected one of"):
        welch(run, "w", BAND, 512, window="round")
