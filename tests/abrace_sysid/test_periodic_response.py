# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.discretization import discretize
from abrace_core.model.multisine import multisine
from abrace_sysid.input_tests import _repeated_realizations
from abrace_sysid.recorded.series import find_period, same_realization
from abrace_sysid.recorded.test import Test
from abrace_sysid.spectra.periodic_response import periodic_response

PERIOD = 16384
BANDS = {"w": (0.3, 10.0), "U": (0.3, 30.0)}
INPUTS = ("w", "U")


def played(name, lines="odd", periods=5, rest=1000, period=PERIOD, seed=1):
    """A multisine between rests, at the level of the paper's tests."""
    one = multisine(period, 500.0, BANDS[name], {"w": 0.25, "U": 1800.0}[name], seed, lines)
    return np.concatenate([np.zeros(rest), np.tile(one, periods), np.zeros(rest)])


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


@pytest.fixture(scope="module")
def apart(laboratory):
    """The test of each input alone."""
    ground, command = played("w"), played("U", seed=2)
    return {
        "w": laboratory.open_loop("bags/table", ground, 0 * ground),
        "U": laboratory.open_loop("bags/command", 0 * command, command),
    }


@pytest.fixture(scope="module")
def together(laboratory):
    return laboratory.open_loop("bags/both", played("w"), played("U", "even", seed=2))


@pytest.fixture(scope="module")
def relative_error(rig):
    """(channels,) rms error of an estimate, of the rms of the sampled rig's true response."""
    true = discretize(rig.model, 0.002)

    def error(estimate):
        expected = true.frequency_response(estimate.omega)[:, :, INPUTS.index(estimate.input)]
        return np.linalg.norm(estimate.response - expected, axis=0) / np.linalg.norm(expected, axis=0)

    return error


@pytest.mark.parametrize(("name", "most"), [("w", 0.005), ("U", 0.012)])
def test_response_of_each_input_alone_is_true_in_every_channel(apart, relative_error, name, most):
    error = relative_error(periodic_response(Test.of(apart[name]), name, BANDS[name]))
    assert error.max() < most, error


@pytest.mark.parametrize(("name", "most"), [("w", 0.005), ("U", 0.012)])
def test_two_inputs_at_once_are_told_apart_by_their_lines(together, relative_error, name, most):
    found = periodic_response(Test.of(together), name, BANDS[name])
    error = relative_error(found)
    assert error.max() < most, error
    lines = np.rint(found.omega * PERIOD * 0.002 / (2 * np.pi)).astype(int)
    assert (lines % 2 == (name == "w")).all()


@pytest.mark.parametrize("name", INPUTS)
def test_sigma_is_the_standard_deviation_of_the_estimate(rig, apart, name):
    found = periodic_response(Test.of(apart[name]), name, BANDS[name])
    expected = discretize(rig.model, 0.002).frequency_response(found.omega)[:, :, INPUTS.index(name)]
    # the modulus of a complex normal variable has the median sqrt(ln 2) = 0.83 of its standard deviation
    ratio = np.median(np.abs(found.response - expected) / found.sigma, axis=0)
    assert (ratio > 0.65).all(), ratio
    assert (ratio < 1.05).all(), ratio


def test_excited_lines_of_the_band_are_those_that_were_played(apart):
    found = periodic_response(Test.of(apart["U"]), "U", (5.0, 40.0))
    amplitudes = np.abs(np.fft.rfft(played("U", seed=2)[1000 : 1000 + PERIOD]))
    lines = np.flatnonzero(amplitudes > 1e-6 * amplitudes.max())
    lines = lines[lines * 500 / PERIOD >= 5]
    np.testing.assert_allclose(found.omega, 2 * np.pi * lines * 500 / PERIOD)
    assert found.response.shape == found.sigma.shape == (len(lines), 8)


@pytest.mark.parametrize("rest", [0, 137, 30_000])
@pytest.mark.parametrize("name", INPUTS)
def test_period_and_its_repetitions_are_found_between_rests(laboratory, rest, name):
    signal = played(name, periods=4, rest=rest, period=4096)
    given = (signal, 0 * signal) if name == "w" else (0 * signal, signal)
    run = laboratory.open_loop("bags/test", *given)
    found = periodic_response(Test.of(run), name, BANDS[name])
    assert found.method == "multisine, 3 periods of 4096 samples, 1 dropped"


def test_a_test_cut_off_within_a_period_gives_its_whole_ones(apart, relative_error):
    run = apart["w"]
    end = 1000 + 4 * PERIOD + 9000
    cut = replace(
        run,
        sequence=run.sequence[:end],
        outputs=run.outputs[:end],
        ground_acceleration=run.ground_acceleration[:end],
        command=run.command[:end],
    )
    found = periodic_response(Test.of(cut), "w", BANDS["w"])
    assert found.method.startswith("multisine, 3 periods")
    assert relative_error(found).max() < 0.006


