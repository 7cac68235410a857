# SPDX-License-Identifier: Apache-2.0
"""The triangular factor of a test's lines, from products of columns or by QR."""

import numpy as np
import pytest

from abrace_sysid.fitting.curve_fit import triangular_factor


@pytest.mark.parametrize(
    ("near", "alike"),
    [(1.0, ()), (1e-3, ()), (1e-9, ()), (1e-9, (2, 5))],
    ids=["apart", "less so", "by QR", "orthogonal before"],
)
def test_the_factor_is_that_of_a_qr_factorization(near, alike):
    rows = np.asfortranarray(np.random.default_rng(1).standard_normal((400, 8)))
    rows[:, 5] = rows[:, 2] + near * rows[:, 5]
    before = rows.copy()
    expected = np.linalg.qr(rows, mode="r")
    found = triangular_factor(rows, alike)
    np.testing.assert_array_equal(rows, before)
    # rows may have other signs
    np.testing.assert_allclose(np.abs(found), np.abs(expected), rtol=1e-6, atol=1e-9)
