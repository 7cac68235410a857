# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.discretization import discretize
from abrace_sysid.recorded.test import Test
from abrace_sysid.spectra.estimation import TransferFunctionOptions, frequency_responses
from abrace_sysid.spectra.welch import welch

BAND, WIDE = (0.3, 10.0), (0.3, 30.0)


def local_polynomial(run, name, band, degree=4, half_width=6):
    return frequency_responses(
        run,
        [name],
        band,
        TransferFunctionOptions(transfer_function="local_polynomial", degree=degree, half_width=half_width),
    )[0]


def test_local_polynomials_leave_little_of_the_leakage_that_welch_has(table_test, rig):
    true = discretize(rig.model, 0.002)

    def error(estimate):
        expected = true.frequency_response(estimate.omega)[:, :, 0]
        return np.linalg.norm(estimate.response - expected, axis=0) / np.linalg.norm(expected, axis=0)

    local, averaged = (
        error(local_polynomial(table_test, "w", BAND)),
        error(welch([Test.of(table_test)], "w", BAND, 32768)),
    )
    assert local.max() < 0.05, local
    assert averaged.max() < 0.3, averaged
    assert (local < averaged / 3).all(), (local, averaged)


def test_a_held_command_is_taken_from_the_sample_on_which_it_acts(plain_run):
    command_until = np.random.default_rng(1).standard_normal(40_000)
    run = plain_run(2 * np.append(command_until[1:], command_until[-1]), command=command_until)
    assert np.array_equal(Test.of(run).channel("U")[:-1], command_until[1:])
    estimate = local_polynomial(run, "U", (1.0, 30.0))
    assert np.abs(estimate.response - 2).max() < 1e-9
    late = local_polynomial(plain_run(command_until, command=command_until), "U", (1.0, 30.0))
    one_sample = np.exp(-1j * late.omega * 0.002)[:, None]
    assert np.abs(late.response - one_sample).max() < 0.02, "the output one sample later was expected"


@pytest.mark.parametrize("estimate", [local_polynomial, lambda run, *a: welch([Test.of(run)], *a, segment=2048)])
def test_sigma_is_the_standard_deviation_of_the_estimate(plain_run, estimate):
    random = np.random.default_rng(2)
    excitation = random.standard_normal(100_000)
    run = plain_run(3 * excitation + 0.5 * random.standard_normal(100_000), ground=excitation)
    found = estimate(run, "w", (5.0, 100.0))
    # the median is robust against the long tail of one-degree-of-freedom estimates
    ratio = np.median(np.abs(found.response - 3)[:, 0]) / np.median(found.sigma[:, 0])
    assert 0.7 < ratio < 1.2, ratio


def test_lines_are_those_of_the_band_and_of_the_whole_record(plain_run):
    noise = np.random.default_rng(3).standard_normal(50_000)
    found = local_polynomial(plain_run(noise, ground=noise), "w", (2.0, 4.0))
    assert np.allclose(found.omega, 2 * np.pi * np.arange(200, 401) / 100)
    assert found.response.shape == found.sigma.shape == (201, 4)
    assert found.outputs == ("x1", "xf", "a1", "f")


def test_what_cannot_be_estimated_is_refused_with_the_reason(plain_run):
    noise = np.random.default_rng(5).standard_normal(5_000)
    run = plain_run(noise, ground=noise)
    with pytest.raises(AbraceError, match="half_width 5, expected degree >= 0 and half_width >= 6"):
        local_polynomial(run, "w", BAND, degree=5, half_width=5)
    with pytest.raises(AbraceError, match="local polynomial method: 11 lines in the band, expected at least 13"):
        local_polynomial(run, "w", (1.0, 2.0))
    with pytest.raises(AbraceError, match=r"no frequency line between 0\.31 and 0\.32 Hz"):
        local_polynomial(run, "w", (0.31, 0.32))
    with pytest.raises(AbraceError, match="segments of 4096 in 5000 samples, expected 2 to 2500"):
        welch([Test.of(run)], "w", BAND, segment=4096)
    with pytest.raises(AbraceError, match="no channel 'q'"):
        local_polynomial(run, "q", BAND)


def errors(estimate, rig):
    """Relative rms error of each channel, and rms of the errors over their standard deviations."""
    true = discretize(rig.model, 0.002)
    expected = true.frequency_response(estimate.omega)[:, :, 0 if estimate.input == "w" else 1]
    error = np.abs(estimate.response - expected)
    relative = np.linalg.norm(error, axis=0) / np.linalg.norm(expected, axis=0)
    return relative, np.sqrt(np.mean((error / estimate.sigma) ** 2, axis=0))


