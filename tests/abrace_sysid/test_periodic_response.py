# SPDX-License-Identifier: Apache-2.0
import json
from dataclasses import replace

import numpy as np
import pytest

from abrace_core.discretization import discretize
from abrace_core.errors import AbraceError
from abrace_core.multisine import multisine
from abrace_core.run import Run
from abrace_plant.rig.motion import RigMotion
from abrace_plant.rig.sensors import Measurement
from abrace_sysid.distortion_results import distortion_shares, write_distortion
from abrace_sysid.identification import identify
from abrace_sysid.spectra import measured_tests
from abrace_sysid.spectra.estimation import TransferFunctionOptions, frequency_responses
from abrace_sysid.spectra.periodic_response import find_period, periodic_response, same_realization

PERIOD = 16384
BANDS = {"w": (0.3, 10.0), "U": (0.3, 30.0)}
INPUTS = ("w", "U")


def played(name, lines="odd", periods=5, rest=1000, period=PERIOD, seed=1):
    """A multisine between rests, at the level of the paper's tests."""
    one = multisine(period, 500.0, BANDS[name], {"w": 0.25, "U": 1800.0}[name], seed, lines)
    return np.concatenate([np.zeros(rest), np.tile(one, periods), np.zeros(rest)])


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
def test_response_is_truer_than_white_noise_gives(laboratory, apart, relative_error, name, most):
    error = relative_error(periodic_response(apart[name], name, BANDS[name]).frequency_response)
    noise_test = laboratory.table_test(164) if name == "w" else laboratory.command_test(164)
    (by_noise,) = frequency_responses(noise_test, [name], BANDS[name], TransferFunctionOptions("local_polynomial"))
    by_noise = relative_error(by_noise)
    assert error.max() < most, error
    assert (error < by_noise / 2).all(), (error, by_noise)


@pytest.mark.parametrize(("name", "most"), [("w", 0.005), ("U", 0.012)])
def test_two_inputs_at_once_are_told_apart_by_their_lines(together, relative_error, name, most):
    found = periodic_response(together, name, BANDS[name])
    error = relative_error(found.frequency_response)
    assert error.max() < most, error
    lines = np.rint(found.frequency_response.omega * PERIOD * 0.002 / (2 * np.pi)).astype(int)
    assert (lines % 2 == (name == "w")).all()


@pytest.mark.parametrize("name", INPUTS)
def test_sigma_is_the_standard_deviation_of_the_estimate(rig, apart, name):
    found = periodic_response(apart[name], name, BANDS[name]).frequency_response
    expected = discretize(rig.model, 0.002).frequency_response(found.omega)[:, :, INPUTS.index(name)]
    # the modulus of a complex normal variable has the median sqrt(ln 2) = 0.83 of its standard deviation
    ratio = np.median(np.abs(found.response - expected) / found.sigma, axis=0)
    assert (ratio > 0.65).all(), ratio
    assert (ratio < 1.05).all(), ratio


def test_excited_lines_of_the_band_are_those_that_were_played(apart):
    found = periodic_response(apart["U"], "U", (5.0, 40.0)).frequency_response
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
    found = periodic_response(run, name, BANDS[name])
    assert (found.period_samples, found.periods) == (4096, 3)
    again = periodic_response(run, name, BANDS[name], period_samples=4096, dropped=2)
    assert again.periods == 2


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
    found = periodic_response(cut, "w", BANDS["w"])
    assert found.periods == 3
    assert relative_error(found.frequency_response).max() < 0.006


def test_a_bias_of_the_sensors_changes_nothing(apart):
    run = apart["w"]
    biased = replace(run, ground_acceleration=run.ground_acceleration + 50.0, outputs=run.outputs + 3.0)
    one, other = (periodic_response(each, "w", BANDS["w"]).frequency_response for each in (run, biased))
    np.testing.assert_allclose(one.response, other.response, rtol=1e-9)


def test_white_noise_and_rest_have_no_period():
    assert find_period(np.random.default_rng(0).standard_normal(20_000)) is None
    assert find_period(np.zeros(1000)) is None


def test_noise_level_is_that_of_the_sensor(plain_run):
    signal = played("U", periods=5, period=4096)
    noise = np.random.default_rng(3).normal(0.0, 50.0, len(signal))
    until = np.append(0.0, signal[:-1])
    found = periodic_response(plain_run(2 * signal + noise, command=until), "U", BANDS["U"])
    lines = len(found.frequency_response.omega)
    # 4 periods used; white noise spreads evenly over the transform's lines; the transient's polynomial of order 4
    # through the 12 lines in between adds a share of 0.315 to the variance of the line in their middle
    expected = 50.0 * np.sqrt(lines * 2 / (4 * 4096) * 1.315)
    assert found.noise[0] == pytest.approx(expected, rel=0.05)
    assert found.level[0] == pytest.approx(3600.0, rel=0.01)
    assert found.even_distortion[0] == pytest.approx(found.noise[0], rel=0.25)
    assert found.odd_distortion[0] == pytest.approx(found.noise[0], rel=0.25)


