# SPDX-License-Identifier: Apache-2.0
"""Sliding-mode control on the simulated rig, without ROS."""

import pytest
from sliding_mode.sliding_mode import SlidingMode

import abrace

FORCE = 15.0e3


def test_it_damps_every_floor_and_never_asks_for_more_than_its_force() -> None:
    free, damped = (
        abrace.simulate(
            "ncree_three_storey", "el_centro", peak_acceleration=0.980665, duration=20.0, controller=controller
        ).to_pandas()
        for controller in (None, SlidingMode(FORCE))
    )
    left = damped.std() / free.std()
    assert left["x3"] < 0.22, "displacement of the third floor; the skyhook leaves 0.27"
    assert left["a3"] < 0.22, "its acceleration; the skyhook leaves 0.26"
    assert (left[["x1", "x2", "x3"]] < 0.27).all()
    assert (left[["a1", "a2", "a3"]] < 0.40).all()
    assert 0.9 * FORCE < damped["U"].abs().max() <= FORCE


def test_what_does_not_fit_the_rig_is_said() -> None:
    with pytest.raises(ValueError, match=r"boundary 0, corner 0\.6, expected more than 0"):
        SlidingMode(boundary=0.0)
    with pytest.raises(ValueError, match=r"weights \[0.3, 0.4, 0.3\], expected 2 times 5, one for each floor"):
        SlidingMode().begin(5, 2, 0.002)
