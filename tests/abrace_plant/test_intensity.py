# SPDX-License-Identifier: Apache-2.0
import eqsig
import numpy as np
import pytest
from eqsig import im
from hypothesis import given, settings
from hypothesis import strategies as st

from abrace_core.errors import AbraceError
from abrace_plant.records.files import read_record
from abrace_plant.records.intensity import STANDARD_GRAVITY, husid, integrate, intensity
from abrace_plant.records.record import Record

EQSIG_GRAVITY = 9.81


@pytest.mark.parametrize("name", ["el_centro", "loma_prieta"])
def test_measures_are_eqsigs(name):
    record = read_record(name)
    own, peer = intensity(record), eqsig.AccSignal(record.acceleration, record.sample_period)
    begin, end = im.calc_sig_dur(peer, se=True)
    arias = im.calc_arias_intensity(peer)[-1] * EQSIG_GRAVITY / STANDARD_GRAVITY
    assert own.arias_intensity == pytest.approx(arias, rel=1e-12)
    assert own.cumulative_absolute_velocity == pytest.approx(im.calc_cav(peer)[-1], rel=1e-12)
    # eqsig counts whole samples: the first beyond 5 %, the last before 95 %
    assert 0 <= begin - own.significant_from < record.sample_period
    assert 0 <= own.significant_to - end < record.sample_period
    assert own.significant_duration == pytest.approx(end - begin, abs=2 * record.sample_period)
    assert own.peak_velocity == pytest.approx(np.abs(peer.velocity).max(), rel=1e-12)
    # eqsig takes the trapezoidal rule for the displacement
    assert own.peak_displacement == pytest.approx(np.abs(peer.displacement).max(), rel=2e-4)


def test_measures_of_a_level_acceleration_are_those_of_a_ruler():
    own = intensity(Record("level", 0.01, np.full(1001, 2.0)))
    assert own.peak_acceleration == 2.0
    assert own.peak_velocity == pytest.approx(20.0)
    assert own.peak_displacement == pytest.approx(100.0)
    assert own.cumulative_absolute_velocity == pytest.approx(20.0)
    assert own.arias_intensity == pytest.approx(np.pi / (2 * STANDARD_GRAVITY) * 40.0)
    assert own.significant_from == pytest.approx(0.5)
    assert own.significant_duration == pytest.approx(9.0)


@settings(max_examples=50)
@given(slope=st.floats(-5, 5), level=st.floats(-5, 5), samples=st.integers(2, 400), period=st.floats(0.001, 0.1))
def test_velocity_and_displacement_of_a_straight_acceleration_are_exact(slope, level, samples, period):
    time = period * np.arange(samples)
    velocity, displacement = integrate(level + slope * time, period)
    np.testing.assert_allclose(velocity, level * time + slope * time**2 / 2, atol=1e-8)
    np.testing.assert_allclose(displacement, level * time**2 / 2 + slope * time**3 / 6, atol=1e-7)


@settings(max_examples=30)
@given(factor=st.floats(0.01, 100.0), seed=st.integers(0, 1000))
def test_measures_scale_with_the_motion_and_the_duration_does_not(factor, seed):
    acceleration = np.random.default_rng(seed).standard_normal(500)
    once, scaled = (intensity(Record("noise", 0.01, size * acceleration)) for size in (1.0, factor))
    assert scaled.peak_velocity == pytest.approx(factor * once.peak_velocity)
    assert scaled.arias_intensity == pytest.approx(factor**2 * once.arias_intensity)
    assert scaled.significant_duration == pytest.approx(once.significant_duration)


def test_husid_plot_rises_from_zero_to_the_arias_intensity():
    record = read_record("el_centro")
    built_up = husid(record.acceleration, record.sample_period)
    assert built_up[0] == 0
    assert (np.diff(built_up) >= 0).all()
    assert built_up[-1] == intensity(record).arias_intensity


@pytest.mark.parametrize("samples", [2, 100])
def test_zeros_measure_zero(samples):
    own = intensity(Record("still", 0.01, np.zeros(samples)))
    assert own.peak_acceleration == own.peak_displacement == own.arias_intensity == own.significant_duration == 0


@pytest.mark.parametrize(
    ("acceleration", "period", "message"),
    [
        ([1.0, np.nan], 0.01, "sample 2 is nan, expected a finite number"),
        ([1.0], 0.01, "1 samples, expected at least 2"),
        ([1.0, 2.0], 0.0, "sample period 0.0 s, expected more than 0"),
    ],
)
def test_what_is_no_motion_is_refused(acceleration, period, message):
    with pytest.raises(AbraceError, match=f"ground motion broken: {message}"):
        intensity(Record("broken", period, np.array(acceleration)))
