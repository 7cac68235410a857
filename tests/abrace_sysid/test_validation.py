# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from abrace_core.errors import AbraceError
from abrace_sysid.validation import compare


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
    with pytest.raises(AbraceError, match="the model has no signal a3, f, expected a model of this rig"):
        compare(run, rig.model.select(["x1", "x2", "x3", "xf", "a1", "a2"]), None, rig.capacity)
    with pytest.raises(AbraceError, match="the model has no signal U"):
        compare(run, rig.model.select(inputs=["w"]), None, rig.capacity)
    with pytest.raises(AbraceError, match="the controller measures a4"):
        compare(run, rig.model, replace(controller, inputs=("a1", "a2", "a4")), rig.capacity)
    with pytest.raises(AbraceError, match=r"every 0\.004 s"):
        compare(run, rig.model, replace(controller, sample_period=0.004), rig.capacity)
    with pytest.raises(AbraceError, match="2 capacities, expected one for each of 1"):
        compare(run, rig.model, None, np.array([1.0, 1.0]))
    with pytest.raises(AbraceError, match="without a gap"):
        compare(replace(run, sequence=2 * run.sequence), rig.model, None, rig.capacity)
