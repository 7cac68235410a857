# SPDX-License-Identifier: Apache-2.0
"""Weights scaled to a rig from one number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_lqg.analysis.prediction import Excitation, predicted_rms
from abrace_lqg.design import design
from abrace_lqg.loop import sampled
from abrace_lqg.scaling import scaled_weights
from abrace_lqg.weights import Weights, load_weights
from abrace_plant.rig.file import load_rig

SOURCE = Path(__file__).parents[2] / "src"
PERIOD, EXCITATION = 0.002, Excitation()


@pytest.fixture(scope="module")
def five():
    """Five storeys with two unequal brace groups."""
    return load_rig(SOURCE / "abrace_plant/config/five_storey.yaml")


def scaled(rig, **scale):
    half = load_weights(SOURCE / "abrace_lqg/config/half.yaml")
    asked = type(half).model_validate(half.model_dump() | {"scale": scale}) if scale else half
    weights = scaled_weights(rig.model, asked, PERIOD, rig.capacity.tolist(), EXCITATION)
    law = design(rig.model, weights, PERIOD).controller
    plant = sampled(rig.model, PERIOD)
    return weights, predicted_rms(plant, None, EXCITATION), predicted_rms(plant, law, EXCITATION)


def test_displacements_are_halved_where_that_is_asked_for(five):
    weights, without, controlled = scaled(five)
    reductions = [1 - controlled[name] / without[name] for name in ("x1", "x2", "x3", "x4", "x5")]
    assert np.mean(reductions) == pytest.approx(0.5, abs=0.01)
    assert weights.scale is None
    one, other = weights.diagonal(("U1", "U2"))
    assert one / other == pytest.approx(4.0), "a command counts over the square of its force limit"


def test_the_force_that_is_asked_for_is_used_by_the_command_that_needs_most(five):
    _, _, controlled = scaled(five, force=0.2)
    used = [3 * controlled[name] / limit for name, limit in zip(("U1", "U2"), five.capacity, strict=True)]
    assert max(used) == pytest.approx(0.2, rel=0.02)


def test_a_reduction_that_no_weight_gives_is_refused(five):
    with pytest.raises(AbraceError, match=r"scale\.reduction: 0\.99, expected 0\.[0-9]+ at most on this rig"):
        scaled(five, reduction=0.99)


def test_a_reduction_is_that_of_the_accelerations_where_there_are_no_displacements_and_of_nothing_else(five):
    half = load_weights(SOURCE / "abrace_lqg/config/half.yaml")
    accelerations, rest = [f"a{floor}" for floor in range(1, 6)], ["f1", "f2"]
    model, capacity = five.model.select(outputs=[*accelerations, *rest]), five.capacity.tolist()
    weights = scaled_weights(model, half, PERIOD, capacity, EXCITATION)
    plant = sampled(model, PERIOD)
    controlled = predicted_rms(plant, design(model, weights, PERIOD).controller, EXCITATION)
    without = predicted_rms(plant, None, EXCITATION)
    left = np.mean([controlled[name] / without[name] for name in accelerations])
    assert left == pytest.approx(0.5, abs=0.02)
    weighed = half.weights.model_copy(update={"force": 1.0})
    forces = half.model_copy(update={"measured": rest, "weights": weighed})
    with pytest.raises(AbraceError, match=r"no displacements and no accelerations, only f1, f2, expected scale\.force"):
        scaled_weights(model.select(outputs=rest), forces, PERIOD, capacity, EXCITATION)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"relative": {"x6": 2.0}}, r"weights: relative: x6, expected some of x1, "),
        ({"relative": {"U": 2.0}}, r"weights: relative: U, expected some of x1, "),
        ({"relative": {"d1": 2.0}}, r"weights: relative: d1, expected some of x1, "),
        ({"measured": ["a*", "a1"]}, r"weights: measured: a\*, a1, expected each quantity once"),
    ],
)
def test_names_that_the_model_has_not_are_refused(five, change, message):
    half = load_weights(SOURCE / "abrace_lqg/config/half.yaml")
    with pytest.raises(AbraceError, match=message):
        scaled_weights(five.model, half.model_copy(update=change), PERIOD, five.capacity.tolist(), EXCITATION)


def test_each_command_needs_a_force_limit(five):
    half = load_weights(SOURCE / "abrace_lqg/config/half.yaml")
    with pytest.raises(
        AbraceError, match=r"force_limit: \[1000\.0\] N, expected one for each command of the model \(U1, U2"
    ):
        scaled_weights(five.model, half, PERIOD, [1000.0], EXCITATION)


def test_weights_that_are_not_scaled_yet_make_no_controller(five):
    with pytest.raises(AbraceError, match="weights with a scale"):
        design(five.model, load_weights(SOURCE / "abrace_lqg/config/half.yaml"), PERIOD)


@pytest.mark.parametrize("scale", [None, {"force": 0.3}, {"reduction": 0.5}])
def test_a_design_whose_weights_are_all_zero_says_so_also_where_they_are_to_be_scaled(five, scale):
    zero = dict.fromkeys(("displacement", "stroke", "acceleration", "force"), 0.0) | {"command": 1.0}
    content = {"measured": ["a*"], "noise_to_excitation": 0.2, "weights": zero, "scale": scale}
    with pytest.raises(AbraceError, match="all weights but that of the command are zero"):
        design(
            five.model,
            scaled_weights(five.model, Weights.model_validate(content), PERIOD, five.capacity.tolist(), EXCITATION),
            PERIOD,
        )
