# SPDX-License-Identifier: Apache-2.0
"""The skyhook on the simulated rig, without ROS."""

from skyhook.skyhook import Skyhook

import abrace


def test_it_damps_every_floor() -> None:
    free, damped = (
        abrace.simulate(
            "ncree_three_storey", "el_centro", peak_acceleration=0.980665, duration=20.0, controller=controller
        ).to_pandas()
        for controller in (None, Skyhook())
    )
    left = damped.std() / free.std()
    assert (left[["x1", "x2", "x3", "a1", "a2", "a3"]] < 0.35).all()
