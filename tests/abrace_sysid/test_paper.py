# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import pole_table
from abrace_sysid import paper
from abrace_sysid.fitting.options import IdentificationOptions
from abrace_sysid.identification import identify
from abrace_sysid.spectra.frequency_response import FrequencyResponse

A1 = np.array([-0.110 + 7.275j, -0.545 + 22.846j, -0.468 + 37.939j])
A2 = np.array(
    [-0.111 + 7.254j, -0.481 + 23.316j, -0.448 + 37.896j, -0.696 + 56.549j, -0.532 + 105.277j, -8.263 + 134.8j]
)
OMEGA = np.linspace(2, 190, 1500)


def response(upper, omega, direct=0.3):
    residues = np.array([1 + 0.2j, -2 + 1j, 1.5, 0.5j, 0.8, 20 + 3j])[: len(upper)]
    s = 1j * omega[:, None]
    return direct + (residues / (s - upper) + residues.conj() / (s - upper.conj())).sum(axis=1)


def upper_roots(A):
    found = np.roots(A)
    found = found[found.imag > 0]
    return found[np.argsort(np.abs(found))]


def test_equations_1_and_2_by_hand():
    """g = 3 / (s + 2) at w = 1 and 2: b_0 = 3, a_0 = 2 solve a_0 g + s g = b_0; n = 0, m = 1."""
    w = np.array([1.0, 2.0])
    g = 3 / (1j * w + 2)
    Ω, Γ, F = paper.equation_2(w, g, 0, 1)
    np.testing.assert_allclose(Ω, [[1], [1]])
    np.testing.assert_allclose(Γ, [[3 / (2 + 1j)], [3 / (2 + 2j)]])  # a_0's column, which the paper's print lacks
    np.testing.assert_allclose(F, [3j / (2 + 1j), 6j / (2 + 2j)])
    for λ in (np.ones(2), np.array([1.0, 100.0])):
        b, a = paper.equation_1(Ω, Γ, F, λ)
        np.testing.assert_allclose([*b, *a], [3, 2], rtol=1e-12)


def test_lambda_decides_between_data_points_that_contradict_each_other():
    """A constant, b_0 / 1, of g = 1 and 3: their mean with λ = 1, and (1 + 9 * 3) / 10 with λ = 1 and 9."""
    Ω, Γ, F = paper.equation_2(np.array([1.0, 2.0]), np.array([1.0 + 0j, 3.0]), 0, 0)
    assert paper.equation_1(Ω, Γ, F, np.ones(2))[0] == pytest.approx([2.0])
    assert paper.equation_1(Ω, Γ, F, np.array([1.0, 9.0]))[0] == pytest.approx([2.8])


def test_coefficients_solve_eq_1_with_its_sign_mended_and_not_as_printed():
    w = np.linspace(2, 45, 400)
    g = response(A1, w) * (1 + 0.01 * np.random.default_rng(1).standard_normal(400))
    Ω, Γ, F = paper.equation_2(w, g, 6, 6)
    λ = 1 / w**2
    b, a = paper.equation_1(Ω, Γ, F, λ)

    def left_over(sign):
        rows = Ω.conj().T @ (λ * (Ω @ b + sign * (Γ @ a) - F))
        return (np.abs(rows.real) / (np.abs(Ω).T @ (λ * np.abs(Ω @ b)))).max()

    assert left_over(-1) < 1e-8, "Eq. (1) with -Omega* Lambda Gamma was expected to hold"
    assert left_over(+1) > 0.1, "Eq. (1) as printed was expected not to hold"


@pytest.mark.parametrize("upper", [A1, A2])
def test_exact_responses_give_back_their_poles(upper):
    order = 2 * len(upper)
    b, A = paper.curve_fit(OMEGA, response(upper, OMEGA), order, order)
    np.testing.assert_allclose(upper_roots(A), upper, rtol=1e-6)
    assert b[0] == pytest.approx(0.3, rel=1e-5)


