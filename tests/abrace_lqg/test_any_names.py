# SPDX-License-Identifier: Apache-2.0
"""A model of measured data goes from design to a target under the names of its file."""

from __future__ import annotations

import zipfile
from dataclasses import replace

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.files.config_file import validated
from abrace_core.model.controller_file import load_controller, save_controller
from abrace_core.model.linear_model import LinearModel
from abrace_lqg.export.c_sources import c_sources
from abrace_lqg.export.fmu import write_fmu
from abrace_lqg.proof.files import table_lines
from abrace_lqg.proof.limits import DesignOptions
from abrace_lqg.proof.proven_design import proven_design
from abrace_lqg.scaling import scaled_weights
from abrace_lqg.weights import Weights, load_weights, save_weights

PERIOD = 0.002
KINDS = {"displacement": 1e8, "stroke": 0.0, "acceleration": 100.0, "force": 0.0, "command": 1.0}
BY_KIND = Weights.model_validate({"measured": ["a1"], "weights": KINDS, "noise_to_excitation": 0.1})
BY_NAME = Weights.model_validate(
    {"measured": ["roof"], "signals": {"tip": 1e8, "roof": 100.0}, "noise_to_excitation": 0.1}
)


def storey() -> LinearModel:
    """One storey of 1800 kg at 2 Hz under the names of a rig, its brace force late by 5 ms: x1 [m] and a1 [m/s^2]."""
    mass, damping, stiffness = 1800.0, 1200.0, 3.0e5
    a = np.array([[0, 1, 0], [-stiffness / mass, -damping / mass, 1 / mass], [0, 0, -200.0]])
    return LinearModel(a, [[0, 0], [-1, 0], [0, 200.0]], [[1, 0, 0], a[1]], np.zeros((2, 2)), ("w", "U"), ("x1", "a1"))


def measured() -> LinearModel:
    """The same as data of a laboratory give it: other names, order and units, and an input and an output more."""
    given = storey()
    b = np.column_stack([given.b[:, 1] * 1e3, np.ones(3), given.b[:, 0]])
    c = np.vstack([given.c[1] / 9.80665, given.c[0] * 1e3, np.ones(3)])
    units = {"shaker": "kN", "base": "m/s^2", "tip": "mm", "roof": "g", "bridge": "V"}
    return LinearModel(
        given.a, b, c, np.zeros((3, 3)), ("shaker", "wind", "base"), ("roof", "tip", "bridge"), units=units
    )


def designed(model: LinearModel, weights: Weights, **options: object):
    given = DesignOptions.of({"sample_period": PERIOD, "force_limit": [2000.0], **options})
    return proven_design({"model": model}, weights=weights, weights_name="own", options=given)


@pytest.fixture(scope="module")
def by_name():
    return designed(measured(), BY_NAME, commands=["shaker"], disturbance="base")


def test_a_design_by_other_names_and_units_is_that_of_the_same_model_of_a_rig(by_name):
    rig = designed(storey(), BY_KIND)
    law, expected = by_name.controller.law, rig.controller.law
    assert (law.inputs, law.outputs) == (("roof",), ("shaker",))
    omega = np.linspace(0.5, 100.0, 50)
    # the base is held, the table's motion of a rig linear between samples: that changes predictions, not the law
    np.testing.assert_allclose(law.frequency_response(omega), expected.frequency_response(omega), rtol=1e-6)
    np.testing.assert_allclose(by_name.margins.phase_deg, rig.margins.phase_deg, rtol=1e-6)
    np.testing.assert_allclose(by_name.to_pandas().loc["tip"], rig.to_pandas().loc["x1"], rtol=1e-3)


def test_a_model_with_one_input_rejects_a_force_in_the_place_of_its_command():
    quiet = BY_NAME.model_copy(update={"noise_to_excitation": 1e-8})  # of a force of 1 N
    found = designed(measured().select(inputs=["shaker"]), quiet)
    assert found.controller.law.outputs == ("shaker",)
    assert found.proof.excitation.input == "disturbance"
    assert str(found.proof.excitation).startswith("disturbance of 0.25 N rms, flat from 0.3 to 10 Hz")
    assert found.to_pandas().loc["tip", "ratio"] < 0.95


def test_a_command_in_volts_with_a_small_limit_is_designed_and_exported_in_its_unit(by_name):
    # an amplifier of 40 N/V drives the shaker: the same law, its commands in V
    volts = measured()
    volts = replace(volts, b=volts.b * [0.04, 1, 1], units={**volts.units, "shaker": "V"})
    weights = BY_NAME.model_copy(update={"signals": {**BY_NAME.signals, "shaker": 40.0**2}})
    found = designed(volts, weights, commands=["shaker"], disturbance="base", force_limit=[0.2])
    omega = np.linspace(0.5, 100.0, 50)
    expected = by_name.controller.law.frequency_response(omega) / 40.0
    np.testing.assert_allclose(found.controller.law.frequency_response(omega), expected, rtol=1e-6)
    assert found.controller.law.units == {"roof": "m/s^2", "shaker": "V"}
    assert found.controller.force_limit.tolist() == [0.2]
    header = c_sources(found.controller, 1e5, 0.5)["constants.h"]
    assert "force[0]  shaker [V]" in header
    assert "/* N */" not in header
    with pytest.raises(AbraceError, match=r"expected the greatest of shaker \[V\], or a rig"):
        designed(volts, weights, commands=["shaker"], disturbance="base", force_limit=())


