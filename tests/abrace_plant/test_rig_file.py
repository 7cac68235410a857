# SPDX-License-Identifier: Apache-2.0
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy import linalg

from abrace_core import AbraceError
from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import LinearModel
from abrace_core.model.simulation import simulate
from abrace_plant.records.files import read_record
from abrace_plant.records.options import Treatment
from abrace_plant.records.treatment import prepare
from abrace_plant.rig.building import Building, shear_stiffness
from abrace_plant.rig.file import load_rig, recorded_rig
from abrace_plant.rig.model import Rig

CONFIGURATIONS = Path(__file__).parents[2] / "src/abrace_plant/config"
CONFIGURATION = CONFIGURATIONS / "ncree_three_storey.yaml"
G = 9.80665


def content(name: str = "ncree_three_storey") -> dict[str, Any]:
    """A rig of the folder, without the interlocks that are its own building's."""
    written = yaml.safe_load((CONFIGURATIONS / f"{name}.yaml").read_text())
    del written["interlocks"]
    return written


def read(written: dict[str, Any], folder: Path) -> Rig:
    (folder / "rig.yaml").write_text(yaml.safe_dump(written))
    return load_rig(folder / "rig.yaml")


def refusal(written: dict[str, Any], folder: Path) -> str:
    """The message without the file's name; empty where the rig is accepted."""
    try:
        read(written, folder)
    except AbraceError as error:
        return str(error).removeprefix(f"rig file {folder / 'rig.yaml'}: ")
    return ""


def test_the_papers_rig_is_read_as_its_file_says():
    rig, written = load_rig(CONFIGURATION), content()
    assert (rig.name, rig.sample_rate, rig.floors, rig.groups) == ("ncree_three_storey", 500.0, 3, 1)
    np.testing.assert_allclose(rig.building.masses, np.array([1144.16, 1144.16, 1113.62]) * 9.80665, rtol=1e-6)
    np.testing.assert_array_equal(rig.building.stiffness, written["building"]["stiffness"])
    np.testing.assert_allclose(rig.capacity, [2500 * 9.80665], rtol=1e-9)
    np.testing.assert_array_equal(rig.rate_limit, [2.5e6])
    assert rig.braces[0].actuator.lag == 0.0008
    assert [mode.frequency for mode in rig.local_modes] == [mode["frequency"] for mode in written["local_modes"]]
    assert rig.sensors.force.bits == 16
    assert rig.storey_height == 3.0


JOINT = {"storey": 1, "stiffness": 5e5, "yield_drift": 0.06}


def edited(path: tuple[str | int, ...], value: object, name: str = "ncree_three_storey") -> dict[str, Any]:
    """A rig with one key changed, the paper's unless named; `...` deletes it."""
    written = content(name)
    place: Any = written
    for part in path[:-1]:
        place = place[part]
    if value is ...:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    return written


