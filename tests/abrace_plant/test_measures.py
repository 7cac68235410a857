# SPDX-License-Identifier: Apache-2.0
"""Intensity measures and response spectra beside eqsig's, exact solutions and hand calculations."""

import eqsig
import numpy as np
import pytest
from eqsig import im, sdof
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from abrace_core import AbraceError
from abrace_plant.records.files import read_record
from abrace_plant.records.measures import (
    STANDARD_GRAVITY,
    STEPS_PER_PERIOD,
    integrate,
    intensity,
    response_spectrum,
)
from abrace_plant.records.record import Record

EQSIG_GRAVITY = 9.81
BETWEEN = 1 / np.cos(np.pi / 6) - 1
"""Share by which a peak may lie above the samples at 6 samples a period, the coarsest that eqsig takes."""


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


@pytest.mark.parametrize("name", ["el_centro", "loma_prieta"])
def test_spectra_are_eqsigs_where_the_record_has_40_samples_a_period(name):
    record = read_record(name)
    shortest = STEPS_PER_PERIOD * record.sample_period
    own = response_spectrum(record, np.geomspace(1.001 * shortest, 10.0, 40))
    for i, ratio in enumerate(own.damping_ratios):
        arguments = (record.acceleration, record.sample_period, own.periods, ratio)
        displacement, _, acceleration = sdof.pseudo_response_spectra(*arguments)
        _, velocity, _ = sdof.true_response_spectra(*arguments)
        np.testing.assert_allclose(own.displacement[i], displacement, rtol=1e-7)
        np.testing.assert_allclose(own.pseudo_acceleration[i], acceleration, rtol=1e-7)
        np.testing.assert_allclose(own.velocity[i], velocity, rtol=1e-7)


def test_spectra_of_short_periods_are_no_lower_than_eqsigs_and_higher_by_what_lies_between_samples():
    record = read_record("el_centro")
    own = response_spectrum(record, np.geomspace(0.06, STEPS_PER_PERIOD * record.sample_period, 30))
    for i, ratio in enumerate(own.damping_ratios):
        displacement, _, _ = sdof.pseudo_response_spectra(record.acceleration, record.sample_period, own.periods, ratio)
        excess = own.displacement[i] / displacement - 1
        assert excess.min() > -1e-7
        assert 1e-3 < excess.max() < BETWEEN


@settings(max_examples=25)
@given(period=st.floats(0.41, 20.0), ratio=st.floats(0.0, 0.9), seed=st.integers(0, 1000), step=st.floats(0.001, 0.01))
def test_response_is_the_exact_one_to_a_motion_straight_between_samples(period, ratio, seed, step):
    acceleration = np.random.default_rng(seed).standard_normal(800)
    omega = 2 * np.pi / period
    oscillator = signal.StateSpace(
        [[0, 1], [-(omega**2), -2 * ratio * omega]], [[0], [-1]], np.eye(2), np.zeros((2, 1))
    )
    _, states, _ = signal.lsim(oscillator, acceleration, step * np.arange(800), interp=True)
    own = response_spectrum(Record("noise", step, acceleration), [period], [ratio])
    greatest = np.abs(states).max(axis=0)
    assert own.displacement[0, 0] == pytest.approx(greatest[0], rel=1e-7)
    assert own.velocity[0, 0] == pytest.approx(greatest[1], rel=1e-7)


def test_zeros_have_a_spectrum_of_zeros_and_two_samples_a_finite_one():
    assert not response_spectrum(Record("still", 0.01, np.zeros(50))).displacement.any()
    assert np.isfinite(response_spectrum(Record("short", 0.01, np.array([1.0, -1.0]))).velocity).all()


@pytest.mark.parametrize(
    ("periods", "ratios", "message"),
    [
        ([0.0, 1.0], [0.05], "expected each more than 0"),
        ([1.0, np.nan], [0.05], "expected each more than 0"),
        ([1.0], [1.0], "expected each from 0 to below 1"),
        ([1.0], [-0.1], "expected each from 0 to below 1"),
    ],
)
def test_periods_and_ratios_out_of_range_are_refused(periods, ratios, message):
    with pytest.raises(AbraceError, match=f"response spectrum of noise: .*{message}"):
        response_spectrum(Record("noise", 0.01, np.ones(10)), periods, ratios)
