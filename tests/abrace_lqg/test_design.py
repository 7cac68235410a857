# SPDX-License-Identifier: Apache-2.0
"""LQG design: delays, discretisation and the closed loop against closed forms; refusals."""

from __future__ import annotations

from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import LinearModel
from abrace_lqg.analysis.margins import margins
from abrace_lqg.design import delayed, design
from abrace_lqg.proof.limits import OBJECTIONS, DesignOptions
from abrace_lqg.proof.proven_design import proven_design
from abrace_lqg.weights import Weights, load_weights

PERIOD = 0.002


def storey(displacement_unit: float = 1.0, delay: float = 0.0) -> LinearModel:
    """One floor of 1000 kg at 2 Hz pushed by U: outputs x1 and the absolute acceleration a1."""
    mass, omega, zeta = 1000.0, 4 * np.pi, 0.01
    a = np.array([[0.0, displacement_unit], [-(omega**2) / displacement_unit, -2 * zeta * omega]])
    b = np.array([[0.0, 0.0], [-1.0, 1 / mass]])
    c = np.array([[1 / displacement_unit, 0.0], [-(omega**2) / displacement_unit, -2 * zeta * omega]])
    d = np.array([[0.0, 0.0], [0.0, 1 / mass]])
    return LinearModel(a, b, c, d, ("w", "U"), ("x1", "a1"), input_delay=(0.0, delay))


def weights(**changes: float) -> Weights:
    kinds = {"displacement": 1e10, "stroke": 0.0, "acceleration": 1e6, "force": 0.0, "command": 1.0} | changes
    return Weights.model_validate({"measured": ["a1"], "weights": kinds, "noise_to_excitation": 0.1})


def test_a_delayed_command_has_unit_gain_and_the_whole_delays_phase():
    model = storey(delay=0.0008)
    omega = np.linspace(1, 2 * np.pi * 30, 200)
    ratio = delayed(model, PERIOD, PERIOD).frequency_response(omega) / replace(
        model, input_delay=(0, 0)
    ).frequency_response(omega)
    np.testing.assert_allclose(ratio[:, :, 1], np.tile(np.exp(-1j * omega * 0.0038)[:, None], 2), atol=5e-4)
    np.testing.assert_allclose(np.abs(ratio[:, :, 1]), 1, rtol=1e-9)
    np.testing.assert_allclose(ratio[:, 0, 0], 1, rtol=1e-9)


def test_the_delay_of_the_design_model_is_that_from_sample_to_effect():
    # a command from sample k, in force from k+1 to k+2: computation and hold, observed at the sampling instants
    model = storey(delay=0.0008)
    held = discretize(model, PERIOD)
    omega = np.linspace(1, 60, 50)
    true = held.frequency_response(omega)[:, 0, 1] * np.exp(-1j * omega * PERIOD)
    np.testing.assert_allclose(delayed(model, PERIOD, PERIOD).frequency_response(omega)[:, 0, 1] / true, 1, atol=2e-3)


def test_eq_12_is_the_filter_with_its_own_command_as_input():
    result = design(storey(), weights(), PERIOD)
    model, k, filter_gain = result.design_model, result.regulator_gain, result.filter_gain
    c, d = model.c[[1]], model.d[[1], 1:]
    expected = model.a - model.b[:, 1:] @ k - filter_gain @ (c - d @ k)
    np.testing.assert_allclose(result.continuous.a, expected, rtol=1e-12)
    np.testing.assert_array_equal(result.continuous.c, -k)
    assert not result.continuous.d.any()


def test_the_discrete_controller_answers_as_the_continuous_one_below_10_hz():
    result = design(storey(delay=0.0008), weights(), PERIOD)
    omega = np.linspace(0.1, 2 * np.pi * 10, 500)
    discrete = result.controller.frequency_response(omega)[:, 0, 0]
    continuous = result.continuous.frequency_response(omega)[:, 0, 0]
    assert np.abs(discrete - continuous).max() < 2e-3 * np.abs(continuous).max()
    warped = np.tan(omega * PERIOD / 2) * 2 / PERIOD
    np.testing.assert_allclose(discrete, result.continuous.frequency_response(warped)[:, 0, 0], rtol=1e-9)


