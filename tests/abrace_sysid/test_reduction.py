# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.linear_model import LinearModel, pole_table
from abrace_plant.rig.published import INTENSITY
from abrace_sysid.models.reduction import Scales, balanced_truncation, typical_scales
from abrace_sysid.paper import superpose

UNITS = Scales(np.ones(2), np.ones(2))


@pytest.fixture
def model():
    random = np.random.default_rng(1)
    a = np.diag([-1.0, -2.0, -3.0, -5.0, -8.0, -13.0]) + 0.3 * random.standard_normal((6, 6))
    b, c = random.standard_normal((6, 2)), random.standard_normal((2, 6))
    return LinearModel(a, b, c, random.standard_normal((2, 2)), ("w", "U"), ("x1", "a1"), input_delay=(0.0, 0.0008))


def test_error_stays_within_twice_the_sum_of_what_was_cut(model):
    omega = np.concatenate([[0.0], np.geomspace(0.01, 1000, 400)])
    scales = Scales(np.array([0.5, 20.0]), np.array([0.1, 3.0]))
    for states in (1, 2, 3, 4, 5):
        reduction = balanced_truncation(model, states, scales)
        difference = model.frequency_response(omega) - reduction.model.frequency_response(omega)
        scaled = difference * scales.inputs / scales.outputs[:, None]
        bound = 2 * reduction.hankel_singular_values[states:].sum()
        assert np.linalg.norm(scaled, 2, axis=(1, 2)).max() <= bound * (1 + 1e-9)
    assert np.all(np.diff(reduction.hankel_singular_values) <= 0)


def test_names_delays_and_feedthrough_are_kept(model):
    reduced = balanced_truncation(model, 3, UNITS).model
    assert (reduced.inputs, reduced.outputs, reduced.input_delay) == (model.inputs, model.outputs, (0.0, 0.0008))
    assert np.array_equal(reduced.d, model.d)
    assert reduced.order == 3


def test_units_are_kept_by_reduction_and_superposition_and_must_agree(model):
    in_g = replace(model, units={"w": "g", "a1": "g"})
    assert balanced_truncation(in_g, 3, UNITS).model.units == {"w": "g", "a1": "g"}
    assert superpose([in_g, in_g], model.inputs, model.outputs).units == {"w": "g", "a1": "g"}
    with pytest.raises(AbraceError, match="superposition: w in 'g' and in 'SI units'"):
        superpose([in_g, model], model.inputs, model.outputs)


def test_copies_and_hidden_states_are_cut_without_loss(model):
    doubled = superpose([model, model], model.inputs, model.outputs)
    hidden = replace(
        doubled,
        a=np.block([[doubled.a, np.zeros((12, 2))], [np.zeros((2, 12)), -np.eye(2)]]),
        b=np.vstack([doubled.b, np.ones((1, 2)), np.zeros((1, 2))]),
        c=np.hstack([doubled.c, np.zeros((2, 1)), np.ones((2, 1))]),
    )
    reduced = balanced_truncation(hidden, 6, UNITS).model
    omega = np.geomspace(0.1, 100, 50)
    assert np.allclose(reduced.frequency_response(omega), 2 * model.frequency_response(omega), rtol=1e-7, atol=1e-9)
    with pytest.raises(AbraceError, match="to 7 states, expected 1 to 6: no more of them matter"):
        balanced_truncation(hidden, 7, UNITS)


def test_scaling_lets_eight_states_keep_the_building_for_both_inputs(rig):
    true = pole_table(rig.model.poles)[:3]
    reduced = balanced_truncation(rig.model, 8, typical_scales(rig.model, (0.3, 30.0), INTENSITY)).model
    frequencies = [frequency for frequency, _ in pole_table(reduced.poles)[:3]]
    assert np.allclose(frequencies, [frequency for frequency, _ in true], rtol=2e-3)
    omega = np.array([frequency for frequency, _ in true])
    error = np.abs(reduced.frequency_response(omega) / rig.model.frequency_response(omega) - 1)
    assert error[:, [0, 1, 2, 4, 5, 6]].max() < 0.1, error


def test_typical_scales_are_rms_under_banded_noise():
    static = LinearModel(
        np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), [[2.0, 0.0], [3.0, 1e-3]], ("w", "U"), ("x1", "a1")
    )
    scales = typical_scales(static, (0.3, 30.0), INTENSITY)
    assert np.allclose(scales.inputs, [0.02 * 9.80665, 186 * 9.80665])
    assert np.allclose(
        scales.outputs, [2 * scales.inputs[0], np.hypot(3 * scales.inputs[0], 1e-3 * scales.inputs[1])], rtol=1e-3
    )


def test_models_that_cannot_be_balanced_are_refused(model):
    with pytest.raises(AbraceError, match="expected a continuous, stable model"):
        balanced_truncation(replace(model, a=-model.a), 2, UNITS)
    with pytest.raises(AbraceError, match="continuous"):
        balanced_truncation(replace(model, a=0.1 * np.eye(6), sample_period=0.002, input_delay=()), 2, UNITS)
    with pytest.raises(AbraceError, match="to 7 states, expected 1 to 6"):
        balanced_truncation(model, 7, UNITS)
    mute = np.diag([1.0, 0.0])
    silent = replace(model, c=mute @ model.c, d=mute @ model.d)
    with pytest.raises(AbraceError, match="output a1 responds to no input"):
        typical_scales(silent, (0.3, 30.0), INTENSITY)


def test_the_units_of_the_states_do_not_matter(rig, model):
    """The rig's states are metres, newtons and newton seconds; of a balanced model any scales."""
    for one in (rig.model, model):
        scales = typical_scales(one, (0.3, 30.0), INTENSITY)
        least = balanced_truncation(one, 4, scales).hankel_singular_values
        for seed in range(3):
            size = 10.0 ** np.random.default_rng(seed).uniform(-6, 6, one.order)
            other = replace(one, a=one.a * size / size[:, None], b=one.b / size[:, None], c=one.c * size)
            found = balanced_truncation(other, 4, scales).hankel_singular_values
            np.testing.assert_allclose(found[:10], least[:10], rtol=1e-6)
