# SPDX-License-Identifier: Apache-2.0
"""Frames reduced to modes: the error that is stated, beside the transfer functions of the whole frame."""

from pathlib import Path

import numpy as np
import pytest

from abrace_core.installed import find_file
from abrace_plant.frames.file import FrameBuilding, load_frame
from abrace_plant.frames.model import building_model, modal_building, truncation_error

PAGE = Path(__file__).parents[2] / "docs/benchmarks.md"
FRAMES = ("sac_la_3", "sac_la_9", "sac_la_20")


def frame(name: str) -> FrameBuilding:
    return load_frame(find_file(name, "abrace_plant", "config/frames", ".yaml", "frame"))


def at_rest(building: FrameBuilding) -> np.ndarray:
    """(levels, inputs) displacements under 1 m/s^2 and under 1 N of each storey's device, by the stiffness matrix."""
    structure, levels = building.frame.structure(), len(building.levels)
    of_level = structure.displacements[3 * np.array(building.levels)]
    pushes = (np.eye(levels) - np.eye(levels, k=1)) / building.frames
    loads = np.column_stack([-structure.ground_load, of_level.T @ pushes])
    return of_level @ np.linalg.solve(structure.stiffness, loads)


@pytest.mark.parametrize("name", FRAMES)
@pytest.mark.parametrize("modes", [1, 2, 5])
def test_no_transfer_function_is_off_by_more_than_stated(name, modes):
    building = frame(name)
    levels = len(building.levels)
    devices = [1] * levels
    modes = min(modes, levels - 1)
    error = truncation_error(building, devices, modes)
    omega = np.array([0.01, 0.2, 0.5, 0.8, 0.95]) * error.frequency
    difference = building_model(building, devices).frequency_response(omega)
    difference = np.abs(difference - building_model(building, devices, modes).frequency_response(omega))
    nearness = 1 - (omega / error.frequency)[:, None, None] ** 2
    displacement = error.bound * np.abs(at_rest(building)).max(axis=0) / nearness
    for kind, power in enumerate((0, 1, 2)):
        bound = displacement * omega[:, None, None] ** power
        found = difference[:, kind * levels : (kind + 1) * levels]
        assert np.all(found <= bound * (1 + 1e-6) + 1e-9 * bound.max()), f"{'xva'[kind]}: beyond what is stated"
        assert np.max(found[0] / bound[0]) > 0.99, f"{'xva'[kind]}: nowhere as much as stated"


@pytest.mark.parametrize("name", FRAMES)
def test_displacements_under_a_constant_input_are_off_by_what_is_stated_and_accelerations_not_at_all(name):
    building = frame(name)
    levels, exact = len(building.levels), at_rest(building)
    devices = [1] * levels
    for modes in (1, 2):
        model, error = building_model(building, devices, modes), truncation_error(building, devices, modes)
        found = model.d - model.c @ np.linalg.solve(model.a, model.b)
        off = np.abs(found[:levels] - exact) / np.abs(exact).max(axis=0)
        assert off == pytest.approx(error.static, abs=1e-9)
        assert np.all(error.static <= error.bound)
        expected = np.column_stack([np.ones(levels), np.zeros((levels, levels))])
        assert found[2 * levels : 3 * levels] == pytest.approx(expected, abs=1e-9)


def test_the_first_mode_left_out_is_named_and_with_all_modes_nothing_is_lost():
    building = frame("sac_la_3")
    modal = modal_building(building)
    error = truncation_error(building, modes=2)
    assert error.frequency == modal.frequencies[2]
    assert error.static.shape == (3, 1), "without devices the ground is the only input"
    structure = building.frame.structure()
    assert error.mass == pytest.approx(structure.mass_left_out(structure.truncated(2)), rel=1e-6)
    for modes in (0, len(modal.frequencies)):
        whole = truncation_error(building, (1, 0, 2), modes)
        assert (whole.frequency, whole.mass) == (np.inf, 0.0)
        assert not whole.static.any()
        assert whole.static.shape == (3, 3)


def test_the_page_has_the_20_storey_buildings_numbers():
    building, columns = frame("sac_la_20"), []
    for modes in (5, 10, 20, 30):
        error = truncation_error(building, [1] * 20, modes)
        of_inputs = (error.static[:, :1], error.static[:, 1:], error.bound[:, :1], error.bound[:, 1:])
        percent = [100 * share for share in (error.mass, *(part.max() for part in of_inputs))]
        columns.append([error.frequency / (2 * np.pi), *percent])
    table = PAGE.read_text(encoding="utf-8").partition("| | modes kept: 5 |")[2].partition("\n\n")[0]
    rows = [line.split("|")[2:-1] for line in table.splitlines()[2:]]
    stated = [[float(cell.split()[0]) for cell in row] for row in rows]
    assert np.array(stated) == pytest.approx(np.transpose(columns), rel=0.05)
