# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from abrace_core import AbraceError
from abrace_core.model.linear_model import LinearModel
from abrace_core.model.verdict import Verdict
from abrace_sysid.figures.validation import time_histories
from abrace_sysid.recorded.test import Test
from abrace_sysid.validation import ValidateOptions, compare, predicted, read_test
from abrace_sysid.validity.finding import prediction_finding


def test_the_rig_s_own_model_differs_from_the_record_by_sensor_noise_alone(rig, laboratory, controller):
    comparison = compare(laboratory.earthquake(controller), rig.model, controller, rig.capacity)
    noise = [channel.noise for channel in rig.sensors.channels(3, 1, 1)][:8]
    difference = np.std(comparison.simulated - comparison.measured, axis=0)
    assert (difference[:8] < 1.5 * np.array(noise) + 1e-3 * np.std(comparison.measured[:, :8], axis=0)).all()
    assert comparison.names == ("x1", "x2", "x3", "xf", "a1", "a2", "a3", "f", "U")
    assert comparison.time[1] == 0.002


def test_without_a_controller_the_recorded_command_drives_the_model(rig, command_test):
    comparison = compare(command_test, rig.model, None, rig.capacity)
    assert comparison.correlation()["f"] > 0.9999
    assert comparison.normalised_rms_error()["f"] < 0.015
    assert np.array_equal(comparison.simulated[:, -1], comparison.measured[:, -1])


def test_numbers_follow_their_definitions(rig, laboratory, controller):
    comparison = compare(laboratory.earthquake(controller), rig.model, controller, rig.capacity)
    halved = replace(comparison, simulated=-comparison.measured / 2)
    assert halved.correlation()["x3"] == pytest.approx(-1)
    assert halved.normalised_rms_error()["U"] == pytest.approx(1.5)
    measured, simulated = halved.measured_peak_rms()["a1"], halved.simulated_peak_rms()["a1"]
    assert simulated.peak == pytest.approx(measured.peak / 2)
    assert simulated.rms == pytest.approx(measured.rms / 2)


def test_sensor_noise_is_read_off_the_record_s_top_frequencies(rig, laboratory, controller):
    noise = [channel.noise for channel in rig.sensors.channels(3, 1, 1)][:8]
    comparison = compare(laboratory.earthquake(controller), rig.model, controller, rig.capacity)
    assert np.allclose(comparison.noise()[:8], noise, rtol=0.1)
    assert comparison.noise()[8] == 0.0


def test_a_hum_at_the_top_of_the_spectrum_does_not_pass_for_noise(rig, laboratory, controller):
    comparison = compare(laboratory.earthquake(controller), rig.model, controller, rig.capacity)
    hum = 0.5 * np.sin(2 * np.pi * 237.0 * comparison.time)[:, None]
    assert np.allclose(replace(comparison, measured=comparison.measured + hum).noise()[4:7], 3.4e-3, rtol=0.1)


def test_the_exact_model_has_hardly_any_error_but_noise_and_a_wrong_one_keeps_its_error(rig, laboratory):
    comparison = compare(laboratory.earthquake(), rig.model, None, rig.capacity)
    plain, without_noise = comparison.normalised_rms_error(), comparison.noise_free_error()
    assert all(without_noise[name] < plain[name] / 2 for name in without_noise), (plain, without_noise)
    wrong = replace(comparison, simulated=1.1 * comparison.simulated)
    assert np.allclose(list(wrong.noise_free_error().values()), 0.1, atol=2e-3)


def test_noise_is_never_taken_beyond_zero(rig, laboratory):
    comparison = compare(laboratory.earthquake(), rig.model, None, rig.capacity)
    perfect = replace(comparison, simulated=comparison.measured)
    assert set(perfect.noise_free_error().values()) == {0.0}


def test_peak_and_rms_error_is_the_mean_over_channels(rig, laboratory, controller):
    comparison = compare(laboratory.earthquake(controller), rig.model, controller, rig.capacity)
    assert replace(comparison, simulated=0.9 * comparison.measured).peak_rms_error() == pytest.approx(0.1)
    one_off = comparison.measured * np.where(np.array(comparison.names) == "f", 1.9, 1.0)
    assert replace(comparison, simulated=one_off).peak_rms_error() == pytest.approx(0.1)


def test_a_command_that_stays_zero_has_no_correlation(rig, laboratory):
    comparison = compare(laboratory.earthquake(), rig.model, None, rig.capacity)
    assert "U" not in comparison.correlation()
    assert set(comparison.normalised_rms_error()) == set(comparison.names) - {"U"}
    assert comparison.measured_peak_rms()["U"] == (0.0, 0.0)


