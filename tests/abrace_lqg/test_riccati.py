# SPDX-License-Identifier: Apache-2.0
"""Optimal gains against python-control; cross terms and correlated noise against closed forms."""

from __future__ import annotations

import control
import numpy as np
import pytest

from abrace_core.errors import AbraceError
from abrace_lqg.riccati import kalman, regulator, riccati


def small_system(states: int = 5, inputs: int = 2, outputs: int = 3) -> tuple[np.ndarray, ...]:
    random = np.random.default_rng(7)
    a = random.standard_normal((states, states)) - 1.5 * np.eye(states)
    return (
        a,
        random.standard_normal((states, inputs)),
        random.standard_normal((outputs, states)),
        random.standard_normal((outputs, inputs)),
    )


def test_regulator_gain_agrees_with_python_control():
    a, b, c, d = small_system()
    q, r = np.diag([1.0, 2.0, 0.5]), np.diag([1.0, 3.0])
    expected, _, _ = control.lqr(a, b, c.T @ q @ c, r + d.T @ q @ d, c.T @ q @ d, method="scipy")
    np.testing.assert_allclose(regulator(a, b, c, d, q, r), expected, rtol=1e-8, atol=1e-10)


def test_filter_gain_agrees_with_python_control_when_noises_are_independent():
    a, e, c, _ = small_system()
    v = np.diag([0.1, 0.2, 0.3])
    expected, _, _ = control.lqe(a, e, c, np.eye(2), v, method="scipy")
    np.testing.assert_allclose(kalman(a, e, c, np.zeros((3, 2)), v), expected, rtol=1e-8, atol=1e-10)


def test_cross_terms_equal_the_problem_in_which_they_are_completed_away():
    a, b, c, d = small_system()
    q, r = np.diag([1.0, 2.0, 0.5]), np.diag([1.0, 3.0])
    # U = U' - N x with N = R'^-1 D'QC turns z'Qz + U'RU into x'Q'x + U''R'U'', without a cross term
    whole = r + d.T @ q @ d
    shift = np.linalg.solve(whole, d.T @ q @ c)
    rest = c.T @ q @ c - shift.T @ whole @ shift
    rest = (rest + rest.T) / 2
    equivalent, _, _ = control.lqr(a - b @ shift, b, rest, whole, method="scipy")
    np.testing.assert_allclose(regulator(a, b, c, d, q, r), equivalent + shift, rtol=1e-8, atol=1e-10)


def test_correlated_noise_equals_the_problem_in_which_it_is_subtracted():
    a, e, c, f = small_system()
    v = np.diag([0.1, 0.2, 0.3])
    # E W less its projection T (F W + v) is independent of the measurement: Z' = (A - T C) Z + T y + (E W - T(F W + v))
    whole = f @ f.T + v
    share = e @ f.T @ np.linalg.inv(whole)
    rest = e @ e.T - share @ whole @ share.T
    rest = (rest + rest.T) / 2
    equivalent, _, _ = control.lqe(a - share @ c, np.eye(5), c, rest, whole, method="scipy")
    np.testing.assert_allclose(kalman(a, e, c, f, v), equivalent + share, rtol=1e-8, atol=1e-10)


def test_a_double_integrator_gets_its_textbook_gain():
    a, b = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])
    gain = regulator(a, b, np.array([[1.0, 0.0]]), np.zeros((1, 1)), np.eye(1), np.eye(1))
    np.testing.assert_allclose(gain, [[1.0, np.sqrt(2)]], rtol=1e-12)


def test_a_filter_of_one_state_with_feedthrough_has_its_closed_form():
    # z' = -z + w, y = z + w + v: P = -(k) + sqrt(k^2 + ...) from (P + 1)^2 / (1 + v) = 1 - 2 P
    v = 0.5
    gain = kalman(-np.eye(1), np.eye(1), np.eye(1), np.eye(1), v * np.eye(1))
    s = 1 + v
    p = -(1 + s) + np.sqrt((1 + s) ** 2 + s - 1)
    np.testing.assert_allclose(gain, [[(p + 1) / s]], rtol=1e-12)


def test_an_unstabilisable_model_is_refused_by_name():
    a = np.diag([1.0, -1.0])
    with pytest.raises(AbraceError, match="regulator"):
        riccati(a, np.array([[0.0], [1.0]]), np.eye(2), np.eye(1), np.zeros((2, 1)), "regulator")
