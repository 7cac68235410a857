# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy import signal

from abrace_core import AbraceError
from abrace_core.model.noise import banded_noise


@pytest.mark.parametrize(("samples", "rms"), [(1000, 0.1), (150_001, 1800.0)])
def test_rms_over_the_whole_length_is_as_asked(samples, rms):
    noise = banded_noise(samples, 500.0, (0.0, 10.0), rms, 1)
    assert noise.shape == (samples,)
    assert np.sqrt(np.mean(noise**2)) == pytest.approx(rms, rel=1e-12)


def test_spectrum_is_flat_in_the_band_and_empty_outside():
    noise = banded_noise(300_000, 500.0, (2.0, 30.0), 1.0, 3)
    frequencies, density = signal.welch(noise, 500.0, window="blackman", nperseg=5000, detrend=False)
    inside = density[(frequencies > 2.5) & (frequencies < 29.5)]
    outside = density[(frequencies < 1.0) | (frequencies > 31.0)]
    expected = 1.0 / 28.0
    assert inside.mean() == pytest.approx(expected, rel=0.02)
    assert inside.min() > 0.5 * expected
    assert inside.max() < 1.6 * expected
    assert outside.max() < 1e-6 * expected


def test_values_are_gaussian():
    noise = banded_noise(500_000, 500.0, (0.0, 100.0), 1.0, 5)
    # shares beyond 1, 2 and 3 standard deviations of a normal variable
    for limit, share in ((1, 0.3173), (2, 0.0455), (3, 0.0027)):
        assert np.mean(np.abs(noise) > limit) == pytest.approx(share, rel=0.1)


def test_noise_rises_from_zero_and_falls_to_it_within_a_second():
    noise = banded_noise(5000, 500.0, (0.0, 100.0), 1.0, 2)
    assert noise[0] == noise[-1] == 0
    assert np.abs(noise[:50]).max() < 0.15
    assert np.abs(noise[-50:]).max() < 0.15
    assert np.std(noise[500:1000]) > 0.7


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"band": (-1.0, 10.0)}, "band -1.0 to 10.0 Hz: expected 0 <= lowest < highest < 250 Hz"),
        ({"band": (0.0, float("nan"))}, "band"),
        ({"band": (1.0001, 1.0002)}, "expected one wider than"),
        ({"rms": 0.0}, "rms 0.0: expected more than 0"),
        ({"sample_rate": 0.0}, "sample_rate"),
        ({"seed": -1}, "seed -1: expected 0 or more"),
        ({"samples": 999}, "at least 2 s"),
    ],
)
def test_bad_argument_is_refused_with_what_was_expected(change, message):
    arguments = {"samples": 2000, "sample_rate": 500.0, "band": (0.0, 10.0), "rms": 1.0, "seed": 0} | change
    with pytest.raises(AbraceError, match=message):
        banded_noise(**arguments)