@pytest.mark.parametrize(("power", "kind"), [(2, "even_distortion"), (3, "odd_distortion")])
def test_distortion_shows_on_lines_of_its_kind_that_nothing_excites(plain_run, power, kind):
    signal = played("U", periods=4, period=4096)
    noise = np.random.default_rng(4).normal(0.0, 10.0, len(signal))
    bent = signal + 300.0 * (signal / 1800.0) ** power + noise
    found = periodic_response(plain_run(bent, command=np.append(0.0, signal[:-1])), "U", BANDS["U"])
    levels = {each: getattr(found, each)[0] for each in ("even_distortion", "odd_distortion")}
    assert levels.pop(kind) > 20 * found.noise[0]
    assert max(levels.values()) < 2 * found.noise[0]


def test_odd_distortion_is_what_other_phases_do_to_the_transfer_function(plain_run):
    responses: dict[float, list[complex]] = {}
    levels = []
    for seed in range(8):
        signal = played("U", periods=3, rest=0, period=4096, seed=seed)
        noise = np.random.default_rng(seed).normal(0.0, 5.0, len(signal))
        bent = signal + 300.0 * (signal / 1800.0) ** 3 + noise
        found = periodic_response(plain_run(bent, command=np.append(0.0, signal[:-1])), "U", BANDS["U"])
        one = found.frequency_response.select(["x1"])
        for omega, value in zip(np.round(one.omega, 6), one.response[:, 0], strict=True):
            responses.setdefault(omega, []).append(value)
        levels.append(float(np.sqrt(np.mean(one.distortion.odd**2))))
    scatter = np.sqrt(np.mean([np.var(values, ddof=1) for values in responses.values() if len(values) > 3]))
    assert np.mean(levels) == pytest.approx(scatter, rel=0.25)


def test_shares_of_noise_even_and_odd_distortion_are_told_apart(plain_run, tmp_path):
    signal = played("U", periods=4, period=4096)
    noise = np.random.default_rng(4).normal(0.0, 10.0, len(signal))
    run = plain_run(signal + 300.0 * (signal / 1800.0) ** 3 + noise, command=np.append(0.0, signal[:-1]))
    response = periodic_response(run, "U", BANDS["U"]).frequency_response
    data = measured_tests.TestData("U", (run,), (response.select(["x1", "a1"]),), True, (), ("U",))
    shares = distortion_shares(data)["a1"]
    assert 0.03 < shares["odd"] < 0.2
    assert shares["even"] < shares["noise"] < 0.01
    text = write_distortion([data], tmp_path / "distortion.json")
    assert text.startswith("distortion of the response to U, most in x1: noise 0.")
    content = json.loads((tmp_path / "distortion.json").read_text())["U"]
    assert content["shares"]["a1"] == shares
    assert len(content["levels"][0]["odd"]["x1"]) == len(response.omega)
    all_lines = plain_run(np.tile(multisine(4096, 500.0, BANDS["U"], 1800.0, 1, "all"), 4))
    one = replace(all_lines, command=all_lines.outputs[:, :1])
    lone = periodic_response(one, "U", BANDS["U"]).frequency_response
    without = replace(data, runs=(one,), responses=(lone,))
    assert "odd not measured, even not measured" in write_distortion([without], tmp_path / "all.json")
    assert write_distortion([replace(data, responses=(replace(response, distortion=None),))], tmp_path / "no") == ""
    assert not (tmp_path / "no").exists()


def test_the_same_phases_in_two_tests_are_found_and_others_are_not():
    rng = np.random.default_rng(0)
    one, later = played("U", rest=1000), played("U", periods=4, rest=3000)
    assert same_realization(one, 2 * later + rng.normal(0, 100, len(later)))
    assert not same_realization(one, played("U", seed=2))


def test_tests_that_repeat_a_realization_are_named(laboratory_of, rig):
    table = laboratory_of(rig, 3).table_test(60)
    first = laboratory_of(rig, 1).multisine_test(False, True, 3)
    again = replace(laboratory_of(rig, 1).multisine_test(False, True, 4), source="bags/again")
    other = replace(laboratory_of(rig, 2).multisine_test(False, True, 3), source="bags/other")
    expected = "bags/multisine and bags/again: the same multisine of U; expected different seeds"
    assert any(warning.startswith(expected) for warning in identify(table, [first, again]).warnings)
    assert not identify(table, [first, other]).warnings


