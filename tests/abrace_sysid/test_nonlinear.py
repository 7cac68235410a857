# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest
from laboratory import Laboratory

from abrace_core.linear_model import load_model, pole_table, save_model
from abrace_sysid.fitting.options import IdentificationOptions
from abrace_sysid.identification import identify
from abrace_sysid.nonlinear.elements import Element, Nonlinearity
from abrace_sysid.nonlinear.estimation import find_elements
from abrace_sysid.nonlinear.identified import elements_of_tests
from abrace_sysid.validation import compare


def of_rig(rig, *elements):
    """Elements on the rig's own linear model."""
    building = pole_table(replace(rig, local_modes=()).model.poles())[: rig.floors]
    return Nonlinearity(elements, tuple(rig.building.masses), tuple(frequency for frequency, _ in building))


@pytest.fixture(scope="module")
def worn(rig):
    """The rig with friction in its second storey and backlash in the pins."""
    (group,) = rig.braces
    building = replace(rig.building, friction=(0.0, 50.0, 0.0))
    return replace(rig, building=building, braces=(replace(group, backlash=2e-4),))


def test_elements_are_found_in_newtons_and_predict_a_test_that_was_not_used(rig, worn, controller, tmp_path):
    laboratory = Laboratory(worn, 5)
    ground = laboratory._noise(40, 10.0, 0.25, 77)
    command = laboratory._noise(40, 30.0, 1800.0, 78)
    tests = [
        (laboratory.open_loop("bags/table", ground, 0 * ground), (0.3, 10.0)),
        (laboratory.open_loop("bags/command", 0 * ground, command), (0.3, 30.0)),
    ]
    looked_for = of_rig(rig, *(Element("friction", storey) for storey in (1, 2, 3)), Element("backlash", 1))
    found = find_elements(rig.model, tests, looked_for)
    assert [one.name for one in found.elements] == ["friction 2", "backlash 1"]
    friction, backlash = found.elements
    assert friction.limit == pytest.approx(50.0, rel=0.1)
    (group,) = worn.braces
    assert 2 * backlash.limit == pytest.approx(group.actuator.velocity_feedback * group.backlash, rel=0.15)
    noted = found.noted_in(rig.model)
    save_model(noted, tmp_path / "model.json")
    assert Nonlinearity.of_model(load_model(tmp_path / "model.json")) == found
    assert Nonlinearity.of_model(rig.model) is None
    for run, law in (
        (laboratory.earthquake(controller, 20), controller),
        (laboratory.earthquake(seconds=20), None),
    ):
        linear = compare(run, rig.model, law, rig.capacity).noise_free_error()
        better = compare(run, rig.model, law, rig.capacity, None, found).noise_free_error()
        assert linear["a1"] > 0.03, "friction and backlash were expected to show"
        assert better["a1"] < 0.4 * linear["a1"], (law, linear, better)
        assert better["x3"] < 0.5 * linear["x3"], (law, linear, better)


def test_of_an_identified_model_only_the_friction_that_there_is_is_named(rig):
    laboratory = Laboratory(replace(rig, building=replace(rig.building, friction=(0.0, 50.0, 0.0))), 5)
    ground, command = Laboratory._noise(60, 10.0, 0.25, 77), Laboratory._noise(60, 30.0, 1800.0, 78)
    table = [laboratory.open_loop("bags/table", ground, 0 * ground)]
    found = identify(table, [laboratory.open_loop("bags/command", 0 * ground, command)])
    shown = elements_of_tests(found, IdentificationOptions(), {"friction"})
    assert shown is not None
    (friction,) = shown.elements
    assert friction.name == "friction 2"
    assert friction.limit == pytest.approx(50.0, rel=0.1)
    assert shown.masses == pytest.approx(rig.building.masses, rel=0.02)


def begin_of(run, samples=20_000):
    first = {name: getattr(run, name)[:samples] for name in ("sequence", "outputs", "ground_acceleration", "command")}
    return replace(run, **first)


def test_a_linear_rig_shows_no_element(rig, table_test, command_test):
    kinds = [("friction", 3), ("joints", 3), ("deadband", 1), ("backlash", 1), ("seals", 1)]
    looked_for = of_rig(rig, *(Element(kind, place + 1) for kind, count in kinds for place in range(count)))
    tests = [(begin_of(table_test), (0.3, 10.0)), (begin_of(command_test), (0.3, 30.0))]
    assert find_elements(rig.model, tests, looked_for).elements == ()


def test_without_friction_a_model_moves_as_the_linear_one(rig, laboratory, controller):
    none = of_rig(rig, Element("friction", 1), Element("joints", 2, yield_drift=1.0), Element("deadband", 1))
    for run, law in ((laboratory.earthquake(controller), controller), (laboratory.earthquake(), None)):
        linear, other = (compare(run, rig.model, law, np.array([800.0]), None, each) for each in (None, none))
        assert np.allclose(other.simulated, linear.simulated, atol=1e-9 * np.abs(linear.simulated).max(axis=0))
