# SPDX-License-Identifier: Apache-2.0
"""python-control's StateSpace in the place of a model: converted with its names, taken by every public function."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from pathlib import Path

import control
import numpy as np
import pytest

import abrace_core
import abrace_lqg
import abrace_sysid
from abrace_core import AbraceError
from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import LinearModel, load_model, save_model
from abrace_core.model.simulation import simulate
from abrace_lqg.analysis.disk_margin import disk_margin
from abrace_lqg.analysis.margins import margins, margins_at
from abrace_lqg.design import ControllerDesign, design
from abrace_lqg.loop import Loop, open_loop, sampled
from abrace_lqg.proof.checks import prove
from abrace_lqg.weights import load_weights
from abrace_plant.rig.file import load_rig

SOURCES = Path(__file__).parents[2] / "src"
PERIOD = 0.002


@pytest.fixture(scope="module")
def rig_model() -> LinearModel:
    return load_rig(SOURCES / "abrace_plant/config/ncree_three_storey.yaml").model


@pytest.fixture(scope="module")
def designed(rig_model: LinearModel) -> ControllerDesign:
    return design(rig_model, load_weights(SOURCES / "abrace_lqg/config/lqg3.yaml"), PERIOD)


def same(one: LinearModel, other: LinearModel) -> bool:
    return all((getattr(one, key) == getattr(other, key)).all() for key in "abcd") and (
        (one.inputs, one.outputs, one.sample_period) == (other.inputs, other.outputs, other.sample_period)
    )


def test_a_model_comes_back_from_python_control_bit_by_bit_with_its_names(rig_model: LinearModel):
    for model in (rig_model, discretize(rig_model, PERIOD)):
        system = model.to_control()
        assert (system.input_labels, system.output_labels) == (["w", "U"], list(rig_model.outputs))
        assert same(LinearModel.from_control(system), model)
    gain = LinearModel.from_control(control.ss([], [], [], [[4.0, 5.0]], 0, inputs=["u", "w"], outputs=["y"]))
    assert (gain.order, gain.d.tolist(), gain.inputs) == (0, [[4.0, 5.0]], ("u", "w"))


def test_a_system_without_a_sample_time_is_refused():
    for dt in (None, True):
        system = control.ss(np.eye(1) / 2, np.eye(1), np.eye(1), np.zeros((1, 1)), dt, name="mine")
        with pytest.raises(AbraceError, match=f"system mine: dt {dt}, expected 0 .continuous. or a sample period"):
            LinearModel.from_control(system)


def test_every_public_function_that_takes_a_model_takes_a_system_of_python_control():
    found = []
    for package in (abrace_core, abrace_sysid, abrace_lqg):
        for each in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if ".node" in each.name:  # ROS
                continue
            module = importlib.import_module(each.name)
            for name, function in inspect.getmembers(module, inspect.isfunction):
                annotations = {k: str(v) for k, v in function.__annotations__.items() if k != "return"}
                if function.__module__ != each.name or name.startswith("_"):
                    continue
                if any("LinearModel" in text for text in annotations.values()):
                    found.append(name)
                    assert hasattr(function, "__wrapped__"), f"{each.name}.{name}: expected @takes_models"
    assert {"design", "simulate", "margins", "prove", "save_model", "balanced_truncation", "compare"} <= set(found)


def test_systems_give_what_models_give(rig_model: LinearModel, designed: ControllerDesign, tmp_path: Path):
    plant, law = rig_model.to_control(), designed.controller.to_control()
    assert same(design(plant, designed.weights, PERIOD).controller, designed.controller)
    assert margins(plant, law) == margins(rig_model, designed.controller)
    assert disk_margin(plant, controller=law) == disk_margin(rig_model, designed.controller)
    assert prove(designed, {"rig": plant}).models[0].poles == prove(designed, {"rig": rig_model}).models[0].poles
    assert same(sampled(plant, PERIOD), discretize(rig_model, PERIOD))
    motion = np.random.default_rng(1).standard_normal((100, 2))
    discrete = discretize(rig_model, PERIOD)
    assert (simulate(discrete.to_control(), motion) == simulate(discrete, motion)).all()
    save_model(plant, tmp_path / "model.json")
    assert same(load_model(tmp_path / "model.json"), rig_model)


@pytest.mark.parametrize("signal", ["U", "a1", "a3"])
def test_python_control_finds_our_margins_on_the_loop_broken_at_a_signal(
    rig_model: LinearModel, designed: ControllerDesign, signal: str
):
    law = designed.controller
    broken = open_loop(rig_model, law, signal)
    assert (broken.inputs, broken.outputs) == ((signal,), (signal,))
    omega = Loop(rig_model, law).frequencies()
    expected = Loop(rig_model, law).transfer_function(signal, omega)
    response = broken.to_control()(np.exp(1j * omega * PERIOD))
    np.testing.assert_allclose(response, expected, rtol=1e-5, atol=1e-8)
    found = margins_at(rig_model, law, [signal])[signal]
    gains, phases, *_ = control.stability_margins(control.frd(response, omega), returnall=True)
    assert np.abs(20 * np.log10(gains)).min() == pytest.approx(found.gain_db, abs=0.02)
    assert np.abs(phases).min(initial=180.0) == pytest.approx(found.phase_deg, abs=0.1)


@pytest.mark.parametrize("signal", ["U1", "U2", "a1", "a3"])
def test_of_several_commands_and_sensors_all_but_one_stay_closed(signal: str):
    model = load_rig(SOURCES / "abrace_plant/config/five_storey.yaml").model
    weights = load_weights(SOURCES / "abrace_lqg/config/lqg3.yaml")
    law = design(model, weights.model_copy(update={"measured": ["a1", "a3", "a5"], "relative": {}}), PERIOD).controller
    omega = np.geomspace(0.5, 300.0, 200)
    found = open_loop(model, law, signal).frequency_response(omega)[:, 0, 0]
    np.testing.assert_allclose(found, Loop(model, law).transfer_function(signal, omega), rtol=1e-5, atol=1e-8)