def test_of_noisy_responses_only_a_falling_lambda_and_that_of_the_step_before_find_twelve_poles():
    random = np.random.default_rng(2)
    noise = 0.01 * np.abs(response(A2, OMEGA)).mean()
    g = response(A2, OMEGA) + noise * (random.standard_normal(1500) + 1j * random.standard_normal(1500))

    def frequency_error(power, steps):
        A = paper.curve_fit(OMEGA, g, 12, 12, paper.power_of_frequency(OMEGA, power), steps)[1]
        found = upper_roots(A)
        return np.abs(np.abs(found) / np.abs(A2) - 1).max() if len(found) == 6 else np.inf

    assert frequency_error(0, 0) > 0.05, "with λ = 1"
    assert frequency_error(-8, 10) < 0.002


def test_numerators_and_state_space_hold_the_fitted_response():
    w = np.linspace(2, 45, 300)
    both = np.column_stack([response(A1, w), 2 * response(A1, w, direct=-0.1)])
    measured = FrequencyResponse("w", ("x1", "a1"), w, both, 0 * both.real, 0.002, "exact")
    A = np.poly(np.concatenate([A1, A1.conj()])).real
    np.testing.assert_allclose(paper.numerator(w, both[:, 0], A, 6)[0], 0.3, rtol=1e-8)
    part = paper.state_space(measured, A)
    assert (part.order, part.inputs, part.outputs) == (6, ("w",), ("x1", "a1"))
    np.testing.assert_allclose(part.frequency_response(w)[:, :, 0], both, rtol=1e-6)


def exact(rig, name, highest):
    omega = 2 * np.pi * np.arange(0.3, highest, 0.01)
    sampled = discretize(rig.model.select(None, [name]), 0.002).frequency_response(omega)[:, :, 0]
    sigma = np.full(sampled.shape, 0.01 * np.sqrt(np.mean(np.abs(sampled) ** 2, axis=0)))
    return FrequencyResponse(name, rig.model.outputs, omega, sampled, sigma, 0.002, "exact")


def test_transfer_functions_of_the_rig_give_24_states_with_its_poles_and_8(rig):
    table, command = exact(rig, "w", 10.0), exact(rig, "U", 30.0)
    found = paper.paper_model(table, [command], 3, delay=0.0008)
    assert (found.model.order, found.model.inputs, found.model.outputs) == (24, ("w", "U"), rig.model.outputs)
    assert found.model.input_delay == (0.0, 0.0008)
    true = rig.model.poles
    true = true[true.imag > 0]
    for poles in (found.table, found.command):
        upper = poles[poles.imag > 0]
        np.testing.assert_allclose(np.abs(upper), np.abs(true[: len(upper)]), rtol=5e-4)


def test_unstable_poles_too_few_lines_and_missing_accelerations_are_refused(rig):
    table, command = exact(rig, "w", 10.0), exact(rig, "U", 30.0)
    growing = replace(command, response=command.response.conj())
    with pytest.raises(AbraceError, match=r"a3 from U, order 12: unstable poles .* rad/s, expected stable"):
        paper.paper_model(table, [growing], 3)
    with pytest.raises(AbraceError, match="6 frequency lines, expected at least 7"):
        paper.curve_fit(OMEGA[:6], response(A1, OMEGA[:6]), 6, 6)
    with pytest.raises(AbraceError, match="not finite"):
        paper.curve_fit(OMEGA, np.full(1500, np.nan + 0j), 6, 6)
    with pytest.raises(AbraceError, match="no acceleration among x1, x2"):
        paper.paper_model(table.select(["x1", "x2"]), [command.select(["x1", "x2"])], 3)


def test_identify_by_the_paper_finds_six_stable_pairs_and_its_models(table_test, command_test, rig):
    found = identify(table_test, command_test, IdentificationOptions(method="paper", servo_lag=0.0008))
    assert (found.model.order, found.superposed.order, found.reduced.order) == (24, 24, 8)
    true = pole_table(rig.model.poles)
    for pairs in (found.poles.table_pairs, found.poles.command_pairs):
        own = np.array([(pair.frequency, pair.damping) for pair in pairs])
        error = np.abs(own / np.array(true[: len(own)]) - 1)
        assert error[:, 0].max() < 0.002, "worst frequency"
        assert error[:3, 1].max() < 0.1, "damping of the building's modes"
        assert np.isnan(pairs[0].frequency_deviation), "the method gives no intervals"
    assert (len(found.poles.table_pairs), len(found.poles.command_pairs)) == (3, 6)
    assert found.covariance is None
