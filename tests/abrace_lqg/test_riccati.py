# SPDX-License-Identifier: Apache-2.0
"""Optimal gains against python-control; cross terms and correlated noise against closed forms."""

from __future__ import annotations

import control
import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_lqg.riccati import kalman, regulator


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


def test_an_unstabilisable_model_is_refused_by_name():
    a = np.diag([1.0, -1.0])
    with pytest.raises(AbraceError, match="regulator"):
        regulator(a, np.array([[0.0], [1.0]]), np.eye(2), np.zeros((2, 1)), np.eye(2), np.eye(1))
