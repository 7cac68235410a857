# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from abrace_core.model.discretization import discretize
from abrace_sysid.fitting.pole_basis import Sampling
from abrace_sysid.models.realization import modal_states

PERIOD = 0.002
OMEGA = np.linspace(2, 190, 200)
Z = np.exp(1j * OMEGA * PERIOD)


@pytest.mark.parametrize(("name", "sampling"), [("w", Sampling(PERIOD, "first")), ("U", Sampling(PERIOD))])
def test_a_poles_response_is_that_of_the_discretised_model(name, sampling):
    pair, real = -0.1 + 7.36j, -6.4
    states = modal_states(np.array([pair, np.conj(pair), real]), name)
    expected = discretize(states, PERIOD).frequency_response(OMEGA)[:, :, 0]
    above, below = (sampling.response(pole, Z)[0] for pole in (pair, pair.conjugate()))
    single = sampling.response(real, Z)[0]
    found = np.column_stack([(above + below) / 2, 0.5j * (above - below), single, np.ones(len(Z))])
    assert np.abs(found / expected - 1).max() < 1e-8


@pytest.mark.parametrize("pole", [-0.1 + 7.36j, -6.4, -1240.0])
@pytest.mark.parametrize("sampling", [Sampling(PERIOD, "first"), Sampling(PERIOD)])
def test_slopes_are_derivatives_with_respect_to_the_pole(pole, sampling):
    change = 1e-6 * abs(pole)
    for function in (sampling.response, sampling.transient):
        difference = (function(pole + change, Z)[0] - function(pole - change, Z)[0]) / (2 * change)
        slope = function(pole, Z)[1]
        assert np.abs(slope - difference).max() < 1e-6 * np.abs(slope).max()


def test_leakage_of_a_finite_record_is_the_transient_of_its_pole():
    pole, samples = -0.1 + 7.36j, 5000
    state = np.exp(pole * PERIOD * np.arange(samples))
    lines = np.arange(5, 60)
    z = np.exp(2j * np.pi * lines / samples)
    transient = Sampling(PERIOD).transient(pole, z)[0]
    expected = transient * (1 - np.exp(pole * PERIOD * samples))
    assert np.abs(np.fft.fft(state)[lines] / expected - 1).max() < 1e-9