@pytest.mark.parametrize(
    ("path", "value", "key", "expected"),
    [
        (("colour",), "red", "colour", "unknown key"),
        (("braces", 0, "actuator", "lag"), ..., "braces.0.actuator.lag", "key is missing"),
        (("sample_rate",), 0.0, "sample_rate", "greater than or equal to 20"),
        (("building", "masses", 1), -5.0, "building.masses.1", "greater than 0"),
        (("building", "masses", 1), 1e-300, "building.masses.1", "at least 1e-15"),
        (("building", "stiffness", 1, 1), 1e308, "building.stiffness.1.1", "less than or equal to"),
        (("building", "stiffness", 0, 1), 5e6, "building.stiffness", "symmetry"),
        (("building", "damping_ratios"), [0.01], "building.damping_ratios", "one for each of 3 floors"),
        (("braces",), [], "braces", "at least 1"),
        (("braces", 0, "floor"), 4, "braces.0.floor", "a floor from 1 to 3"),
        (("braces", 0, "actuator", "lag"), 0.0, "braces.0.actuator.lag", "greater than or equal to 0.00001"),
        (("table", "dynamics"), {"mass": 27000.0, "frequency": 138.0}, "table.dynamics.damping_ratio", "missing"),
        (("building", "friction"), [100.0, 100.0], "building.friction", "one for each of 3 storeys"),
        (("building", "hysteresis"), [JOINT | {"storey": 4}], "building.hysteresis.0.storey", "from 1 to 3"),
        (
            ("building", "hysteresis"),
            [JOINT, JOINT | {"stiffness": 2.6e6}],
            "building.hysteresis.1.stiffness",
            "positive definite",
        ),
        (
            ("braces", 0, "actuator", "command_limit"),
            25e3,
            "braces.0.actuator.command_limit",
            "at most the capacity, 24516.6 N",
        ),
        (("braces", 0, "actuator", "stall_force"), 2450.0, "braces.0.actuator.stall_force", "times the capacity"),
        (("local_modes", 0, "transverse_share"), [0.5], "local_modes.0.transverse_share", "one for each of 3 floors"),
        (("sensors", "anti_alias"), {"cutoff": 150.0, "order": 11}, "sensors.anti_alias.order", "equal to 10"),
    ],
)
def test_mistake_in_a_rig_file_gives_one_line_that_names_file_key_and_what_was_expected(
    tmp_path, path, value, key, expected
):
    file = tmp_path / "rig.yaml"
    file.write_text(yaml.safe_dump(edited(path, value)))
    with pytest.raises(AbraceError) as caught:
        load_rig(file)
    message = str(caught.value)
    assert message.startswith(f"rig file {file}: {key}: "), message
    assert expected in message
    assert "\n" not in message


# --- the building's alternatives -------------------------------------------------------------------------------------

MODES = {"frequencies": [6.67, 21.8, 37.5], "shapes": [[0.4, 0.8, 1.0], [-1.0, -0.35, 0.8], [0.8, -1.0, 0.4]]}


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"storey_stiffness": [9e6, 8e6, 7e6]}, "building: storey_stiffness and stiffness, expected exactly one of"),
        ({"modes": MODES}, "building: stiffness and modes, expected exactly one of"),
        ({"stiffness": ...}, "building: none of them, expected exactly one of storey_stiffness, stiffness or modes"),
        ({"damping_ratios": ...}, "building: none of them, expected exactly one of damping_ratios or rayleigh"),
        (
            {"rayleigh": {"modes": [1, 2], "damping_ratios": [0.01, 0.01]}},
            "building: damping_ratios and rayleigh, expected exactly one of damping_ratios or rayleigh",
        ),
        (
            {"stiffness": ..., "storey_stiffness": [9e6, 8e6]},
            "building.storey_stiffness: 2 numbers, expected one for each of 3 storeys",
        ),
        (
            {"stiffness": ..., "modes": MODES | {"frequencies": [6.7, 21.8]}},
            "building.modes.frequencies: 2 numbers, expected one for each of 3 modes, as many as floors",
        ),
        (
            {"stiffness": ..., "modes": MODES | {"frequencies": [6.7, 37.5, 21.8]}},
            "building.modes.frequencies: [6.7, 37.5, 21.8], expected frequencies in ascending order",
        ),
        (
            {"stiffness": ..., "modes": MODES | {"shapes": [*MODES["shapes"][:2], [0.8, -1.0]]}},
            "building.modes.shapes.2: 2 numbers, expected one for each of 3 floors",
        ),
        (
            {"stiffness": ..., "modes": MODES | {"shapes": [*MODES["shapes"][:2], [-1.0, -0.4, 0.8]]}},
            "building.modes.shapes: the shapes of modes 2 and 3 are too alike",
        ),
        (
            {"damping_ratios": ..., "rayleigh": {"modes": [1, 4], "damping_ratios": [0.01, 0.01]}},
            "building.rayleigh.modes: [1, 4], expected two different modes from 1 to 3",
        ),
        (
            {"damping_ratios": ..., "rayleigh": {"modes": [1, 2], "damping_ratios": [0.05, 0.001]}},
            "building.rayleigh: mode 3 gets a damping ratio of -",
        ),
        (
            {"stiffness": [[2e6, -1e6, 0.0], [-1e6, 1e6, 0.0], [0.0, 0.0, 0.0]]},
            "building.stiffness: squares of the frequencies 0, ",
        ),
        (
            {"stiffness": [[8e6, -5e6, 1e6], [-5e6, 9e6, -4e6], [1e6, -5e6, 4e6]]},
            "building.stiffness: not symmetric: -4000000 in row 2, column 3, and -5000000 opposite, expected symmetry",
        ),
    ],
)
def test_mistake_in_the_building_is_told_with_its_key(tmp_path, changes, expected):
    written = content()
    for key, value in changes.items():
        if value is ...:
            del written["building"][key]
        else:
            written["building"][key] = value
    message = refusal(written, tmp_path)
    assert message.startswith(expected), message
    assert "\n" not in message


