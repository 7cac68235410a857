# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from abrace_core.errors import AbraceError
from abrace_core.linear_model import pole_table
from abrace_sysid.fitting.curve_fit import (
    fit_rational,
    fit_sanathanan_koerner,
    require_stable,
    uncertainty_weights,
)

A2 = np.array(
    [-0.111 + 7.254j, -0.481 + 23.316j, -0.448 + 37.896j, -0.696 + 56.549j, -0.532 + 105.277j, -8.263 + 134.8j]
)
OMEGA = np.linspace(2, 190, 1500)


def response(poles, omega, direct=0.3):
    residues = np.array([1 + 0.2j, -2 + 1j, 1.5, 0.5j, 0.8, 20 + 3j])[: len(poles)]
    s = 1j * omega[:, None]
    return direct + (residues / (s - poles) + residues.conj() / (s - poles.conj())).sum(axis=1)


def both(upper):
    return np.sort_complex(np.concatenate([upper, upper.conj()]))


@pytest.mark.parametrize("pairs", [3, 6])
def test_exact_responses_give_back_their_poles(pairs):
    g = response(A2[:pairs], OMEGA)
    fit = fit_rational(OMEGA, g, 2 * pairs, 2 * pairs)
    assert np.abs(np.sort_complex(fit.poles()) - both(A2[:pairs])).max() < 1e-6
    assert np.abs(fit.response(OMEGA) / g - 1).max() < 1e-7


def test_coefficients_solve_eq_1_with_its_sign_mended_and_not_as_printed():
    omega = np.linspace(2, 45, 400)
    random = np.random.default_rng(1)
    g = response(A2[:3], omega) * (1 + 0.01 * random.standard_normal(400))
    weights = 1 / omega**2
    m = n = 6
    fit = fit_rational(omega, g, m, n, weights)
    s = 1j * omega / fit.frequency_scale
    omega_matrix = np.vander(s, n + 1)
    gamma, f, weighted = np.vander(s, m) * g[:, None], s**m * g, weights[:, None]

    def residual(sign):
        left = omega_matrix.conj().T @ (weighted * (omega_matrix @ fit.numerator[:, None]))
        right = omega_matrix.conj().T @ (weighted * (gamma @ fit.denominator[1:, None]))
        upper = left + sign * right - omega_matrix.conj().T @ (weighted * f[:, None])
        below = -gamma.conj().T @ (weighted * (omega_matrix @ fit.numerator[:, None]))
        below = below + gamma.conj().T @ (weighted * (gamma @ fit.denominator[1:, None] + f[:, None]))
        return np.abs(upper.real).max() / np.abs(left).max(), np.abs(below.real).max() / np.abs(left).max()

    assert max(residual(-1)) < 1e-9, "Eq. (1) with -Omega* Lambda Gamma was expected to hold"
    assert residual(+1)[0] > 0.1, "Eq. (1) as printed was expected not to hold"


def test_sanathanan_koerner_finds_twelve_poles_where_eq_1_does_not():
    random = np.random.default_rng(2)
    noise = 0.01 * np.abs(response(A2, OMEGA)).mean()
    g = response(A2, OMEGA) + noise * (random.standard_normal(1500) + 1j * random.standard_normal(1500))
    weights = uncertainty_weights(g, np.full(1500, noise))
    true = pole_table(both(A2))

    def frequency_error(fit):
        found = pole_table(fit.poles())
        if len(found) != len(true):
            return np.inf
        return max(abs(a / b - 1) for (a, _), (b, _) in zip(found, true, strict=True))

    assert frequency_error(fit_sanathanan_koerner(OMEGA, g, 12, 12, weights)) < 0.002
    assert frequency_error(fit_rational(OMEGA, g, 12, 12, weights)) > 0.05


def test_weights_follow_the_noise_and_are_bounded_where_there_is_none():
    g = np.array([100.0 + 0j, 1.0, 0.0])
    assert np.allclose(uncertainty_weights(g, np.array([0.0, 1.0, 1.0])), [1.0, 1 / 1.0001, 1.0])
    assert np.isfinite(uncertainty_weights(np.zeros(1, complex), np.zeros(1))).all()


def test_unstable_poles_are_named():
    with pytest.raises(AbraceError, match=r"table test: unstable poles \+0\.02\+7\.3i rad/s, expected stable"):
        require_stable(np.array([0.02 + 7.3j, 0.02 - 7.3j, -1 + 5j, -1 - 5j]), "table test")
    stable = np.array([-1 + 5j, -1 - 5j])
    assert require_stable(stable, "table test") is stable


def test_too_few_lines_and_values_that_are_not_finite_are_refused():
    with pytest.raises(AbraceError, match="6 frequency lines, expected at least 7"):
        fit_rational(OMEGA[:6], response(A2, OMEGA[:6]), 6, 6)
    with pytest.raises(AbraceError, match="not finite"):
        fit_rational(OMEGA, np.full(1500, np.nan + 0j), 6, 6)
