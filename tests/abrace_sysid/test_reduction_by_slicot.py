# SPDX-License-Identifier: Apache-2.0
"""Balanced truncation against SLICOT's AB09AD, which a sourced ROS 2's NumPy does not have."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

from abrace_plant.rig.published import INTENSITY
from abrace_sysid.models.reduction import balanced_truncation, typical_scales

ctrlsys = pytest.importorskip("ctrlsys", reason="ctrlsys needs NumPy 2, a sourced ROS 2 Jazzy has NumPy 1.26")

BAND = (0.3, 30.0)


@pytest.mark.parametrize("states", [6, 8, 12])
def test_slicot_finds_the_same_reduced_model(rig, states):
    whole = rig.model
    ours = balanced_truncation(whole, states, typical_scales(whole, BAND, INTENSITY))
    # SLICOT gets states of one size, ours finds them
    _, (size, _) = linalg.matrix_balance(whole.a, permute=False, separate=True)
    whole = replace(whole, a=whole.a * size / size[:, None], b=whole.b / size[:, None], c=whole.c * size)
    scales = typical_scales(whole, BAND, INTENSITY)
    b, c = whole.b * scales.inputs, whole.c / scales.outputs[:, None]
    inputs, outputs = len(whole.inputs), len(whole.outputs)
    matrices = (np.array(matrix, order="F") for matrix in (whole.a, b, c))
    a, b, c, hankel, *_, failed = ctrlsys.ab09ad(
        "C", "B", "N", "F", whole.order, inputs, outputs, states, *matrices, 0.0
    )
    assert not failed
    # in arrays of the whole model's size
    a, b, c = a[:states, :states], b[:states], c[:, :states]
    np.testing.assert_allclose(ours.hankel_singular_values[: states + 2], hankel[: states + 2], rtol=1e-6)
    omega = 2 * np.pi * np.geomspace(*BAND, 200)
    pencil = 1j * omega[:, None, None] * np.eye(states) - a
    response = c @ np.linalg.solve(pencil, np.broadcast_to(b.astype(complex), (len(omega), *b.shape)))
    expected = response * scales.outputs[:, None] / scales.inputs
    delays = np.exp(-1j * omega[:, None, None] * np.array(whole.input_delay))
    found = ours.model.frequency_response(omega) / delays - whole.d
    difference = np.abs(found - expected).max(axis=0) / np.abs(expected).max(axis=0)
    assert difference.max() < 1e-6