def test_an_actuator_at_its_limit_shows_as_distortion_well_above_the_noise(rig):
    """The capacity cuts a command that the rig with its own capacity follows."""
    command = played("U", periods=4, rest=0, period=4096)
    braces = tuple(replace(each, actuator=replace(each.actuator, capacity=2200.0)) for each in rig.braces)
    levels = {}
    for which, tested in (("linear", rig), ("limited", replace(rig, braces=braces))):
        motion = RigMotion(tested)
        outputs = np.array([motion.outputs(0.0, command[k : k + 1]) for k in range(len(command))])
        sensors = Measurement(rig.sensors.channels(3, 1, 1), 0, 0.002)
        readings = sensors.record(np.column_stack([outputs, 0 * command]))
        until = np.append(0.0, command[:-1])[:, None]
        sequence = np.arange(len(command), dtype=np.uint64)
        run = Run(f"bags/{which}", 0.002, sequence, 3, 1, readings[:, :-1], readings[:, -1], until)
        found = periodic_response(run, "U", BANDS["U"])
        levels[which] = found.odd_distortion[-1] / found.noise[-1]
    assert levels["linear"] < 1.5, levels
    assert levels["limited"] > 10, levels


def test_what_cannot_be_estimated_is_refused_with_the_reason(laboratory, apart, table_test):
    with pytest.raises(AbraceError, match="bags/table: w does not repeat itself after any time, expected a periodic"):
        periodic_response(table_test, "w", BANDS["w"])
    with pytest.raises(AbraceError, match="bags/table: U does not repeat itself after 16384 samples"):
        periodic_response(apart["w"], "U", BANDS["w"])
    with pytest.raises(AbraceError, match="expected at least 6 periods, of which 4 dropped"):
        periodic_response(apart["w"], "w", BANDS["w"], dropped=4)
    with pytest.raises(AbraceError, match="0 periods dropped, expected at least 1"):
        periodic_response(apart["w"], "w", BANDS["w"], dropped=0)
    with pytest.raises(AbraceError, match="w excites no line between 12 and 20 Hz"):
        periodic_response(apart["w"], "w", (12.0, 20.0))
    with pytest.raises(AbraceError, match=r"no line of the period between 1\.001 and 1\.002 Hz"):
        periodic_response(apart["w"], "w", (1.001, 1.002))
    both = laboratory.open_loop("bags/both", played("w", period=4096), played("U", period=4096))
    with pytest.raises(AbraceError, match=r"w and U both excite the line at .* Hz, expected inputs on different lines"):
        periodic_response(both, "w", BANDS["w"])


@pytest.mark.parametrize("name", INPUTS)
def test_the_free_decay_of_known_modes_is_removed(rig, laboratory, relative_error, name):
    """Periods of 8 s and rest before: half of the first mode's decay is left after the dropped period."""
    signal = played(name, periods=3, rest=700, period=4096)
    given = (signal, 0 * signal) if name == "w" else (0 * signal, signal)
    run = laboratory.open_loop("bags/short", *given)
    poles = rig.model.poles()
    one, other = (
        periodic_response(run, name, BANDS[name], poles=known).frequency_response
        for known in (None, poles[poles.imag > 0])
    )
    assert relative_error(other).max() < relative_error(one).max() / 3, (relative_error(one), relative_error(other))
    assert (other.sigma.max(axis=0) < one.sigma.max(axis=0) / 2).all()


def test_poles_that_no_response_has_change_next_to_nothing(apart):
    one, other = (
        periodic_response(apart["w"], "w", BANDS["w"], poles=known).frequency_response
        for known in (None, np.array([-0.2 + 14.0j, -1.0 + 50.0j]))
    )
    assert np.median(np.abs(other.response - one.response) / one.sigma) < 0.5


def test_six_multisines_find_the_slowest_mode(rig, laboratory_of):
    """One period is dropped, in which the slowest mode decays to 1/28: what is left of it must not count."""
    table, command = (
        [laboratory_of(rig, 2 * seed + i).multisine_test(not i, bool(i), 3) for seed in range(6)] for i in range(2)
    )
    poles = identify(table, command).poles
    slowest = min((pole for pole in rig.model.poles() if pole.imag > 0), key=abs)
    frequency, damping = abs(slowest), -slowest.real / abs(slowest)
    for pair in (poles.table_pairs[0], poles.command_pairs[0]):
        assert pair.frequency == pytest.approx(frequency, rel=7e-6)
        assert pair.damping == pytest.approx(damping, rel=3e-4)
        assert pair.damping_deviation < 3.5e-4 * damping
