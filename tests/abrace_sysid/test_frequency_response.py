# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from abrace_core.model.discretization import discretize
from abrace_sysid.spectra.frequency_response import FrequencyResponse, hold_and_delay, sampled_response

PERIOD = 0.002


def exact(name, omega, response, outputs=("f",)):
    return FrequencyResponse(name, outputs, omega, response, np.full(response.shape, 1e-3), PERIOD, "exact")


@pytest.mark.parametrize(("name", "column"), [("w", 0), ("U", 1)])
def test_a_hold_taken_out_of_the_sampled_response_leaves_the_continuous_one(rig, name, column):
    omega = 2 * np.pi * np.linspace(0.5, 10, 200)
    sampled = discretize(rig.model, PERIOD)
    third = list(rig.model.outputs).index("x3")
    measured = exact(name, omega, sampled.frequency_response(omega)[:, [third], column])
    continuous = rig.model.frequency_response(omega)[:, third, column]
    left = measured.without_hold().response[:, 0]
    assert np.linalg.norm(left - continuous) < 2e-3 * np.linalg.norm(continuous)
    assert np.linalg.norm(measured.response[:, 0] - continuous) > np.linalg.norm(left - continuous)


def test_a_known_delay_comes_out_with_the_hold():
    omega = np.linspace(1, 100, 50)
    late = exact("U", omega, 5 * hold_and_delay(omega, PERIOD, "zero", 0.0008)[:, None])
    without = late.without_hold(0.0008)
    assert np.allclose(without.response, 5)
    assert np.allclose(without.sigma, late.sigma * np.abs(5 / late.response))
    assert np.allclose(np.angle(late.response[:, 0]), -omega * 0.0018), "half a sample and the delay"
    assert np.allclose(np.angle(hold_and_delay(omega, PERIOD, "first")), 0)


def test_selection_keeps_lines_and_names():
    omega = np.linspace(1, 100, 50)
    response = np.arange(150).reshape(50, 3) * 1j
    found = exact("w", omega, response, ("x1", "a1", "f")).select(["f", "x1"])
    assert found.outputs == ("f", "x1")
    assert np.array_equal(found.response, response[:, [2, 0]])
    assert found.sigma.shape == (50, 2)


def test_a_model_is_sampled_as_the_rig_was(rig):
    omega = np.linspace(2, 180, 100)
    for column, name in enumerate(("w", "U")):
        expected = rig.discrete_model().frequency_response(omega)[:, :, column]
        assert np.allclose(sampled_response(rig.model, exact(name, omega, expected)), expected, rtol=1e-9)
