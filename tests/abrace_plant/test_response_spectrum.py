# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from eqsig import sdof
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from abrace_core.errors import AbraceError
from abrace_plant.records.files import read_record
from abrace_plant.records.record import Record
from abrace_plant.records.response_spectrum import STEPS_PER_PERIOD, response_spectrum

BETWEEN = 1 / np.cos(np.pi / 6) - 1
"""Share by which a peak may lie above the samples at 6 samples a period, the coarsest that eqsig takes."""


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


@pytest.mark.parametrize("ratio", [0.02, 0.05, 0.10])
def test_resonance_builds_up_to_one_over_twice_the_damping_ratio(ratio):
    step, period = 0.001, 0.5
    cycles = int(3 / ratio)
    time = np.arange(0, cycles * period, step)
    omega = 2 * np.pi / period
    own = response_spectrum(Record("sinusoid", step, 1.5 * np.sin(omega * time)), [period], [ratio])
    # to which the start's transient adds nothing: exp(-zeta omega t) is 1e-8 at the end
    assert own.pseudo_acceleration[0, 0] == pytest.approx(1.5 / (2 * ratio), rel=1e-4)


@pytest.mark.parametrize("share", [0.1, 0.25, 0.4])
def test_short_half_sine_pulse_gives_the_shock_spectrum_of_its_free_vibration(share):
    """Chopra, Dynamics of Structures, sec. 4.8: the peak comes after a pulse shorter than half a natural period."""
    length, step = 0.2, 2e-4
    period = length / share
    time = np.arange(0, length + 1.2 * period, step)
    pulse = np.where(time <= length, np.sin(np.pi * time / length), 0)
    own = response_spectrum(Record("pulse", step, pulse), [period], [0.0])
    amplification = 2 * (2 * share) * np.cos(np.pi * share) / (1 - (2 * share) ** 2)
    assert own.pseudo_acceleration[0, 0] == pytest.approx(amplification, rel=1e-4)


def test_a_stiff_oscillator_follows_the_ground_and_a_soft_one_stays_behind():
    time = np.arange(0, 4, 0.002)
    acceleration = np.exp(-(((time - 2) / 0.4) ** 2)) * np.sin(8 * time)
    own = response_spectrum(Record("burst", 0.002, acceleration), [0.02, 200.0], [0.05])
    ground = np.cumsum(np.cumsum(acceleration)) * 0.002**2
    assert own.pseudo_acceleration[0, 0] == pytest.approx(np.abs(acceleration).max(), rel=0.01)
    assert own.displacement[0, 1] == pytest.approx(np.abs(ground).max(), rel=0.02)


def test_more_damping_lowers_the_spectra_of_a_record():
    own = response_spectrum(read_record("el_centro"))
    assert own.displacement.shape == (3, len(own.periods))
    assert (np.diff(own.displacement.mean(axis=1)) < 0).all()
    assert (np.diff(own.velocity.mean(axis=1)) < 0).all()


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
