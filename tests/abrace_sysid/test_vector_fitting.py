# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.linear_model import pole_table
from abrace_sysid.fitting.vector_fitting import fit_common_poles, vector_fitting
from abrace_sysid.spectra.frequency_response import FrequencyResponse


@pytest.fixture(scope="module")
def exact(rig):
    omega = np.linspace(2, 180, 800)
    response = rig.discrete_model().select(None, ["U"]).frequency_response(omega)[:, :, 0]
    return FrequencyResponse("U", rig.model.outputs, omega, response, 1e-9 * np.abs(response), 0.002, "exact")


def noisy(exact, share=1e-3, seed=0):
    sigma = np.full(exact.response.shape, share * np.sqrt(np.mean(np.abs(exact.response) ** 2, axis=0)))
    real, imaginary = np.random.default_rng(seed).standard_normal((2, *sigma.shape)) / np.sqrt(2)
    return replace(exact, response=exact.response + sigma * (real + 1j * imaginary), sigma=sigma)


def test_exact_responses_give_back_all_their_poles_hold_and_lag_included(exact, rig):
    fit = vector_fitting(exact, 14)
    true = rig.model.poles
    expected = np.concatenate([true[true.imag > 0], true[true.imag == 0]])
    assert len(fit.poles) == len(expected)
    assert np.abs(fit.poles / expected - 1).max() < 1e-5
    assert fit.shapes.shape == (8, 8)


def test_noisy_responses_give_all_pairs_from_all_channels_together(exact, rig):
    fit = vector_fitting(noisy(exact), 14)
    found, expected = pole_table(fit.poles), pole_table(rig.model.poles)
    assert len(found) == 6
    for (frequency, damping), (true_frequency, true_damping) in zip(found, expected, strict=True):
        assert abs(frequency / true_frequency - 1) < 2e-3
        assert abs(damping / true_damping - 1) < 0.05


def test_unstable_poles_are_refused_and_shown_to_who_asks_for_all(exact):
    growing = replace(exact, response=exact.response.conj())
    with pytest.raises(AbraceError, match="vector fitting of order 14: unstable poles"):
        vector_fitting(growing, 14)
    assert (fit_common_poles(growing, 14, np.ones(growing.response.shape)).poles.real > 0).any()


def test_orders_and_lines_that_cannot_be_are_refused(exact):
    few = replace(exact, omega=exact.omega[:8], response=exact.response[:8], sigma=exact.sigma[:8])
    with pytest.raises(AbraceError, match="order 14 and 8 frequency lines"):
        fit_common_poles(few, 14, np.ones(few.response.shape))
    with pytest.raises(AbraceError, match="not finite"):
        fit_common_poles(replace(exact, response=exact.response * np.nan), 4, np.ones(exact.response.shape))
