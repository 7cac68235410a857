# SPDX-License-Identifier: Apache-2.0
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from abrace_core import AbraceError
from abrace_plant.rig.building import (
    Building,
    modal_damping,
    rayleigh_damping,
    shear_stiffness,
    stiffness_of_modes,
)
from abrace_plant.rig.file import load_rig

PAPERS = load_rig(Path(__file__).parents[2] / "src/abrace_plant/config/ncree_three_storey.yaml").building


def undamped(masses: np.ndarray, stiffness: np.ndarray) -> Building:
    return Building(masses, stiffness, np.zeros_like(stiffness))


# --- modes -----------------------------------------------------------------------------------------------------------


def test_modes_are_mass_normalised_and_those_of_the_frame():
    frequencies, shapes = PAPERS.modes()
    np.testing.assert_allclose(shapes.T @ np.diag(PAPERS.masses) @ shapes, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(shapes.T @ PAPERS.stiffness @ shapes, np.diag(frequencies**2), atol=1e-8)
    assert (np.diff(frequencies) > 0).all()
    assert (shapes[-1] > 0).all(), "the roof moves forwards"


def test_modes_that_do_not_move_the_roof_keep_their_shape():
    building = undamped(np.array([1.0, 4.0]), np.diag([9.0, 4.0]))
    frequencies, shapes = building.modes()
    np.testing.assert_allclose(frequencies, [1.0, 3.0])
    np.testing.assert_allclose(np.abs(shapes), [[0.0, 1.0], [0.5, 0.0]])
    damping = modal_damping(building.masses, building.stiffness, np.array([0.1, 0.2]))
    np.testing.assert_allclose(damping, np.diag([2 * 0.2 * 3.0, 4 * 2 * 0.1 * 1.0]))


# --- shear building --------------------------------------------------------------------------------------------------


def test_shear_building_gives_by_the_drifts_of_a_push_on_its_roof():
    storeys = np.array([4.0, 3.0, 2.0, 1.0])
    drifts = np.diff(np.linalg.solve(shear_stiffness(storeys), [0.0, 0.0, 0.0, 12.0]), prepend=0.0)
    np.testing.assert_allclose(drifts, 12.0 / storeys)
    np.testing.assert_allclose(shear_stiffness(np.array([5.0])), [[5.0]])


# --- stiffness from measured modes -----------------------------------------------------------------------------------


def test_stiffness_of_a_frames_own_modes_is_its_stiffness_whatever_the_shapes_are_scaled_by():
    frequencies, shapes = PAPERS.modes()
    found = stiffness_of_modes(PAPERS.masses, frequencies, shapes * np.array([3.0, -0.2, 40.0]))
    np.testing.assert_allclose(found, PAPERS.stiffness, rtol=1e-9)


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), floors=st.integers(1, 6))
def test_measured_shapes_keep_their_frequencies_and_move_no_more_than_they_must(seed, floors):
    random = np.random.default_rng(seed)
    masses = random.uniform(5e3, 2e4, floors)
    _, exact = undamped(masses, shear_stiffness(random.uniform(1e7, 3e7, floors))).modes()
    measured = exact + 0.02 * random.uniform(-1, 1, exact.shape) * np.abs(exact).max()
    frequencies = np.cumsum(random.uniform(2.0, 20.0, floors))
    stiffness = stiffness_of_modes(masses, frequencies, measured)
    np.testing.assert_array_equal(stiffness, stiffness.T)
    found, shapes = undamped(masses, stiffness).modes()
    np.testing.assert_allclose(found, frequencies, rtol=1e-9)
    # nearest orthonormal set: any rotation of it is farther from the normalised shapes, in the mass metric
    root = np.sqrt(masses)[:, None]
    wanted = root * measured / np.linalg.norm(root * measured, axis=0)
    reached = root * shapes * np.sign(np.sum(root * shapes * wanted, axis=0))
    distance = np.linalg.norm(reached - wanted)
    for _ in range(5):
        skew = random.normal(0.0, 0.05, (floors, floors))
        rotation = np.linalg.qr(np.eye(floors) + skew - skew.T)[0]
        rotation = rotation * np.sign(np.diag(rotation))
        assert np.linalg.norm(reached @ rotation - wanted) >= distance - 1e-9


