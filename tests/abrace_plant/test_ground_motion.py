from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from abrace_core.errors import AbraceError
from abrace_plant.ground_motion import TAPER, prepare
from abrace_plant.record_files import Record, read_record

G = 9.80665
KOBE = Path(__file__).parents[3] / "shared" / "ground_motions" / "RSN1106_KOBE_KJM000.AT2"


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
    motion = prepare(Record("late", 0.01, acceleration), 500.0, duration=60.0)
    assert np.abs(motion[:13_000]).max() == 0
    assert motion[14_980] > 0.5


def test_motion_at_a_recorded_instant_is_not_shifted():
    acceleration = np.zeros(1001)
    acceleration[400] = 1.0
    motion = prepare(Record("pulse", 0.02, acceleration), 500.0)
    peak = 400 * 10
    assert np.abs(motion).argmax() == peak
    np.testing.assert_allclose(motion[peak - 200 : peak], motion[peak + 200 : peak : -1], atol=1e-12)


def test_band_limit_removes_what_is_above_and_keeps_what_is_well_below():
    kept, removed = (1.0, 5.0, 7.9), (10.5, 19.0)
    motion = prepare(recorded(0.01, frequencies=kept + removed), 500.0, band_limit=10.0)
    exact = tones(np.arange(len(motion)) / 500.0, kept)
    assert np.abs(motion - exact).max() < 2e-5 * np.abs(exact).max()


@pytest.mark.parametrize(("period", "rate"), [(0.02, 500.0), (0.002, 40.0), (0.01, 100.0)])
def test_band_limit_beyond_what_the_record_or_the_rig_holds_changes_nothing(period, rate):
    record = recorded(period)
    assert prepare(record, rate, band_limit=200.0).tobytes() == prepare(record, rate).tobytes()


def test_zero_duration_and_zero_peak_mean_the_whole_record_as_recorded():
    record = read_record("el_centro")
    motion = prepare(record, 500.0)
    assert len(motion) == 5371 * 5 + 1
    assert np.abs(motion).max() == pytest.approx(np.abs(record.acceleration).max(), rel=0.02)
    assert np.corrcoef(motion[::5], record.acceleration)[0, 1] > 0.99999


@pytest.mark.parametrize("duration", [0.0, 30.0, 100.0])
def test_peak_of_the_played_motion_is_exactly_as_asked(duration):
    motion = prepare(read_record("el_centro"), 500.0, 0.1 * G, duration)
    assert np.abs(motion).max() == 0.1 * G


def test_padded_motion_is_the_papers_100_s_and_ends_in_zeros():
    record = read_record("el_centro")
    motion, whole = prepare(record, 500.0, duration=100.0), prepare(record, 500.0)
    assert motion.shape == (50_000,)
    np.testing.assert_array_equal(motion[: len(whole)], whole)
    assert not motion[len(whole) + 500 :].any()


def test_cut_motion_is_the_longer_one_fading_out():
    record = read_record("el_centro")
    whole, cut = prepare(record, 500.0, 1.0), prepare(record, 500.0, 1.0, duration=20.0)
    fade = round(TAPER * 500)
    assert cut.shape == (10_000,)
    np.testing.assert_array_equal(cut[:-fade], whole[: 10_000 - fade])
    assert cut[-1] == 0
    assert (np.abs(cut[-fade:]) <= np.abs(whole[10_000 - fade : 10_000])).all()


def test_motion_cut_before_its_peak_keeps_the_scale_of_the_whole():
    record = read_record("el_centro")
    assert np.abs(prepare(record, 500.0, 1.0, duration=1.5)).max() < 0.9


@pytest.mark.skipif(not KOBE.exists(), reason=f"the Kobe record is not the project's to ship; no {KOBE.name} beside it")
def test_kobe_is_played_for_60_s_at_its_pga():
    motion = prepare(read_record(KOBE), 500.0, 0.1 * G, 60.0)
    assert motion.shape == (30_000,)
    assert np.abs(motion).max() == 0.1 * G
    assert np.abs(motion).argmax() / 500.0 == pytest.approx(8.52, abs=0.02)


@settings(max_examples=40, deadline=None)
@given(
    rate=st.sampled_from([100.0, 256.0, 500.0, 1000.0]),
    period=st.sampled_from([0.02, 0.005, 1 / 200.3, 0.001]),
    peak=st.floats(0.01, 20.0),
    duration=st.floats(0.05, 12.0),
    seed=st.integers(0, 1000),
)
def test_any_motion_has_the_asked_length_stays_finite_and_within_its_peak(rate, period, peak, duration, seed):
    record = Record("noise", period, np.random.default_rng(seed).standard_normal(round(6 / period)))
    motion = prepare(record, rate, peak, duration)
    assert len(motion) == max(round(duration * rate), 1)
    assert np.isfinite(motion).all()
    assert np.abs(motion).max() <= peak


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"sample_rate": 0.0}, "sample_rate 0.0, expected more than 0"),
        ({"sample_rate": float("nan")}, "sample_rate nan"),
        ({"peak_acceleration": -1.0}, "peak_acceleration -1.0, expected 0 or more"),
        ({"peak_acceleration": float("inf")}, "peak_acceleration inf"),
        ({"duration": -0.1}, "duration -0.1, expected 0 or more"),
        ({"duration": 1e-4}, "duration 0.0001 s, expected a sample or more"),
        ({"band_limit": -5.0}, "band_limit -5.0"),
        ({"sample_rate": 1e-3}, "expected less than 5000 times"),
    ],
)
def test_bad_argument_is_refused_with_what_was_expected(arguments, message):
    with pytest.raises(AbraceError, match=f"ground motion burst: .*{message}"):
        prepare(recorded(0.02), **({"sample_rate": 500.0} | arguments))


def test_record_of_zeros_cannot_be_scaled():
    with pytest.raises(AbraceError, match="zero throughout"):
        prepare(Record("still", 0.01, np.zeros(100)), 500.0, 1.0)