def test_the_units_of_the_states_do_not_matter():
    plain = design(storey(), weights(), PERIOD).controller
    odd = design(storey(displacement_unit=1e9), weights(), PERIOD).controller
    omega = np.geomspace(0.1, 1000, 200)
    np.testing.assert_allclose(odd.frequency_response(omega), plain.frequency_response(omega), rtol=1e-8)


def in_g_mm_and_kn() -> LinearModel:
    """`storey`, its ground motion and acceleration in g, its displacement in mm, its command in kN, as it states."""
    model = storey()
    into, out_of = np.array([9.80665, 1000.0]), np.array([1000.0, 1 / 9.80665])
    scaled = {"b": model.b * into, "c": model.c * out_of[:, None], "d": model.d * into * out_of[:, None]}
    return replace(model, **scaled, units={"w": "g", "U": "kN", "x1": "mm", "a1": "g"})


def test_a_model_in_g_mm_and_kn_gives_the_controller_of_the_model_in_si_units():
    expected, found = (design(model, weights(), PERIOD).controller for model in (storey(), in_g_mm_and_kn()))
    omega = np.linspace(1, 100, 50)
    np.testing.assert_allclose(found.frequency_response(omega), expected.frequency_response(omega), rtol=1e-6)
    assert found.units == {}, "the law takes and gives SI units"
    true, converted = (margins(model, found) for model in (storey(), in_g_mm_and_kn()))
    np.testing.assert_allclose(astuple(converted), astuple(true), rtol=1e-6)


def test_weights_with_a_scale_and_a_proof_take_a_model_in_other_units():
    loaded = load_weights(Path(__file__).parents[2] / "src/abrace_lqg/config/half.yaml")
    options = DesignOptions(sample_period=PERIOD, force_limit=(2000.0,), accept=tuple(OBJECTIONS))
    expected, found = (
        proven_design({"model": model}, weights=loaded, weights_name="half", options=options)
        for model in (storey(), in_g_mm_and_kn())
    )
    assert found.margins.gain_db == pytest.approx(expected.margins.gain_db, rel=1e-4)
    assert found.proof.models[0].prediction["x1"] == pytest.approx(expected.proof.models[0].prediction["x1"], rel=1e-4)


def test_a_command_in_volts_is_refused_by_design_and_margins():
    model = replace(storey(), units={"U": "V"})
    for refused in (
        lambda: design(model, weights(), PERIOD),
        lambda: margins(model, design(storey(), weights(), PERIOD).controller),
    ):
        with pytest.raises(AbraceError, match="model input U in 'V': expected N, or a unit that converts to it"):
            refused()


def test_the_controller_carries_names_period_and_provenance():
    controller = design(replace(storey(), provenance={"rig": "one storey"}), weights(), PERIOD).controller
    assert (controller.inputs, controller.outputs, controller.sample_period) == (("a1",), ("U",), PERIOD)
    assert controller.provenance["model"] == {"rig": "one storey"}
    assert controller.provenance["weights"] == weights().model_dump()


def test_a_relative_weight_of_a_signal_that_the_model_lacks_is_refused():
    wrong = weights().model_copy(update={"relative": {"a9": 2.0}})
    with pytest.raises(AbraceError, match="weights: relative: a9, expected some of x1, "):
        design(storey(), wrong, PERIOD)


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (discretize(storey(), PERIOD), "continuous"),
        (storey().select(inputs=["w"]), "commands"),
        (storey().select(inputs=["U", "w"]), "inputs U, w"),
        (replace(storey(), input_delay=(0.001, 0.0)), "input w with a delay"),
        (storey().select(outputs=["x1"]), "measured: a1, expected some of x1"),
        (replace(storey(), outputs=("strain", "a1")), "'strain'"),
    ],
)
def test_a_model_that_does_not_fit_is_refused(model: LinearModel, message: str):
    with pytest.raises(AbraceError, match=message):
        design(model, weights(), PERIOD)


def test_a_sample_period_of_zero_is_refused():
    with pytest.raises(AbraceError, match="sample_period"):
        design(storey(), weights(), 0.0)