def test_a_building_is_the_same_in_each_of_its_three_forms(tmp_path):
    storeys, ratios = [9e6, 8e6, 7e6], [0.01, 0.012, 0.014]
    stiffness = shear_stiffness(np.array(storeys))
    masses = np.array(content()["building"]["masses"])
    frequencies, shapes = Building(masses, stiffness, stiffness).modes()
    forms = (
        {"storey_stiffness": storeys},
        {"stiffness": stiffness.tolist()},
        {"modes": {"frequencies": frequencies.tolist(), "shapes": shapes.T.tolist()}},
    )
    for form in forms:
        written = content()
        del written["building"]["stiffness"]
        written["building"] |= form | {"damping_ratios": ratios}
        found = read(written, tmp_path).building
        np.testing.assert_allclose(found.stiffness, stiffness, atol=1e-9 * 9e6)
        np.testing.assert_allclose(found.damping_ratios, ratios, rtol=1e-9)


@pytest.mark.parametrize(
    ("path", "value", "expected"),
    [
        (("sample_rate",), 42.0, "sample_rate: 42 Hz, expected more than 42.99"),
        (("local_modes", 1, "frequency"), 1600.0, "sample_rate: 500 Hz, expected more than 509.296"),
    ],
)
def test_sample_rate_below_twice_the_fastest_mode_is_refused(tmp_path, path, value, expected):
    message = refusal(edited(path, value), tmp_path)
    assert message.startswith(expected)
    assert "twice the frequency of local_modes." in message


def test_sample_rate_counts_the_stiffeners_too(tmp_path):
    written = edited(("braces", 0, "stiffener_stiffness"), 1.2e8)
    del written["local_modes"]
    written["sample_rate"] = 32.0
    assert "twice the frequency of mode 3 of the building with its stiffeners" in refusal(written, tmp_path)


# --- what is not linear ----------------------------------------------------------------------------------------------


def test_weight_lowers_the_frequencies_and_is_refused_where_measured_ones_are_given_or_where_it_buckles(tmp_path):
    plain, heavy = read(content(), tmp_path), read(edited(("building", "p_delta"), True), tmp_path)
    assert (heavy.building.modes()[0] < 0.999 * plain.building.modes()[0]).all()
    np.testing.assert_allclose(heavy.building.damping_ratios, plain.building.damping_ratios, rtol=1e-6)
    single = edited(("building", "p_delta"), True, "single_storey")
    assert "expected false: measured frequencies are those under the weight" in refusal(single, tmp_path)
    soft = content()
    soft["building"]["stiffness"] = (0.02 * np.array(soft["building"]["stiffness"])).tolist()
    soft["building"]["p_delta"] = True
    assert refusal(soft, tmp_path).startswith("building.p_delta: squares of the frequencies -")


