# SPDX-License-Identifier: Apache-2.0
"""python-control's StateSpace in the place of a model, in identification."""

from __future__ import annotations

import numpy as np
import pytest

from abrace_plant.rig.published import INTENSITY
from abrace_sysid.models.reduction import balanced_truncation, typical_scales
from abrace_sysid.paper import superpose

pytest.importorskip("control")


def test_a_system_is_reduced_and_superposed_as_its_model_is(rig):
    model = rig.model
    scales = typical_scales(model.to_control(), (0.3, 30.0), INTENSITY)
    np.testing.assert_allclose(scales.outputs, typical_scales(model, (0.3, 30.0), INTENSITY).outputs)
    eight, expected = (balanced_truncation(one, 8, scales).model for one in (model.to_control(), model))
    np.testing.assert_allclose(np.sort_complex(eight.poles), np.sort_complex(expected.poles), rtol=1e-9)
    twice = superpose([model.to_control(), model], model.inputs, model.outputs)
    np.testing.assert_allclose(twice.d, 2 * model.d)
