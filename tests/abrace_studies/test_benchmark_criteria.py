# SPDX-License-Identifier: Apache-2.0
"""The benchmark's criteria, by hand."""

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_studies.benchmark.criteria import Layout, Responses, criteria, peaks

LAYOUT = Layout(np.array([100.0, 50.0]), np.array([4.0, 2.0]), (1, 2), (3, 1), (1.0, 0.5))
PERIOD = 0.5


def responses(**changes) -> Responses:
    given = {
        "period": PERIOD,
        "displacement": np.array([[0.0, 0.0], [0.04, 0.06], [-0.02, 0.02]]),
        "velocity": np.array([[0.0, 0.0], [0.1, 0.3], [0.2, -0.1]]),
        "acceleration": np.array([[1.0, 1.0], [-2.0, 3.0], [0.0, -4.0]]),
        "force": np.array([[0.0, 0.0], [10.0, -20.0], [30.0, 5.0]]),
    }
    return Responses(**given | changes)


def test_peaks_and_norms_are_those_of_drift_ratio_acceleration_and_base_shear():
    found = peaks(responses(), LAYOUT)
    # drifts 0, 0.04, -0.02 over 4 m and 0, 0.02, 0.04 over 2 m; base shears 150, -50, -200; two periods of 0.5 s
    assert found["d_max"] == pytest.approx(0.02)
    assert found["xdd_max"] == pytest.approx(4.0)
    assert found["F_max"] == pytest.approx(200.0)
    assert found["d_max_norm"] == pytest.approx(np.sqrt((0.01**2 + 0.02**2) / 2))
    assert found["xdd_max_norm"] == pytest.approx(np.sqrt((1 + 9 + 16) / 2))
    assert found["F_max_norm"] == pytest.approx(np.sqrt((150**2 + 50**2 + 200**2) / 2))
    assert (found["x_max"], found["xd_max"]) == (0.06, 0.3)
    assert "phi_max" not in found


def test_criteria_are_ratios_to_the_uncontrolled_and_what_the_devices_need():
    uncontrolled = peaks(responses(displacement=2 * responses().displacement), LAYOUT) | {"phi_max": 0.5}
    found = criteria(responses(), LAYOUT, uncontrolled, sensors=2, states=7)
    weight = 9.81 * 150.0
    assert found["J1"] == found["J4"] == pytest.approx(0.5)
    assert found["J2"] == found["J3"] == found["J5"] == found["J6"] == pytest.approx(1.0)
    assert found["J11"] == pytest.approx(30.0 / weight)
    assert found["J12"] == pytest.approx(0.04 / 0.12)
    # strokes' rates: 0, 0.1, 0.2 in storey 1; 0, 0.2 / 2, -0.3 / 2 in storey 2
    power = [3 * 0.1 * 10.0 + 0.1 * 20.0, 3 * 0.2 * 30.0 + 0.15 * 5.0]
    assert found["J13"] == pytest.approx(power[1] / (0.3 * weight))
    assert found["J14"] == pytest.approx(sum(power) * PERIOD / (2 * PERIOD) / (0.3 * weight))
    assert (found["J15"], found["J16"], found["J17"]) == (4, 2, 7)
    assert "J7" not in found


def test_curvature_gives_j7_and_j10():
    curved = responses(curvature=np.array([[0.0, 0.1], [0.2, -0.3], [0.0, 0.0]]))
    uncontrolled = peaks(curved, LAYOUT)
    assert uncontrolled["phi_max"] == 0.3
    assert uncontrolled["phi_max_norm"] == pytest.approx(np.sqrt((0.01 + 0.09) / 3))
    found = criteria(curved, LAYOUT, uncontrolled | {"phi_max": 0.6})
    assert (found["J7"], found["J10"]) == (pytest.approx(0.5), pytest.approx(1.0))
    assert not {"J16", "J17"} & set(found)


def test_responses_of_another_building_are_refused():
    with pytest.raises(AbraceError, match=r"velocity of shape \(3, 1\), expected \(samples, 2\)"):
        peaks(responses(velocity=np.zeros((3, 1))), LAYOUT)
    with pytest.raises(AbraceError, match=r"force of shape \(3, 1\), expected \(samples, 2\)"):
        criteria(responses(force=np.zeros((3, 1))), LAYOUT, peaks(responses(), LAYOUT))