def test_commands_are_cut_at_the_capacity(rig, laboratory, controller):
    comparison = compare(laboratory.earthquake(controller), rig.model, controller, np.array([500.0]))
    assert comparison.simulated_peak_rms()["U"].peak == 500.0


def test_model_controller_and_run_of_different_rigs_are_refused(rig, laboratory, controller):
    run = laboratory.earthquake(seconds=10)
    with pytest.raises(AbraceError, match="the model has no signal x1, x2, x3, xf, a1, a2, a3, f, expected a model of"):
        compare(run, replace(rig.model.select(["x1"]), outputs=("y",)), None, rig.capacity)
    with pytest.raises(AbraceError, match="the controller measures a1, a2, a3, which the model does not have"):
        compare(run, rig.model.select(["x1", "f"]), controller, rig.capacity)
    with pytest.raises(AbraceError, match="the model has no signal U"):
        compare(run, rig.model.select(inputs=["w"]), None, rig.capacity)
    with pytest.raises(AbraceError, match="the controller measures a4"):
        compare(run, rig.model, replace(controller, inputs=("a1", "a2", "a4")), rig.capacity)
    with pytest.raises(AbraceError, match=r"sample period 0\.003 s, expected 0\.002 s, the rig's"):
        compare(run, rig.model, replace(controller, sample_period=0.003), rig.capacity)
    with pytest.raises(AbraceError, match="2 capacities, expected one for each of 1"):
        compare(run, rig.model, None, np.array([1.0, 1.0]))
    with pytest.raises(AbraceError, match="sample 2 after 0, expected consecutive samples"):
        compare(replace(run, sequence=2 * run.sequence), rig.model)
    with pytest.raises(AbraceError, match="2 tests, expected one"):
        compare([run, run], rig.model)


def test_a_test_is_compared_as_its_run_is_and_with_fewer_channels_those_alone(rig, laboratory, controller):
    run = laboratory.earthquake(controller, 10)
    whole, few = compare(run, rig.model), compare(Test.of(run).select(["x3", "a1"]), rig.model)
    assert np.array_equal(whole.measured, np.hstack([run.outputs, run.command]))
    assert few.names == ("x3", "a1", "U")
    chosen = [whole.names.index(name) for name in few.names]
    assert np.array_equal(few.measured, whole.measured[:, chosen])
    assert np.array_equal(few.simulated, whole.simulated[:, chosen])


def spoiled(comparison, name, value):
    measured = comparison.measured.copy()
    measured[:, comparison.names.index(name)] = value
    return replace(comparison, measured=measured)


@pytest.mark.parametrize("name", ["xf", "a3"])
def test_a_disconnected_sensor_is_never_trusted(rig, laboratory, name):
    comparison = compare(laboratory.earthquake(seconds=20), rig.model, None, rig.capacity)
    assert predicted(comparison).verdict == Verdict.TRUST
    found = predicted(spoiled(comparison, name, 0.25))
    assert (found.verdict, found.where) == (Verdict.DONT, name)
    assert found.meaning == f"{name} did not move, against the simulation"
    assert f"Check sensor, cable and channel of {name}" in found.advice


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_channel_that_is_not_finite_is_named_and_at_best_with_care(rig, laboratory, value):
    comparison = compare(laboratory.earthquake(seconds=20), rig.model, None, rig.capacity)
    one = np.where(np.arange(len(comparison.time)) == 7, value, 0.0)
    broken = spoiled(comparison, "xf", comparison.measured[:, 3] + one)
    found = predicted(broken)
    assert (found.verdict, found.where) == (Verdict.CARE, "xf")
    assert found.meaning.endswith("not judged: xf has values that are not finite")
    assert "xf" not in broken.normalised_rms_error()
    assert broken.peak_rms_error() == pytest.approx(comparison.peak_rms_error(), abs=0.01)
    worse = predicted(replace(broken, simulated=2.0 * broken.simulated))
    assert worse.verdict == Verdict.DONT, "a channel that cannot be judged excuses no other"


def test_nothing_that_moves_is_nothing_to_trust(rig, laboratory):
    comparison = compare(laboratory.earthquake(seconds=20), rig.model, None, rig.capacity)
    still = replace(comparison, measured=0 * comparison.measured)
    assert predicted(still).verdict == Verdict.DONT
    assert still.peak_rms_error() is None
    both = predicted(replace(still, simulated=still.measured))
    assert both.verdict == Verdict.CARE
    assert both.content["value"] is None
    assert prediction_finding({}, {}).verdict == Verdict.CARE
    assert prediction_finding({"x1": np.nan, "x2": 0.9}, {"x1": "is unknown"}).verdict == Verdict.DONT


