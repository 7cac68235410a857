# SPDX-License-Identifier: Apache-2.0

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from abrace_core import AbraceError
from abrace_plant.records.files import read_record
from abrace_plant.records.measures import integrate
from abrace_plant.records.options import Treatment
from abrace_plant.records.record import Record
from abrace_plant.records.treatment import BASELINES, FADE, prepare, without_baseline

G = 9.80665


def tones(time: np.ndarray, frequencies: tuple[float, ...] = (0.7, 3.0, 9.7, 15.3, 19.9)) -> np.ndarray:
    """A burst of tones below 20 Hz, gone at both ends of 40 s."""
    return np.exp(-(((time - 20) / 4) ** 2)) * sum(np.sin(2 * np.pi * f * time + f) for f in frequencies)


def recorded(period: float, **tone: tuple[float, ...]) -> Record:
    return Record("burst", period, tones(np.arange(0, 40, period), **tone))


@pytest.mark.parametrize("period", [0.02, 0.01, 0.005, 1 / 256, 0.0039, 0.001, 0.0005])
def test_resampling_error_below_20_hz_is_less_than_1e_5_of_the_peak(period):
    motion = prepare(recorded(period), 500.0)
    exact = tones(np.arange(len(motion)) / 500.0)
    assert len(motion) / 500.0 == pytest.approx(40.0, abs=0.03)
    assert np.abs(motion - exact).max() < 1e-5 * np.abs(exact).max()


def test_resampling_to_a_slower_rig_keeps_the_motion_and_no_alias():
    below, above = recorded(0.002), recorded(0.002, frequencies=(31.0, 45.0, 120.0))
    exact = tones(np.arange(2000) / 50.0)
    assert np.abs(prepare(below, 50.0)[:2000] - exact).max() < 1e-5 * np.abs(exact).max()
    assert np.abs(prepare(above, 50.0)).max() < 2e-5


def test_record_at_the_rigs_rate_passes_bit_for_bit():
    record = recorded(0.002)
    assert prepare(record, 500.0).tobytes() == record.acceleration.tobytes()


def test_nothing_wraps_round_from_the_end_of_a_record_to_its_start():
    acceleration = np.zeros(3000)
    acceleration[-5:] = 1.0
    motion = prepare(Record("late", 0.01, acceleration), 500.0, Treatment(duration=60.0))
    assert np.abs(motion[:13_000]).max() == 0
    assert motion[14_980] > 0.5


def test_band_limit_removes_what_is_above_and_keeps_what_is_well_below():
    kept, removed = (1.0, 5.0, 7.9), (10.5, 19.0)
    motion = prepare(recorded(0.01, frequencies=kept + removed), 500.0, Treatment(band_limit=10.0))
    exact = tones(np.arange(len(motion)) / 500.0, kept)
    assert np.abs(motion - exact).max() < 2e-5 * np.abs(exact).max()


@pytest.mark.parametrize(("period", "rate"), [(0.02, 500.0), (0.002, 40.0), (0.01, 100.0)])
def test_band_limit_beyond_what_the_record_or_the_rig_holds_changes_nothing(period, rate):
    record = recorded(period)
    assert prepare(record, rate, Treatment(band_limit=200.0)).tobytes() == prepare(record, rate).tobytes()


@pytest.mark.parametrize("duration", [0.0, 30.0, 100.0])
def test_peak_of_the_played_motion_is_exactly_as_asked(duration):
    motion = prepare(read_record("el_centro"), 500.0, Treatment(peak_acceleration=0.1 * G, duration=duration))
    assert np.abs(motion).max() == 0.1 * G


def test_padded_motion_is_the_papers_100_s_and_ends_in_zeros():
    record = read_record("el_centro")
    motion, whole = prepare(record, 500.0, Treatment(duration=100.0)), prepare(record, 500.0)
    assert motion.shape == (50_000,)
    np.testing.assert_array_equal(motion[: len(whole)], whole)
    assert not motion[len(whole) + 500 :].any()