def test_a_common_delay_of_the_inputs_is_one_of_the_command():
    late = replace(measured(), input_delay=(0.004,) * 3)
    found = designed(late, BY_NAME, commands=["shaker"], disturbance="base")
    alone = replace(measured(), input_delay=(0.004, 0.0, 0.0))
    expected = designed(alone, BY_NAME, commands=["shaker"], disturbance="base")
    np.testing.assert_allclose(found.controller.law.a, expected.controller.law.a, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "design with model: model with inputs shaker, wind, base: expected the name of the disturbance"),
        ({"commands": ["shaker"]}, "expected the name of the disturbance, one of wind, base$"),
        ({"commands": ["piston"]}, "design with model: model has no input piston, it has shaker, wind, base"),
    ],
)
def test_a_design_says_which_name_it_needs(options, message):
    with pytest.raises(AbraceError, match=message.replace("^", r"\^")):
        designed(measured(), BY_NAME, **options)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"signals": {"top": 1.0}}, "weights: signals: top, expected some of roof, tip, bridge, shaker"),
        ({"signals": {"tip": 1.0, "shaker": 0.0}}, "weights: signals.shaker: 0, expected more for a command"),
        ({"measured": ["tap"]}, "weights: measured: tap, expected some of roof, tip, bridge"),
    ],
)
def test_weights_of_names_that_the_model_has_not_are_refused(changes, message):
    with pytest.raises(AbraceError, match=message):
        designed(measured(), BY_NAME.model_copy(update=changes), commands=["shaker"], disturbance="base")


def test_weights_by_name_stand_in_place_of_those_by_kind_and_need_none():
    both = BY_KIND.model_copy(update={"signals": {"a1": 7.0}})
    assert both.diagonal(["x1", "a1", "strain"]).tolist() == [1e8, 7.0, 0.0]
    assert BY_NAME.of_commands(["shaker", "U"]).tolist() == [1.0, 1.0]
    with pytest.raises(AbraceError, match=r"signal 'strain': no weight for it.* or weights by name in signals"):
        BY_KIND.diagonal(["strain"])
    with pytest.raises(AbraceError, match="weights: weights: key is missing"):
        validated({"measured": ["a1"], "noise_to_excitation": 1.0}, Weights, "weights")


def test_weights_by_name_are_scaled_to_a_reduction_and_read_again(tmp_path):
    scaled = Weights.model_validate(
        {"measured": ["roof"], "signals": {"tip": 1.0}, "noise_to_excitation": 0.1, "scale": {"reduction": 0.5}}
    )
    found = designed(measured(), scaled, commands=["shaker"], disturbance="base")
    assert found.to_pandas().loc["tip", "ratio"] == pytest.approx(0.5, abs=0.02)
    options = DesignOptions(commands=["shaker"], disturbance="base", force_limit=[2000.0], sample_period=PERIOD)
    model = options.for_control(measured())
    fixed = scaled_weights(model, scaled, PERIOD, [2000.0], options.excitation(model))
    save_weights(fixed, tmp_path / "scaled.yaml", "a test")
    assert load_weights(tmp_path / "scaled.yaml") == fixed


def test_the_controllers_files_have_names_and_units(by_name, tmp_path):
    for name in ("law.yaml", "law.mat"):
        save_controller(by_name.controller, tmp_path / name)
        law = load_controller(tmp_path / name).law
        assert (law.inputs, law.outputs) == (("roof",), ("shaker",))
        assert law.units == {"roof": "m/s^2", "shaker": "N"}
    header = c_sources(by_name.controller, 1e5, 0.5)["constants.h"]
    assert "measured[0]  roof [m/s^2]" in header
    assert "force[0]  shaker [N]" in header
    write_fmu(by_name.controller, tmp_path / "law.fmu", 1e5, 0.5)
    description = zipfile.ZipFile(tmp_path / "law.fmu").read("modelDescription.xml").decode()
    assert 'name="roof" valueReference="0" causality="input" variability="discrete"><Real unit="m/s^2"' in description
    text = "\n".join(table_lines(by_name.proof))
    assert "rms for a base of 0.25 m/s^2 rms" in text
    assert "tip [m] " in text
    assert "bridge [V] " in text


def test_a_unit_of_a_controllers_file_that_is_none_is_named(by_name, tmp_path):
    path = tmp_path / "law.yaml"
    save_controller(by_name.controller, path)
    path.write_text(path.read_text().replace("roof=m/s^2", "roof"))
    with pytest.raises(AbraceError, match=r"law\.yaml: units: 'roof', expected NAME=UNIT"):
        load_controller(path)