def test_a_channel_that_the_model_does_not_have_is_not_compared_and_named(rig, laboratory):
    comparison = compare(laboratory.earthquake(seconds=20), rig.model.select(["x1", "xf", "a2"]), None, rig.capacity)
    assert (comparison.names, comparison.left_out) == (("x1", "xf", "a2", "U"), ("x2", "x3", "a1", "a3", "f"))
    assert comparison.correlation()["a2"] > 0.999
    found = predicted(comparison)
    assert (found.verdict, found.where) == (Verdict.CARE, "x2, x3, a1, a3, f")


def test_a_test_in_g_and_a_model_in_mm_and_kn_are_compared_in_si_units(rig, command_test):
    expected = compare(command_test, rig.model, None, rig.capacity)
    test = Test.of(command_test) if not isinstance(command_test, Test) else command_test
    a1 = test.names.index("a1")
    factors = np.where(np.arange(len(test.names)) == a1, 1 / 9.80665, 1.0)
    in_g = replace(test, outputs=test.outputs * factors, units={"a1": "g"})
    x1, c, d = rig.model.outputs.index("x1"), rig.model.c.copy(), rig.model.d.copy()
    c[x1], d[x1] = 1000 * c[x1], 1000 * d[x1]
    b, command = rig.model.b.copy(), rig.model.inputs.index("U")
    b[:, command], d[:, command] = 1000 * b[:, command], 1000 * d[:, command]
    scaled = replace(rig.model, b=b, c=c, d=d, units={"x1": "mm", "U": "kN"})
    found = compare(in_g, scaled, None, rig.capacity)
    np.testing.assert_allclose(found.measured, expected.measured, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(found.simulated, expected.simulated, rtol=1e-6, atol=1e-9)
    with pytest.raises(AbraceError, match="channel a1 in 'V': expected m/s"):
        compare(replace(test, units={"a1": "V"}), rig.model, None, rig.capacity)


PERIOD = 0.005
G = 9.80665
SHAFT = np.array([[0.0, 1.0], [-900.0, -1.2]]), np.array([[0.0], [0.5]])
"""A mass of 2 kg at 4.8 Hz, pushed by a force [N]: displacement [m] and speed."""


def of_data(laser: float = 1e3, **provenance: object) -> LinearModel:
    """That mass as identified: from `shaker` [N] to its acceleration `acc 1` [g] and to `laser` [mm]."""
    a, b = SHAFT
    units = {"shaker": "N", "acc 1": "g", "laser": "mm"}
    facts = {"data": "first.csv", "hold": "zero", "options": {"time": "time", "sample_rate": 0.0}, **provenance}
    c, d = np.array([a[1] / G, [laser, 0.0]]), np.array([[0.5 / G], [0.0]])
    return LinearModel(a, b, c, d, ("shaker",), ("acc 1", "laser"), units=units, provenance=facts)


def pushed(force, start=(0.0, 0.0)):
    """(samples,) acceleration [m/s^2] and displacement [m] under a held force [N], stepped by its own transition."""
    a, b = SHAFT
    whole = expm(np.block([[a, b], [np.zeros((1, 3))]]) * PERIOD)
    state, found = np.array(start), []
    for each in force:
        found.append((a[1] @ state + 0.5 * each, state[0]))
        state = whole[:2, :2] @ state + whole[:2, 2] * each
    return np.array(found).T


@pytest.fixture
def second(tmp_path):
    """Another record, that begins in motion; the laser has an offset of 40 mm."""
    force = np.random.default_rng(4).standard_normal(4000)
    acceleration, displacement = pushed(force, (0.002, 0.05))
    table = np.column_stack([np.arange(4000) * PERIOD, force, acceleration / G, 1e3 * displacement + 40.0])
    names = "time [s],shaker [N],acc 1 [g],laser [mm]"
    np.savetxt(tmp_path / "second.csv", table, delimiter=",", header=names, comments="")
    return tmp_path / "second.csv"


def compared(given, model, **options):
    return compare(read_test(given, model, ValidateOptions(**options)), model)


def test_a_model_of_data_predicts_a_file_of_its_columns(second):
    found = compared(str(second), of_data())
    assert (found.names, found.commands, found.left_out) == (("acc 1", "laser"), (), ())
    assert found.units == {"shaker": "N", "acc 1": "m/s^2", "laser": "m"}
    force = np.random.default_rng(4).standard_normal(4000)
    for j, expected in enumerate(pushed(force, (0.002, 0.05))):
        for one in (found.measured, found.simulated):
            np.testing.assert_allclose(one[:, j], expected - expected.mean(), atol=2e-3 * expected.std())
    assert predicted(found).verdict == Verdict.TRUST
    labels = [axis.get_ylabel() for axis in time_histories(found, ["laser", "acc 1"]).figure().axes]
    assert labels == ["laser [m]", "error [m]", "acc 1 [m/s^2]", "error [m/s^2]"]


def test_a_gain_that_is_a_tenth_too_large_is_found(second):
    found = compared(str(second), of_data(laser=1.1e3))
    errors = found.normalised_rms_error()
    assert errors["laser"] == pytest.approx(0.1, abs=0.01), "the initial state that fits best is a little off"
    assert errors["acc 1"] < 0.02
    assert (predicted(found).verdict, predicted(found).where) == (Verdict.CARE, "laser")


def test_a_column_has_the_unit_that_it_states_or_that_of_the_model(second):
    table = np.loadtxt(second, delimiter=",", skiprows=1)
    columns = {"time": table[:, 0], "shaker": table[:, 1], "acc 1": table[:, 2], "laser": table[:, 3]}
    assert predicted(compared(columns, of_data())).verdict == Verdict.TRUST
    columns["laser [m]"] = columns.pop("laser") / 1e3
    assert predicted(compared(columns, of_data())).verdict == Verdict.TRUST
    columns["laser [V]"] = columns.pop("laser [m]")
    with pytest.raises(AbraceError, match="data: laser in V, expected m, as in the model"):
        compared(columns, of_data())
    assert compared(columns, of_data(), outputs=["acc 1"]).names == ("acc 1",)


def test_delays_of_the_identification_are_taken_off(second):
    table = np.loadtxt(second, delimiter=",", skiprows=1)
    late = {"time": table[4:, 0], "shaker": table[4:, 1], "acc 1": table[4:, 2], "laser": table[:-4, 3]}
    moved = of_data(output_delays={"laser": 4 * PERIOD})
    assert compared(late, moved).normalised_rms_error()["laser"] < 0.02
    assert compared(late, of_data()).normalised_rms_error()["laser"] > 0.1


def test_a_dead_sensor_of_data_is_never_trusted(second):
    table = np.loadtxt(second, delimiter=",", skiprows=1)
    columns = {"time": table[:, 0], "shaker": table[:, 1], "acc 1": table[:, 2], "laser": np.full(4000, 3.0)}
    found = predicted(compared(columns, of_data()))
    assert (found.verdict, found.meaning) == (Verdict.DONT, "laser did not move, against the simulation")


def test_a_loop_closed_under_names_of_data_is_compared_with_its_record():
    law = LinearModel([[0.9]], [[1.0]], [[-2.0]], [[-1.0]], ("acc 1",), ("shaker",), PERIOD)
    model = of_data()
    share = np.array([[1.0, 0.5]])  # of a force of the fan acts on the mass
    model = replace(model, b=model.b @ share, d=model.d @ share, inputs=("shaker", "fan"), input_delay=(0.0, 0.0))
    fan = np.random.default_rng(5).standard_normal(1500)
    a, b = SHAFT
    whole = expm(np.block([[a, b], [np.zeros((1, 3))]]) * PERIOD)
    state, memory, force, until, rows = np.zeros(2), 0.0, 0.0, 0.0, []
    for each in fan:
        total = force + 0.5 * each
        acceleration = a[1] @ state + 0.5 * total
        rows.append((acceleration / G, 1e3 * state[0], until))
        until, force = force, np.clip(-2.0 * memory - acceleration, -0.3, 0.3)
        memory = 0.9 * memory + acceleration
        state = whole[:2, :2] @ state + whole[:2, 2] * total
    rows = np.array(rows)
    acting = np.append(rows[1:, 2], force)  # from each sample on
    record = {"shaker": acting, "fan": fan, "acc 1": rows[:, 0], "laser": rows[:, 1]}
    (test,) = read_test(record, model, ValidateOptions(sample_rate=1 / PERIOD))
    found = compare(test, model, law, np.array([0.3]))
    assert found.names == ("acc 1", "laser", "shaker")
    assert np.abs(found.simulated[:, 2]).max() == 0.3, "the limit has to act in this test"
    np.testing.assert_allclose(found.simulated, found.measured, atol=1e-6 * np.abs(found.measured).max(axis=0).max())
    share = np.array([[1.0, 0.0, 1.0]])
    names, none = ("shaker", "fan", "wind"), (0.0,) * 3
    three = replace(of_data(), b=of_data().b @ share, d=of_data().d @ share, inputs=names, input_delay=none)
    with pytest.raises(
        AbraceError, match="inputs fan, wind that the controller does not command, expected one at most"
    ):
        compare(test, three, law, np.array([0.3]))
    with pytest.raises(AbraceError, match="no channel 'wind', it has shaker, fan, acc 1, laser"):
        compare(test, three)
    with pytest.raises(AbraceError, match="the model has no signal fan, expected a model of this structure"):
        compare(test, of_data())
