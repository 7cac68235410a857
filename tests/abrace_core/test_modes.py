# SPDX-License-Identifier: Apache-2.0
import numpy as np

from abrace_core.model.modes import match_modes, modal_assurance, nearest_mode


def test_modal_assurance_is_one_for_a_scaled_shape_and_zero_for_an_orthogonal_one():
    one = np.array([[1.0, 2.0], [2.0, -1.0]])
    np.testing.assert_allclose(modal_assurance(one, 3j * one), np.eye(2), atol=1e-15)


def test_modes_are_matched_once_within_the_tolerance():
    assert match_modes([1.0, 2.0, 3.0], [2.05, 1.02, 9.0]) == [(0, 1), (1, 0)]
    assert match_modes([1.0, 1.05], [1.04]) == [(1, 0)], "the nearer one"
    assert match_modes([1.0], [1.2]) == []
    assert match_modes([1.0], [1.2], tolerance=0.3) == [(0, 0)]
    assert match_modes([], [1.0]) == match_modes([1.0], []) == []


def test_nearest_mode_is_none_of_those_farther_than_the_tolerance():
    assert nearest_mode([1.0, 2.0, 2.06], 2.04) == 2
    assert nearest_mode([1.0, 2.2], 2.0) is None
    assert nearest_mode([], 2.0) is None


def test_close_modes_are_matched_by_their_shapes():
    crossed = np.array([[0.1, 0.9], [0.95, 0.0]])
    assert match_modes([1.0, 1.02], [1.0, 1.02], crossed) == [(0, 1), (1, 0)]
    assert match_modes([1.0, 1.02], [1.0, 1.02], crossed, least_alike=0.92) == [(1, 0)]
