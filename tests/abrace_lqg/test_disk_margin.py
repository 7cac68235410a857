# SPDX-License-Identifier: Apache-2.0
"""The multi-loop disk margin: closed forms of mu, factors inside the disk that do no harm, how tight the bound is."""

from __future__ import annotations

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.linear_model import LinearModel
from abrace_lqg.analysis.disk_margin import DESCENT_STEPS, DiskMargin, _descended, _Matrices, disk_margin
from abrace_lqg.loop import Loop, is_stable

PERIOD = 0.01


def plant() -> LinearModel:
    """Two coupled floors, velocities measured, pushed at the lower one."""
    k = np.array([[500.0, -200.0], [-200.0, 180.0]])
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-k, -0.002 * k]])
    b = np.array([[0.0, 0.0], [0.0, 0.0], [1.0, 1.0], [1.0, 0.0]])
    c = np.hstack([np.zeros((2, 2)), np.eye(2)])
    return LinearModel(a, b, c, np.zeros((2, 2)), ("w", "U"), ("v1", "v2"))


def law(first: float = -6.0, second: float = -2.5, command: float = 1.0) -> LinearModel:
    """U = first v1 + second v2, times command."""
    d = command * np.array([[first, second]])
    return LinearModel(np.eye(1) / 2, np.zeros((1, 2)), np.zeros((1, 1)), d, ("v1", "v2"), ("U",), PERIOD)


def structured_bound(matrix: np.ndarray, descent_steps: int) -> np.ndarray:
    """Upper bound (matrices,) of mu of each matrix, for a diagonal complex perturbation."""
    return _descended(_Matrices(0.0, matrix, np.broadcast_to(np.eye(matrix.shape[1]), matrix.shape)), descent_steps)


def complex_matrices(count: int, size: int) -> np.ndarray:
    random = np.random.default_rng(5)
    return random.standard_normal((count, size, size)) + 1j * random.standard_normal((count, size, size))


def test_mu_of_a_dyad_is_the_sum_of_its_diagonals_magnitudes():
    vectors = complex_matrices(20, 4)
    u, v = vectors[:, :, 0], vectors[:, 0, :]
    found = structured_bound(u[:, :, None] * v[:, None, :], 0)
    np.testing.assert_allclose(found, np.abs(u * v).sum(axis=1), rtol=1e-6)


def test_mu_of_signals_that_have_nothing_to_do_with_each_other_is_the_largest():
    matrix = np.zeros((1, 3, 3), dtype=complex)
    matrix[0, [0, 1, 2], [0, 1, 2]] = [0.3j, -2.0, 1.0]
    np.testing.assert_allclose(structured_bound(matrix, DESCENT_STEPS), 2.0, rtol=1e-6)


def test_mu_does_not_depend_on_units():
    matrix = complex_matrices(10, 4)
    units = np.array([1e6, 1.0, 1e-3, 20.0])
    odd = structured_bound(matrix * units[:, None] / units, DESCENT_STEPS)
    np.testing.assert_allclose(odd, structured_bound(matrix, DESCENT_STEPS), rtol=1e-6)


def test_the_bound_is_met_by_a_perturbation():
    # for three signals mu is the bound: phases are sought whose spectral radius comes near it
    matrix = complex_matrices(5, 3)
    bound = structured_bound(matrix, 400)
    random = np.random.default_rng(1)
    phases = np.exp(2j * np.pi * random.random((20_000, 3)))
    for one, most in zip(matrix, bound, strict=True):
        reached = np.abs(np.linalg.eigvals(phases[:, :, None] * one)).max()
        assert 0.97 * most < reached <= most * (1 + 1e-9)


def test_no_factors_inside_the_disk_make_the_loop_unstable():
    alpha = disk_margin(plant(), law()).alpha
    assert 0.2 < alpha < 2
    random = np.random.default_rng(2)
    for d in np.vstack([np.sign(random.standard_normal((50, 3))), random.uniform(-1, 1, (100, 3))]) * 0.999 * alpha:
        first, second, command = (1 + d / 2) / (1 - d / 2)
        assert is_stable(plant(), law(-6.0 * first, -2.5 * second, command)), d


def test_a_margin_is_computed_only_as_far_as_it_may_be_below_the_one_given():
    alpha = disk_margin(plant(), law()).alpha
    assert disk_margin(plant(), law(), below=1.1 * alpha).alpha == pytest.approx(alpha, rel=1e-9)
    assert disk_margin(plant(), law(), below=0.9 * alpha).alpha == 0.9 * alpha


def test_one_sensor_and_one_command_have_the_margin_of_their_closed_form():
    # with r^2 = -L: S - I/2 = 1/(1 + L) [[1, K], [G, 1]] - I/2 has mu = max |(1 +- r) / (1 -+ r)| / 2
    one = plant().select(["v1"])
    controller = law().select(inputs=["v1"])
    omega = np.geomspace(1, np.pi / PERIOD, 40_000)
    root = np.sqrt(-Loop(one, controller).transfer_function("U", omega))
    mu = np.abs([(1 + root) / (1 - root), (1 - root) / (1 + root)]).max() / 2
    assert disk_margin(one, controller).alpha == pytest.approx(1 / mu, rel=1e-3)


def test_gain_and_phase_of_the_disk_are_those_of_the_paper():
    # Seiler, Packard and Gahinet 2020: alpha = 2/3, skew 0: gains from 0.5 to 2, phases to 36.87 degrees
    margin = DiskMargin(2 / 3, 10.0)
    assert margin.gain_db == pytest.approx(20 * np.log10(2))
    assert margin.phase_deg == pytest.approx(36.8699, abs=1e-4)
    assert DiskMargin(2.0, 10.0).gain_db == np.inf


def test_the_disk_margin_of_an_unstable_loop_is_refused():
    with pytest.raises(AbraceError, match="not stable"):
        disk_margin(plant(), law(first=30.0))


@pytest.mark.parametrize(("signals", "loosest"), [(2, 1.001), (4, 1.03), (8, 1.03)])
def test_the_bound_is_that_of_slicot_in_any_units(signals: int, loosest: float):
    """AB13MD, Young's bound by another algorithm: one matrix at a time, and not with a sourced ROS 2's NumPy."""
    ctrlsys = pytest.importorskip("ctrlsys", reason="ctrlsys needs NumPy 2")
    matrix = complex_matrices(50, signals)
    blocks, kinds = np.ones(signals, dtype=np.int32), np.full(signals, 2, dtype=np.int32)
    expected = np.array([ctrlsys.ab13md(np.asfortranarray(one), blocks, kinds)[0] for one in matrix])
    units = np.geomspace(1e-3, 1e3, signals)
    ratio = structured_bound(matrix * units[:, None] / units, DESCENT_STEPS) / expected
    assert ratio.min() > 1 - 1e-4
    assert ratio.max() < loosest
    assert np.median(ratio) < 1.001