def test_cut_motion_is_the_longer_one_coming_to_rest():
    record = read_record("el_centro")
    whole, cut = (prepare(record, 500.0, Treatment(peak_acceleration=1.0, duration=length)) for length in (0.0, 20.0))
    fade = round(FADE * 500)
    assert cut.shape == (10_000,)
    np.testing.assert_array_equal(cut[:-fade], whole[: 10_000 - fade])
    assert cut[-1] == 0
    velocity, _ = integrate(np.array([0.0, *cut]), 0.002)
    assert abs(velocity[-1]) < 1e-12, "it ends at rest"
    assert np.abs(np.diff(cut)).max() <= np.abs(np.diff(whole)).max()


def test_motion_cut_before_its_peak_keeps_the_scale_of_the_whole():
    record = read_record("el_centro")
    assert np.abs(prepare(record, 500.0, Treatment(peak_acceleration=1.0, duration=1.5))).max() < 0.9


@settings(max_examples=40)
@given(
    rate=st.sampled_from([100.0, 256.0, 500.0, 1000.0]),
    period=st.sampled_from([0.02, 0.005, 1 / 200.3, 0.001]),
    peak=st.floats(0.01, 20.0),
    duration=st.floats(0.05, 12.0),
    seed=st.integers(0, 1000),
)
@example(rate=100.0, period=0.005, peak=1.0, duration=5.0, seed=98)  # its fade leaves much velocity
def test_any_motion_has_the_asked_length_stays_finite_and_within_its_peak(rate, period, peak, duration, seed):
    record = Record("noise", period, np.random.default_rng(seed).standard_normal(round(6 / period)))
    motion = prepare(record, rate, Treatment(peak_acceleration=peak, duration=duration))
    assert len(motion) == max(round(duration * rate), 1)
    assert np.isfinite(motion).all()
    assert np.abs(motion).max() <= peak


@pytest.mark.parametrize(
    ("rate", "message"),
    [(0.0, "sample_rate 0.0, expected more than 0"), (float("nan"), "sample_rate nan"), (1e-3, "less than 5000 times")],
)
def test_bad_sample_rate_is_refused_with_what_was_expected(rate, message):
    with pytest.raises(AbraceError, match=f"ground motion burst: .*{message}"):
        prepare(recorded(0.02), rate)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"peak_acceleration": -1.0}, ": peak_acceleration: -1.0, expected greater than or equal to 0"),
        ({"band_limit": 0.025}, ": band_limit: 0.025, expected 0 or at least 0.1 Hz"),
        ({"time_scale": 0.0}, ": time_scale: 0.0, expected greater than or equal to 0.001"),
        ({"baseline": "cubic"}, ": baseline: 'cubic', expected 'none', 'constant', 'linear' or 'quadratic'"),
        ({"duration": 1e-4}, " burst: duration 0.0001 s, expected a sample or more"),
        ({"taper": 20.0}, " burst: taper 20 s, expected at most half of the motion's 39.98 s"),
        ({"low_cut": 10.0, "band_limit": 8.0}, " burst: low_cut 10 Hz, expected less than 8 Hz"),
    ],
)
def test_bad_treatment_is_refused_with_what_was_expected(arguments, message):
    with pytest.raises(AbraceError, match=f"^ground motion{message}"):
        prepare(recorded(0.02), 500.0, Treatment(**arguments))


@pytest.mark.parametrize(
    ("acceleration", "message"),
    [([0.0, np.nan, 1.0], "sample 2 is nan"), ([0.0, 1.0, np.inf], "sample 3 is inf"), ([1.0], "1 samples")],
)
def test_record_that_is_no_motion_is_refused(acceleration, message):
    with pytest.raises(AbraceError, match=f"ground motion broken: {message}"):
        prepare(Record("broken", 0.01, np.array(acceleration)), 500.0)


@pytest.mark.parametrize("baseline", BASELINES)
def test_record_of_zeros_stays_zero_and_of_two_samples_finite_under_every_treatment(baseline):
    treatment = Treatment(baseline=baseline, low_cut=1.0, band_limit=20.0, taper=0.001)
    assert not prepare(Record("still", 0.01, np.zeros(100)), 500.0, treatment).any()
    short = prepare(Record("short", 0.01, np.array([1.0, -2.0])), 500.0, treatment)
    assert len(short) == 6
    assert np.isfinite(short).all()