def test_shapes_that_are_too_alike_are_refused_with_their_modes_and_cosine():
    shapes = np.array([[1.0, 1.0, 1.0], [2.0, 0.0, 2.4], [3.0, -1.0, 3.0]])
    with pytest.raises(AbraceError, match=r"modes 1 and 3 are too alike: 0\.99\d .* expected at most 0\.2"):
        stiffness_of_modes(np.ones(3), np.array([1.0, 2.0, 3.0]), shapes)


def test_shapes_that_are_dependent_only_all_together_are_refused():
    # seven directions in six dimensions, each pair at a cosine of -1/6: the corners of a simplex
    simplex = np.linalg.svd(np.eye(7) - 1 / 7)[0][:, :6]
    shapes = np.vstack([simplex.T, np.zeros(7)])
    with pytest.raises(AbraceError, match="nearly dependent"):
        stiffness_of_modes(np.ones(7), np.arange(1.0, 8.0), shapes)


# --- damping ---------------------------------------------------------------------------------------------------------


def test_damping_matrix_gives_each_mode_its_ratio_and_couples_none():
    ratios = np.array([0.008, 0.0025, 0.0033])
    damping = modal_damping(PAPERS.masses, PAPERS.stiffness, ratios)
    frequencies, shapes = PAPERS.modes()
    np.testing.assert_allclose(shapes.T @ damping @ shapes, np.diag(2 * ratios * frequencies), atol=1e-12)
    np.testing.assert_allclose(Building(PAPERS.masses, PAPERS.stiffness, damping).damping_ratios, ratios, rtol=1e-9)


@settings(max_examples=30)
@given(modes=st.permutations(range(1, 6)), ratio=st.floats(0.001, 0.1))
def test_rayleigh_damping_gives_its_two_modes_their_ratio_and_couples_none(modes, ratio):
    one, other = modes[:2]
    masses = np.array([2.0, 2.0, 2.0, 2.0, 1.5]) * 1e4
    stiffness = shear_stiffness(np.array([2.8, 2.5, 2.2, 1.9, 1.5]) * 1e7)
    damping = rayleigh_damping(masses, stiffness, (one, other), (ratio, ratio))
    building = Building(masses, stiffness, damping)
    found = building.damping_ratios
    np.testing.assert_allclose(found[[one - 1, other - 1]], ratio, rtol=1e-9)
    between = slice(min(one, other), max(one, other) - 1)
    assert (found[between] < ratio).all(), "between the two the ratio is smaller, outside greater"
    _, shapes = building.modes()
    modal = shapes.T @ damping @ shapes
    np.testing.assert_allclose(modal - np.diag(np.diag(modal)), 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("modes", "ratios", "message"),
    [
        ((1, 2), (0.05, 0.001), "mode 3 gets a damping ratio of -"),
        ((2, 3), (0.001, 0.05), "mode 1 gets a damping ratio of -"),
        ((1, 2), (0.1, 0.9), "mode 3 gets a damping ratio of 1."),
    ],
)
def test_rayleigh_damping_that_leaves_a_mode_undamped_or_overdamped_tells_which_mode_gets_what(modes, ratios, message):
    with pytest.raises(AbraceError, match=message) as caught:
        rayleigh_damping(PAPERS.masses, PAPERS.stiffness, modes, ratios)
    assert "modes 1 to 3 get" in str(caught.value)


def test_rayleigh_damping_by_two_modes_of_one_frequency_is_refused():
    with pytest.raises(AbraceError, match="modes 1 and 2 have the same frequency"):
        rayleigh_damping(np.ones(2), np.eye(2), (1, 2), (0.01, 0.01))
