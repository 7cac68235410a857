# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.verdict import Verdict
from abrace_sysid.recorded.test import Test
from abrace_sysid.validation import compare, predicted
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
    with pytest.raises(AbraceError, match=r"every 0\.004 s"):
        compare(run, rig.model, replace(controller, sample_period=0.004), rig.capacity)
    with pytest.raises(AbraceError, match="2 capacities, expected one for each of 1"):
        compare(run, rig.model, None, np.array([1.0, 1.0]))
    with pytest.raises(AbraceError, match="sample 2 after 0, expected consecutive samples"):
        compare(replace(run, sequence=2 * run.sequence), rig.model)
    with pytest.raises(AbraceError, match="2 tests, expected one"):
        compare([run, run], rig.model)
    with pytest.raises(AbraceError, match="hold 'band', expected a test of a rig"):
        compare(replace(Test.of(run), hold="band"), rig.model)


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