def test_record_of_zeros_cannot_be_scaled():
    with pytest.raises(AbraceError, match="zero throughout"):
        prepare(Record("still", 0.01, np.zeros(100)), 500.0, Treatment(peak_acceleration=1.0))


@settings(max_examples=30)
@given(
    coefficients=st.lists(st.floats(-0.3, 0.3), min_size=1, max_size=3),
    period=st.sampled_from([0.01, 0.004]),
)
def test_baseline_correction_takes_away_a_polynomial_of_its_degree_and_only_that(coefficients, period):
    time = np.arange(0, 40, period)
    polynomial = np.polynomial.polynomial.polyval(time / 40, coefficients)
    baseline = tuple(BASELINES)[len(coefficients)]
    clean = tones(time)
    np.testing.assert_allclose(without_baseline(polynomial, period, baseline), 0, atol=1e-9)
    without = without_baseline(clean, period, baseline)
    np.testing.assert_allclose(without_baseline(clean + polynomial, period, baseline), without, atol=1e-9)
    assert np.abs(without - clean).max() < 2e-3


@pytest.mark.parametrize("baseline", ["constant", "linear", "quadratic"])
def test_no_other_baseline_leaves_a_smaller_mean_square_velocity(baseline):
    record = read_record("el_centro")
    time = np.linspace(-1, 1, len(record.acceleration))
    corrected = without_baseline(record.acceleration + 0.02 * time**3, record.sample_period, baseline)
    velocity, _ = integrate(corrected, record.sample_period)
    for degree in range(BASELINES[baseline]):
        for size in (-1e-5, 1e-5):
            other, _ = integrate(corrected + size * time**degree, record.sample_period)
            assert np.mean(other**2) > np.mean(velocity**2), (degree, size)


@pytest.mark.parametrize("scale", [0.5, 1 / np.sqrt(5), 2.0])
def test_time_scaling_changes_the_time_and_not_the_acceleration(scale):
    motion = prepare(recorded(0.005), 500.0, Treatment(time_scale=scale))
    exact = tones(np.arange(len(motion)) / 500.0 / scale)
    assert len(motion) / 500.0 == pytest.approx(40.0 * scale, abs=0.03)
    assert np.abs(motion - exact).max() < 2e-4 * np.abs(exact).max()


@pytest.mark.parametrize(("frequency", "gain"), [(0.25, 1 / 257), (0.5, 0.5), (1.0, 256 / 257), (2.0, 65536 / 65537)])
def test_low_cut_has_its_gain_and_no_shift_in_time(frequency, gain):
    sinusoid = np.sin(2 * np.pi * frequency * np.arange(0, 200, 0.01) + 0.4)
    motion = prepare(Record("sinusoid", 0.01, sinusoid), 100.0, Treatment(low_cut=0.5))
    np.testing.assert_allclose(motion[6000:14000], gain * sinusoid[6000:14000], atol=1e-8)


@pytest.mark.parametrize("name", ["el_centro", "loma_prieta", "san_fernando", "northridge_aftershock"])
@pytest.mark.parametrize("taper", [0.0, 2.0])
def test_low_cut_leaves_no_drift_in_velocity_and_displacement(name, taper):
    record = read_record(name)
    drifting = Record(name, record.sample_period, record.acceleration + 0.02)
    motion = prepare(drifting, 500.0, Treatment(low_cut=0.1, taper=taper))
    _, uncorrected = integrate(prepare(drifting, 500.0), 0.002)
    velocity, displacement = integrate(motion, 0.002)
    assert np.abs(uncorrected).max() > 3
    assert abs(velocity[-1]) < 1e-4
    assert np.abs(displacement).max() < 0.5
    assert abs(displacement[-1]) < 0.05


def test_taper_is_a_trapezoid_over_the_record():
    record = Record("level", 0.01, np.ones(1001))
    motion = prepare(record, 100.0, Treatment(taper=2.0, duration=12.0))
    expected = np.interp(np.arange(1200) / 100, [0, 2, 8, 10], [0, 1, 1, 0])
    np.testing.assert_allclose(motion, expected, atol=1e-12)
