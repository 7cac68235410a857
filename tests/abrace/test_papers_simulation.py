# SPDX-License-Identifier: Apache-2.0
"""The paper's own simulation: rigs with the printed poles, their superposition, and how little those poles explain."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import papers_simulation as paper
import pytest

from abrace_core.linear_model import LinearModel, pole_table
from abrace_core.response import TABLE_1_SIMULATION, PeakRms, mean_relative_error
from abrace_lqg.design import design
from abrace_lqg.weights import load_weights
from abrace_plant.rig.file import load_rig

SOURCES = Path(__file__).parents[2] / "src"


@pytest.fixture(scope="module")
def controller() -> LinearModel:
    rig = load_rig(SOURCES / "abrace_plant/config/ncree_three_storey.yaml")
    return design(rig.model, load_weights(SOURCES / "abrace_lqg/config/lqg3.yaml"), 0.002).controller


@pytest.fixture(scope="module")
def test_day(controller: LinearModel) -> paper.Test:
    return paper.Test.under(controller)


def test_the_two_rigs_have_the_printed_poles_and_stay_near_the_standing_one(test_day: paper.Test):
    standing = test_day.rig.building.modes()[0]
    for rig, test in ((test_day.table, "table"), (test_day.command, "command")):
        found = np.array(pole_table(rig.model.poles())[:3])
        np.testing.assert_allclose(found, paper.printed(test), rtol=1e-5)
        np.testing.assert_allclose(rig.building.modes()[0], standing, rtol=0.03)
        assert rig.building.damping_ratios.min() > 0


def test_the_superposition_has_the_papers_24_states_with_the_poles_of_a1_and_a2(test_day: paper.Test):
    model = paper.superposition(test_day.table, test_day.command)
    assert model.order == 24
    found = sorted(pole_table(model.poles()))
    of_command = pole_table(test_day.command.model.poles())[:6]
    expected = sorted([*paper.printed("table"), *of_command, *of_command[:3]])
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_one_rig_superposed_with_itself_is_that_rig(test_day: paper.Test):
    exact, _ = test_day.run(test_day.table.model)
    again, _ = test_day.run(paper.exact_superposition(test_day.table, test_day.table))
    np.testing.assert_allclose(again, exact, atol=1e-8 * np.abs(exact).max(axis=0).min())


def test_other_poles_of_the_command_part_are_those_asked_for(test_day: paper.Test):
    model = paper.superposition(test_day.table, test_day.table)
    moved = paper.with_command_poles(model, paper.printed("command"))
    found = sorted(pole_table(moved.poles()))[:9]
    expected = sorted([*paper.printed("table"), *2 * paper.printed("command")])
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_table_part_and_command_part_cancel(test_day: paper.Test):
    model = paper.superposition(test_day.table, test_day.command)
    outputs, _ = test_day.run(model)
    shaken, pushed = test_day.parts(model)
    np.testing.assert_allclose(shaken + pushed, outputs, atol=1e-6 * np.abs(outputs).max(axis=0).min())
    top = model.outputs.index("x3")
    assert np.std(shaken[:, top]) > 3 * np.std(outputs[:, top])


def test_distances_are_those_of_the_cells(controller: LinearModel):
    found = paper.papers_simulation(controller)
    for name, key in (("superposed", "error"), ("consistent", "consistent_error")):
        table = {row: PeakRms(*cell[name]) for row, cell in found["cells"].items()}
        assert found[key] == pytest.approx(mean_relative_error(table, TABLE_1_SIMULATION))
    assert found["cells"]["x3"]["paper"] == [2.652, 0.384]


def test_the_printed_poles_differ_too_little_to_matter(test_day: paper.Test):
    one_day = paper.superposition(test_day.table, test_day.table)
    two_days = paper.superposition(test_day.table, test_day.command)
    assert abs(test_day.error(two_days) - test_day.error(one_day)) < 0.01
    assert test_day.error(paper.detuned(two_days, 0.04)) > test_day.error(two_days) + 0.05