def test_a_bias_of_the_sensors_changes_nothing(apart):
    run = apart["w"]
    biased = replace(run, ground_acceleration=run.ground_acceleration + 50.0, outputs=run.outputs + 3.0)
    one, other = (periodic_response(Test.of(each), "w", BANDS["w"]) for each in (run, biased))
    np.testing.assert_allclose(one.response, other.response, rtol=1e-9)


def test_white_noise_and_rest_have_no_period():
    assert find_period(np.random.default_rng(0).standard_normal(20_000)) is None
    assert find_period(np.zeros(1000)) is None


def test_noise_level_is_that_of_the_sensor(plain_run):
    signal = played("U", periods=5, period=4096)
    noise = np.random.default_rng(3).normal(0.0, 50.0, len(signal))
    until = np.append(0.0, signal[:-1])
    found = periodic_response(Test.of(plain_run(2 * signal + noise, command=until)), "U", BANDS["U"])
    # 4 periods used; white noise spreads evenly over the transform's lines; the transient's polynomial of order 4
    # through the 12 lines in between adds a share of 0.315 to the variance of the line in their middle
    expected = 50.0 * np.sqrt(len(found.omega) * 2 / (4 * 4096) * 1.315)
    assert 1800.0 * rms(found.sigma[:, 0]) == pytest.approx(expected, rel=0.05)
    assert rms(np.abs(found.response[:, 0])) == pytest.approx(2.0, rel=0.01)


def test_the_same_phases_in_two_tests_are_found_and_others_are_not():
    rng = np.random.default_rng(0)
    one, later = played("U", rest=1000), played("U", periods=4, rest=3000)
    assert same_realization(one, 2 * later + rng.normal(0, 100, len(later)))
    assert not same_realization(one, played("U", seed=2))


def test_tests_that_repeat_a_realization_are_named(laboratory_of, rig):
    first = laboratory_of(rig, 1).multisine_test(False, True, 3)
    again = replace(laboratory_of(rig, 1).multisine_test(False, True, 4), source="bags/again")
    other = replace(laboratory_of(rig, 2).multisine_test(False, True, 3), source="bags/other")
    expected = "bags/multisine and bags/again: the same multisine of U; expected different seeds"
    (found,) = _repeated_realizations([Test.of(first), Test.of(again)], ["U"])
    assert found.startswith(expected)
    assert not _repeated_realizations([Test.of(first), Test.of(other)], ["U"])


def test_what_cannot_be_estimated_is_refused_with_the_reason(laboratory, apart, table_test):
    with pytest.raises(AbraceError, match="bags/table: w does not repeat itself after any time, expected a periodic"):
        periodic_response(Test.of(table_test), "w", BANDS["w"])
    with pytest.raises(AbraceError, match="bags/table: U does not repeat itself after 16384 samples"):
        periodic_response(Test.of(apart["w"]), "U", BANDS["w"])
    short = laboratory.open_loop("bags/short", played("w", periods=2), 0 * played("w", periods=2))
    with pytest.raises(AbraceError, match="expected at least 3 periods, of which 1 is dropped"):
        periodic_response(Test.of(short), "w", BANDS["w"])
    with pytest.raises(AbraceError, match="w excites no line between 12 and 20 Hz"):
        periodic_response(Test.of(apart["w"]), "w", (12.0, 20.0))
    with pytest.raises(AbraceError, match=r"no line of the period between 1\.001 and 1\.002 Hz"):
        periodic_response(Test.of(apart["w"]), "w", (1.001, 1.002))
    both = laboratory.open_loop("bags/both", played("w", period=4096), played("U", period=4096))
    with pytest.raises(AbraceError, match=r"w and U both excite the line at .* Hz, expected inputs on different lines"):
        periodic_response(Test.of(both), "w", BANDS["w"])


@pytest.mark.parametrize("name", INPUTS)
def test_the_free_decay_of_known_modes_is_removed(rig, laboratory, relative_error, name):
    """Periods of 8 s and rest before: half of the first mode's decay is left after the dropped period."""
    signal = played(name, periods=3, rest=700, period=4096)
    given = (signal, 0 * signal) if name == "w" else (0 * signal, signal)
    run = laboratory.open_loop("bags/short", *given)
    poles = rig.model.poles
    one, other = (
        periodic_response(Test.of(run), name, BANDS[name], poles=known) for known in (None, poles[poles.imag > 0])
    )
    assert relative_error(other).max() < relative_error(one).max() / 3, (relative_error(one), relative_error(other))
    assert (other.sigma.max(axis=0) < one.sigma.max(axis=0) / 2).all()


def test_poles_that_no_response_has_change_next_to_nothing(apart):
    one, other = (
        periodic_response(Test.of(apart["w"]), "w", BANDS["w"], poles=known)
        for known in (None, np.array([-0.2 + 14.0j, -1.0 + 50.0j]))
    )
    assert np.median(np.abs(other.response - one.response) / one.sigma) < 0.5
