# SPDX-License-Identifier: Apache-2.0
"""python-control's StateSpace in the place of a model, in identification."""

from __future__ import annotations

import importlib
import inspect
import pkgutil

import numpy as np
import pytest

import abrace_sysid
from abrace_plant.rig.published import INTENSITY
from abrace_sysid.models.realization import superpose
from abrace_sysid.models.reduction import balanced_truncation, typical_scales

pytest.importorskip("control")


def test_every_public_function_that_takes_a_model_takes_a_system_of_python_control():
    found = []
    for each in pkgutil.walk_packages(abrace_sysid.__path__, "abrace_sysid."):
        if ".node" in each.name:  # ROS
            continue
        module = importlib.import_module(each.name)
        for name, function in inspect.getmembers(module, inspect.isfunction):
            annotations = {key: str(value) for key, value in function.__annotations__.items() if key != "return"}
            if function.__module__ != each.name or name.startswith("_"):
                continue
            if any("LinearModel" in text for text in annotations.values()):
                found.append(name)
                assert hasattr(function, "__wrapped__"), f"{each.name}.{name}: expected @takes_models"
    assert {"balanced_truncation", "superpose", "compare", "sampled_response"} <= set(found)


def test_a_system_is_reduced_and_superposed_as_its_model_is(rig):
    model = rig.model
    scales = typical_scales(model.to_control(), (0.3, 30.0), INTENSITY)
    np.testing.assert_allclose(scales.outputs, typical_scales(model, (0.3, 30.0), INTENSITY).outputs)
    eight, expected = (balanced_truncation(one, 8, scales).model for one in (model.to_control(), model))
    np.testing.assert_allclose(np.sort_complex(eight.poles()), np.sort_complex(expected.poles()), rtol=1e-9)
    twice = superpose([model.to_control(), model], model.inputs, model.outputs)
    np.testing.assert_allclose(twice.d, 2 * model.d)