def test_rational_functions_follow_a_mode_that_is_as_narrow_as_the_lines(laboratory_of, rig):
    laboratory = laboratory_of(rig, 5)
    for run, name, band in ((laboratory.table_test(60), "w", BAND), (laboratory.command_test(60), "U", WIDE)):
        relative, ratio = errors(frequency_responses(run, [name], band)[0], rig)
        assert relative.max() < 0.01, relative
        assert ratio.max() < 1.3, ratio
        polynomial, _ = errors(local_polynomial(run, name, band), rig)
        assert polynomial.max() > 5 * relative.max(), (polynomial, relative)


def test_two_inputs_at_once_each_get_their_response(laboratory_of, rig):
    laboratory = laboratory_of(rig, 6)
    table, command = laboratory.table_test(120), laboratory.command_test(120)
    run = laboratory.open_loop("bags/both", table.ground_acceleration, command.command_from_here[:, 0])
    both = frequency_responses(run, ("w", "U"), BAND)
    assert [each.input for each in both] == ["w", "U"]
    for each in both:
        relative, ratio = errors(each, rig)
        assert relative.max() < 0.01, (each.input, relative)
        assert ratio.max() < 1.3, (each.input, ratio)
    alone, _ = errors(frequency_responses(run, ("w",), BAND)[0], rig)
    assert alone.max() > 0.05, "one input alone, the other taken for noise, was expected to be far worse"


def test_repeated_tests_and_pieces_of_longer_ones_average(laboratory_of, rig):
    runs = [laboratory_of(rig, seed).table_test(seconds) for seed, seconds in ((7, 60), (8, 60), (9, 130))]
    one, all_ = (frequency_responses(each, ("w",), BAND)[0] for each in (runs[0], runs))
    assert all_.method.endswith("4 records")
    assert errors(one, rig)[0].max() > 1.5 * errors(all_, rig)[0].max()
    assert errors(all_, rig)[1].max() < 1.3
    assert np.median(one.sigma / all_.sigma) == pytest.approx(2, rel=0.2)


def test_the_settings_follow_from_the_record(laboratory_of, rig):
    for seconds, half_width in ((60, 14), (100, 20)):
        (found,) = frequency_responses(laboratory_of(rig, 12).table_test(seconds), ("w",), BAND)
        assert found.method == f"local rational method, degree 2, half-width {half_width}"


def test_given_options_override_the_automatic_ones(table_test):
    run = table_test
    for options, method in (
        ({"transfer_function": "welch", "segment": 8192}, "Welch, H1, hann, overlap 0.5, 8192 points"),
        (
            {"transfer_function": "local_polynomial", "degree": 4, "half_width": 6},
            "local polynomial method, degree 4, half-width 6",
        ),
        ({"transfer_function": "local_polynomial"}, "local polynomial method, degree 4, half-width 6"),
        ({"degree": 3, "half_width": 9}, "local rational method, degree 3, half-width 9"),
    ):
        assert frequency_responses(run, ("w",), BAND, TransferFunctionOptions.of(options))[0].method == method
    with pytest.raises(
        AbraceError, match="transfer_function: 'guess', expected 'local_rational', 'local_polynomial' or 'welch'"
    ):
        frequency_responses(run, ("w",), BAND, TransferFunctionOptions.of({"transfer_function": "guess"}))


def test_tests_of_another_rig_and_inputs_that_are_not_two_are_refused(table_test, plain_run):
    noise = np.random.default_rng(11).standard_normal(20_000)
    run = plain_run(noise, noise, np.append(0, noise[:-1]))
    with pytest.raises(AbraceError, match="bags/plain: floors 1, expected 3, as in bags/table"):
        frequency_responses((table_test, run), ("w",), BAND)
    first = Test.of(table_test)
    with pytest.raises(AbraceError, match=r"other: inputs v, U, expected w, U, as in "):
        frequency_responses((first, replace(first, source="other", inputs=("v", "U"))), ("w",), BAND)
    with pytest.raises(AbraceError, match="expected at least one"):
        frequency_responses((), ("w",), BAND)
    with pytest.raises(AbraceError, match="an input is zero, or repeats another"):
        frequency_responses(run, ("w", "U"), BAND)
