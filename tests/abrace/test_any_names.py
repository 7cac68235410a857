# SPDX-License-Identifier: Apache-2.0
"""A model of measured data is designed with and simulated under its own names."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import abrace
from abrace import LinearModel
from abrace.interactive.data import IdentifiedData
from abrace_core.model.verdict import Verdict

PERIOD = 0.002
WEIGHTS = {"measured": ["roof"], "signals": {"roof": 1e6}, "noise_to_excitation": 1e-8}
NAMED = {"commands": ["shaker"], "disturbance": "road", "force_limit": [300.0], "sample_period": PERIOD}


def storey(inputs: tuple[str, str], output: str) -> LinearModel:
    """One storey of 1800 kg at 2 Hz, from two forces [N] to its acceleration; the second one is late by 5 ms."""
    mass, damping, stiffness = 1800.0, 1200.0, 3.0e5
    a = np.array([[0, 1, 0], [-stiffness / mass, -damping / mass, 1 / mass], [0, 0, -200.0]])
    return LinearModel(a, [[0, 0], [1 / mass, 0], [0, 200.0]], [a[1]], [[1 / mass, 0]], inputs, (output,))


def measured() -> LinearModel:
    """As data give it: the shaker first, in kN, and roof in g."""
    model = storey(("road", "shaker"), "roof").select(inputs=["shaker", "road"])
    units = {"shaker": "kN", "road": "N", "roof": "g"}
    return replace(model, b=model.b * [1e3, 1], c=model.c / 9.80665, d=model.d / 9.80665 * [1e3, 1], units=units)


@pytest.fixture(scope="module")
def designed():
    return abrace.design(measured(), WEIGHTS, **NAMED)


@pytest.fixture(scope="module")
def push():
    return 500.0 * np.random.default_rng(2).standard_normal(4000)


def test_a_closed_loop_is_simulated_under_the_names_of_the_model(designed, push, recwarn):
    run = abrace.simulate(measured(), push, controller=designed)
    assert not recwarn.list
    assert (run.names, run.command_names, run.disturbance) == (("roof",), ("shaker",), "road")
    assert repr(run) == "<Run model/motion: 8 s at 500 Hz, road, shaker to roof>"
    assert list(run.to_pandas().columns) == ["roof", "shaker", "road"]
    assert run.to_pandas().attrs["units"] == {"roof": "m/s^2", "shaker": "N", "road": "N"}
    np.testing.assert_array_equal(run["road"], push)
    # the same structure and law step by step, by hand
    plant, law = abrace.discretize(storey(("road", "shaker"), "roof"), PERIOD, {}), designed.controller.law
    x, q, force, until = np.zeros(plant.order), np.zeros(law.order), np.zeros(1), np.zeros(1)
    for k in range(300):
        y = plant.c @ x + plant.d @ [push[k], force[0]]
        assert run["roof"][k] == pytest.approx(y[0], rel=1e-6, abs=1e-9)
        assert run["shaker"][k] == pytest.approx(until[0], rel=1e-6, abs=1e-6)
        wanted = law.c @ q + law.d @ y
        limited = np.clip(wanted, -300.0, 300.0)
        x = plant.a @ x + plant.b @ [push[k], force[0]]
        q, until, force = law.a @ q + law.b @ y + designed.controller.correction @ (limited - wanted), force, limited
    assert np.abs(run["shaker"]).max() > 10.0
    free = abrace.simulate(measured(), push, disturbance="road", sample_period=PERIOD)
    assert run["roof"].std() < 0.95 * free["roof"].std()
    assert run.plot().axes[0].get_ylabel().endswith("[m/s²]")


def test_a_simulated_run_is_a_test_for_identification_again(push):
    test = abrace.Test.of(abrace.simulate(measured(), push, disturbance="road", sample_period=PERIOD)[1.0:7.0])
    assert (test.inputs, test.names, test.hold, test.floors) == (("road", "shaker"), ("roof",), "zero", 0)
    assert test.units == {"roof": "m/s^2", "shaker": "N", "road": "N"}


def test_the_only_input_is_command_and_place_of_the_disturbance(push):
    alone = measured().select(inputs=["shaker"])
    run = abrace.simulate(alone, push, command=2 * push, sample_period=PERIOD)
    together = abrace.simulate(alone, 3 * push, sample_period=PERIOD)
    np.testing.assert_allclose(run["roof"], together["roof"], rtol=1e-9, atol=1e-12)
    assert run.disturbance == "disturbance"


def test_a_model_of_data_with_a_rigs_names_has_its_own_channels_and_no_warning(push, recwarn):
    model = replace(storey(("w", "U"), "a1"), provenance={"data": "test.csv", "sample_period": PERIOD})
    run = abrace.simulate(model, 0.001 * push)
    assert not recwarn.list
    assert (run.names, run.disturbance, run.sample_period) == (("a1",), "w", PERIOD)
    of_rig = replace(model, provenance={"sample_period": PERIOD})
    with pytest.warns(UserWarning, match="the model has no x1, xf, f"):
        expected = abrace.simulate(of_rig, 0.001 * push)
    np.testing.assert_array_equal(run["a1"], expected["a1"])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"record": "el_centro"}, r"expected the name of the disturbance, one of shaker, road"),
        (
            {"record": "el_centro", "disturbance": "road"},
            r"record of an acceleration for road \[N\], expected \(samples,\) in N",
        ),
        ({"record": np.ones(9), "disturbance": "rod"}, "model has no input rod, it has shaker, road"),
    ],
)
def test_what_cannot_drive_a_model_is_refused(given, message):
    with pytest.raises(abrace.AbraceError, match=message):
        abrace.simulate(measured(), **given, sample_period=PERIOD)


def test_a_rig_is_moved_by_its_table():
    with pytest.raises(abrace.AbraceError, match="disturbance 'U' of a rig"):
        abrace.simulate("ncree_three_storey", "el_centro", disturbance="U")


def test_a_design_takes_an_identification_of_data_and_heeds_its_verdict(designed):
    def identified(verdict: Verdict) -> IdentifiedData:
        judged = SimpleNamespace(validity=SimpleNamespace(verdict=verdict, causes=("spikes",)))
        return IdentifiedData(SimpleNamespace(model=measured()), (), judged)

    again = abrace.design(identified(Verdict.TRUST), WEIGHTS, **NAMED)
    np.testing.assert_array_equal(again.controller.law.a, designed.controller.law.a)
    with pytest.raises(abrace.AbraceError, match=r"the identification says don't trust \(spikes\)"):
        abrace.design(identified(Verdict.DONT), WEIGHTS, **NAMED)


def test_margins_and_design_take_the_folder_of_an_identification_of_data(designed, tmp_path):
    abrace.save_model(measured(), tmp_path / "model.json")
    again = abrace.design(tmp_path, WEIGHTS, **NAMED)
    np.testing.assert_array_equal(again.controller.law.a, designed.controller.law.a)
    assert abrace.margins(tmp_path, again) == designed.margins
    (tmp_path / "validity.json").write_text('{"verdict": "don\'t trust", "causes": ["spikes"]}')
    with pytest.raises(abrace.AbraceError, match=r"validity.json says don't trust \(spikes\)"):
        abrace.design(tmp_path, WEIGHTS, **NAMED)
