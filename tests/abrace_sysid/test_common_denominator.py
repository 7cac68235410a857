import numpy as np
import pytest

from abrace_core.errors import AbraceError
from abrace_core.linear_model import pole_table
from abrace_sysid.fitting.common_denominator import fit_common_denominator
from abrace_sysid.fitting.curve_fit import fit_sanathanan_koerner, uncertainty_weights

POLES = np.array([-0.102 + 7.36j, -0.55 + 22.9j, -0.51 + 38.0j])
SHAPES = np.array([[1.0, 0.8, 0.3], [-0.5j, 1.0, -0.9], [0.6, -1.0, 1.0j]])
OMEGA = np.linspace(2, 60, 1200)


def responses(noise=0.0, seed=0):
    s = 1j * OMEGA[:, None]
    exact = (1 / (s - POLES)) @ SHAPES + (1 / (s - POLES.conj())) @ SHAPES.conj()
    real, imaginary = np.random.default_rng(seed).standard_normal((2, *exact.shape))
    return exact + noise * (real + 1j * imaginary)


def damping_error(fit):
    expected = pole_table(POLES)
    return max(abs(a / b - 1) for (_, a), (_, b) in zip(pole_table(fit.poles()), expected, strict=True))


def test_exact_outputs_have_one_denominator_and_their_own_numerators():
    g = responses()
    fits = fit_common_denominator(OMEGA, g, 6, 6, np.ones(g.shape))
    assert len(fits) == 3
    for fit, column in zip(fits, g.T, strict=True):
        assert fit.denominator is fits[0].denominator
        assert np.abs(fit.response(OMEGA) / column - 1).max() < 1e-7
    assert damping_error(fits[0]) < 1e-7


def test_three_outputs_with_noise_say_more_of_the_poles_than_one():
    together, alone = [], []
    for seed in range(8):
        g = responses(0.02, seed)
        weights = uncertainty_weights(g, np.full(g.shape, 0.02 * np.sqrt(2)))
        together.append(damping_error(fit_common_denominator(OMEGA, g, 6, 6, weights)[0]))
        alone.append(damping_error(fit_sanathanan_koerner(OMEGA, g[:, 0], 6, 6, weights[:, 0])))
    assert np.mean(together) < np.mean(alone)


def test_what_cannot_be_fitted_is_refused():
    with pytest.raises(AbraceError, match="6 frequency lines, expected at least 7"):
        fit_common_denominator(OMEGA[:6], responses()[:6], 6, 6, np.ones((6, 3)))
    with pytest.raises(AbraceError, match="not finite"):
        fit_common_denominator(OMEGA, responses() * np.nan, 6, 6, np.ones((1200, 3)))