def test_backlash_needs_oil_of_some_stiffness(tmp_path):
    written = edited(("braces", 0, "backlash"), 1e-4)
    written["braces"][0]["actuator"]["velocity_feedback"] = 0.0
    assert refusal(written, tmp_path).startswith("braces.0.backlash: 0.0001 m, expected 0 if")


# --- the files of the folder -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "floors", "groups", "on"),
    [
        ("ncree_three_storey", 3, 1, [1]),
        ("five_storey", 5, 2, [1, 3]),
        ("ten_storey", 10, 4, [1, 3, 5, 8]),
        ("single_storey", 1, 1, [1]),
    ],
)
def test_rigs_of_the_folder_survive_a_tenth_of_g_of_el_centro_and_can_be_controlled(name, floors, groups, on):
    rig = load_rig(CONFIGURATIONS / f"{name}.yaml")
    assert (rig.name, rig.floors, rig.groups, rig.sample_rate) == (name, floors, groups, 500.0)
    assert [group.floor for group in rig.braces] == on
    model = rig.model
    assert model.is_stable()
    ground = prepare(read_record("el_centro"), rig.sample_rate, Treatment(peak_acceleration=0.1 * G))
    still = simulate(rig.discrete_model(), np.column_stack([ground, np.zeros((len(ground), groups))]))
    greatest = np.append(np.abs(still).max(axis=0), np.abs(ground).max())
    ranges = [sensor.range for sensor in rig.sensors.channels(floors, groups, groups)]
    assert (1.2 * greatest < ranges).all(), "none is clipped"
    assert (greatest > 0.01 * np.array(ranges)).all(), "nor lost in the noise"
    limits = [group.actuator.stroke_limit for group in rig.braces]
    assert (greatest[floors : floors + groups] < limits).all()

    # a state feedback that weighs the displacements, from the true state
    x, commands = model.c[:floors], model.b[:, 1:]
    price = np.diag(1e-3 / rig.capacity**2)
    riccati = linalg.solve_continuous_are(model.a, commands, x.T @ x, price)
    gain = np.linalg.solve(price, commands.T @ riccati)
    closed = LinearModel(
        model.a - commands @ gain,
        model.b[:, :1],
        np.vstack([x, -gain]),
        np.zeros((floors + groups, 1)),
        ("w",),
        tuple(f"s{i}" for i in range(floors + groups)),
    )
    moved = np.abs(simulate(discretize(closed, 1 / rig.sample_rate), ground[:, None])).max(axis=0)
    assert moved[floors - 1] < 0.65 * greatest[floors - 1], "the roof moves much less"
    assert (moved[floors:] < rig.capacity).all(), "within the actuators' capacity"


# --- any rig ---------------------------------------------------------------------------------------------------------


def test_each_storey_may_have_its_height_by_which_the_weight_takes_from_its_stiffness(tmp_path):
    written = content()
    written["building"] |= {"storey_height": ["4 m", 3.0, 2.5], "p_delta": True}
    rig, straight = read(written, tmp_path), load_rig(CONFIGURATION)
    assert rig.storey_heights.tolist() == [4.0, 3.0, 2.5]
    assert rig.storey_height == pytest.approx(9.5 / 3)
    # W/h of the top storey, whose weight is that of the top floor
    lost = straight.building.stiffness - rig.building.stiffness
    assert lost[2, 2] == pytest.approx(9.80665 * rig.building.masses[2] / 2.5)
    written["building"]["storey_height"] = [4.0, 3.0]
    assert refusal(written, tmp_path) == "building.storey_height: 2 numbers, expected one for each of 3 storeys"


def test_the_rig_of_a_bag_is_that_of_its_facts():
    assert recorded_rig({"rig": "real"}) is None
    found = recorded_rig({"rig_file": CONFIGURATION.read_text()})
    assert found is not None
    assert found.name == "ncree_three_storey"
