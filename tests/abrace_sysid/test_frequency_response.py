import numpy as np
import pytest

from abrace_core.errors import AbraceError
from abrace_core.simulation import discretize
from abrace_sysid.frequency_response import held_input, local_polynomial, welch

BAND = (0.3, 10.0)


def test_local_polynomials_leave_little_of_the_leakage_that_welch_has(table_test, rig):
    true = discretize(rig.model, 0.002, {"w": "first"})

    def error(estimate):
        expected = true.frequency_response(estimate.omega)[:, :, 0]
        return np.linalg.norm(estimate.response - expected, axis=0) / np.linalg.norm(expected, axis=0)

    local, averaged = error(local_polynomial(table_test, "w", BAND)), error(welch(table_test, "w", BAND))
    assert local.max() < 0.05, local
    assert averaged.max() < 0.3, averaged
    assert (local < averaged / 3).all(), (local, averaged)


def test_a_held_command_is_taken_from_the_sample_on_which_it_acts(plain_run):
    command_until = np.random.default_rng(1).standard_normal(40_000)
    run = plain_run(2 * np.append(command_until[1:], command_until[-1]), command=command_until)
    assert np.array_equal(held_input(run, "U")[:-1], command_until[1:])
    estimate = local_polynomial(run, "U", (1.0, 30.0))
    assert np.abs(estimate.response - 2).max() < 1e-9
    late = local_polynomial(plain_run(command_until, command=command_until), "U", (1.0, 30.0))
    one_sample = np.exp(-1j * late.omega * 0.002)[:, None]
    assert np.abs(late.response - one_sample).max() < 0.02, "the output one sample later was expected"


@pytest.mark.parametrize("estimate", [local_polynomial, lambda *a: welch(*a, segment=2048)])
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


def test_selection_and_division_keep_lines_and_names(plain_run):
    noise = np.random.default_rng(4).standard_normal(50_000)
    found = local_polynomial(plain_run(noise, ground=noise), "w", (2.0, 4.0))
    factor = np.full(201, 2j)
    halved = found.divided_by(factor).select(["f", "x1"])
    assert halved.outputs == ("f", "x1")
    assert np.allclose(halved.response, -0.5j)
    assert np.allclose(halved.sigma, found.sigma[:, :2] / 2)


def test_what_cannot_be_estimated_is_refused_with_the_reason(plain_run):
    noise = np.random.default_rng(5).standard_normal(5_000)
    run = plain_run(noise, ground=noise)
    with pytest.raises(AbraceError, match="half_width 5, expected order >= 0 and half_width >= 6"):
        local_polynomial(run, "w", BAND, order=5, half_width=5)
    with pytest.raises(AbraceError, match="bags/plain: 10 s, expected at least 13 s"):
        local_polynomial(run, "w", (1.0, 2.0))
    with pytest.raises(AbraceError, match=r"no frequency line between 0\.31 and 0\.32 Hz"):
        local_polynomial(run, "w", (0.31, 0.32))
    with pytest.raises(AbraceError, match="segments of 4096 in 5000 samples, expected 2 to 2500"):
        welch(run, "w", BAND, segment=4096)
    with pytest.raises(AbraceError, match="no channel 'q'"):
        local_polynomial(run, "q", BAND)
