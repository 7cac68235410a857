# SPDX-License-Identifier: Apache-2.0
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import linalg

from abrace_core.discretization import discretize
from abrace_core.errors import AbraceError
from abrace_core.linear_model import LinearModel
from abrace_core.simulation import simulate
from abrace_plant.records.files import read_record
from abrace_plant.records.treatment import Treatment, prepare
from abrace_plant.rig.building import Building, shear_stiffness
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.model import Rig

CONFIGURATIONS = Path(__file__).parents[2] / "src/abrace_plant/config"
CONFIGURATION = CONFIGURATIONS / "ncree_three_storey.yaml"
G = 9.80665
REPEATED = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
"""For properties of files: every example overwrites the last one's."""


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
    np.testing.assert_array_equal(rig.rate_limit, [5.0e6])
    assert rig.braces[0].actuator.lag == 0.0008
    assert [mode.frequency for mode in rig.local_modes] == [mode["frequency"] for mode in written["local_modes"]]
    assert rig.sensors.force.bits == 16
    assert rig.storey_height == 3.0


def test_rig_of_another_size_is_read(tmp_path):
    written = content()
    stiffness = 1e6 * (4 * np.eye(5) - 2 * np.eye(5, k=1) - 2 * np.eye(5, k=-1))
    written["building"] |= {"masses": [9000.0] * 5, "stiffness": stiffness.tolist(), "damping_ratios": [0.01] * 5}
    written["braces"] = [written["braces"][0], written["braces"][0] | {"floor": 3}]
    del written["local_modes"]
    path = tmp_path / "five.yaml"
    path.write_text(yaml.safe_dump(written))
    rig = load_rig(path)
    assert (rig.floors, rig.groups, rig.local_modes) == (5, 2, ())
    assert rig.model.outputs[5:7] == ("xf1", "xf2")
    assert rig.model.inputs == ("w", "U1", "U2")
    assert rig.model.is_stable()


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
        (("building", "mass"), [1.0], "building.mass", "unknown key"),
        (("braces", 0, "actuator", "gain"), 1.0, "braces.0.actuator.gain", "unknown key"),
        (("name",), ..., "name", "key is missing"),
        (("sensors", "force"), ..., "sensors.force", "key is missing"),
        (("braces", 0, "actuator", "lag"), ..., "braces.0.actuator.lag", "key is missing"),
        (("sample_rate",), 0.0, "sample_rate", "greater than 0"),
        (("sample_rate",), "fast", "sample_rate", "number"),
        (("building", "masses", 1), -5.0, "building.masses.1", "greater than 0"),
        (("building", "masses", 1), 1e300, "building.masses.1", "less than or equal to 1e+15"),
        (("building", "masses", 1), 1e-300, "building.masses.1", "at least 1e-15"),
        (("building", "stiffness", 1, 1), 1e308, "building.stiffness.1.1", "less than or equal to"),
        (("building", "masses", 1), float("nan"), "building.masses.1", "nan"),
        (("building", "masses", 1), float("inf"), "building.masses.1", "finite"),
        (("building", "masses"), [1.0, 1.0], "building.stiffness", "2 rows of 2"),
        (("building", "stiffness", 0), [1.0, 2.0], "building.stiffness", "3 rows of 3"),
        (("building", "stiffness", 0, 1), 5e6, "building.stiffness", "symmetry"),
        (("building", "stiffness", 2, 2), 1.0, "building.stiffness", "positive definite"),
        (("building", "damping_ratios"), [0.01], "building.damping_ratios", "one for each of 3 floors"),
        (("building", "damping_ratios", 0), 1.0, "building.damping_ratios.0", "less than 1"),
        (("building", "damping_ratios", 0), -0.01, "building.damping_ratios.0", "greater than 0"),
        (("braces",), [], "braces", "at least 1"),
        (("braces", 0, "floor"), 4, "braces.0.floor", "a floor from 1 to 3"),
        (("braces", 0, "floor"), 0, "braces.0.floor", "greater than or equal to 1"),
        (("braces", 0, "floor"), 1.5, "braces.0.floor", "a whole number"),
        (("braces", 0, "cosine"), 1.2, "braces.0.cosine", "less than or equal to 1"),
        (("braces", 0, "actuator", "capacity"), -1.0, "braces.0.actuator.capacity", "greater than 0"),
        (("braces", 0, "actuator", "lag"), 0.0, "braces.0.actuator.lag", "greater than 0"),
        (("local_modes", 1, "brace_share"), [0.1, 0.2], "local_modes.1.brace_share", "one for each of 1 brace groups"),
        (
            ("local_modes", 2, "accelerometer_share"),
            [],
            "local_modes.2.accelerometer_share",
            "one for each of 3 floors",
        ),
        (("local_modes", 0, "damping_ratio"), 2.0, "local_modes.0.damping_ratio", "less than 1"),
        (("sensors", "force", "bits"), 64, "sensors.force.bits", "less than or equal to 32"),
        (("sensors", "force", "noise"), -1.0, "sensors.force.noise", "greater than or equal to 0"),
        (("sensors", "stroke", "range"), 0.0, "sensors.stroke.range", "greater than 0"),
        (("sensors", "stroke"), None, "sensors.stroke", ""),
        (("table", "dynamics"), {"mass": 27000.0, "frequency": 138.0}, "table.dynamics.damping_ratio", "missing"),
        (("building", "friction"), [100.0, 100.0], "building.friction", "one for each of 3 storeys"),
        (("building", "friction"), [100.0, -1.0, 0.0], "building.friction.1", "greater than or equal to 0"),
        (("building", "hysteresis"), [JOINT | {"storey": 4}], "building.hysteresis.0.storey", "from 1 to 3"),
        (("building", "hysteresis"), [JOINT | {"beta": 0.4}], "building.hysteresis.0.beta", "or equal to 0.5"),
        (("building", "hysteresis"), [JOINT | {"exponent": 0.5}], "building.hysteresis.0.exponent", "or equal to 1"),
        (
            ("building", "hysteresis"),
            [JOINT, JOINT | {"stiffness": 2.6e6}],
            "building.hysteresis.1.stiffness",
            "positive definite",
        ),
        (("building", "p_delta"), "yes please", "building.p_delta", "true or false"),
        (("braces", 0, "backlash"), -1e-4, "braces.0.backlash", "greater than or equal to 0"),
        (("braces", 0, "actuator", "stall_force"), 0.0, "braces.0.actuator.stall_force", "greater than 0"),
        (
            ("braces", 0, "actuator", "command_limit"),
            25e3,
            "braces.0.actuator.command_limit",
            "at most the capacity, 24516.6 N",
        ),
        (("braces", 0, "actuator", "stall_force"), 2450.0, "braces.0.actuator.stall_force", "times the capacity"),
        (("local_modes", 0, "transverse_share"), [0.5], "local_modes.0.transverse_share", "one for each of 3 floors"),
        (("sensors", "anti_alias"), {"cutoff": 150.0, "order": 11}, "sensors.anti_alias.order", "equal to 10"),
        (("sensors", "cross_axis"), 2.0, "sensors.cross_axis", "less than or equal to 0.2"),
        (("sensors", "force", "hum_frequency"), 100.0, "sensors.force.hum_frequency", "less than or equal to 65"),
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


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (None, "No such file"),
        (b"", "empty, expected keys and values"),
        (b"- 1\n- 2\n", "a list, expected keys and values"),
        (b"name: [1, 2\nsample_rate: 3\n", "not YAML"),
        (b"name: \xff\xfe\n", "not YAML"),
        (b"name: \x00\n", "not YAML"),
    ],
)
def test_file_that_is_no_rig_gives_one_line_that_names_it(tmp_path, text, expected):
    file = tmp_path / "rig.yaml"
    if text is not None:
        file.write_bytes(text)
    with pytest.raises(AbraceError) as caught:
        load_rig(file)
    assert str(caught.value).startswith(f"rig file {file}: ")
    assert expected in str(caught.value)
    assert "\n" not in str(caught.value)


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
        ({"stiffness": ..., "storey_stiffness": [9e6, -8e6, 7e6]}, "building.storey_stiffness.1: -8000000.0, expected"),
        (
            {"stiffness": ..., "modes": MODES | {"frequencies": [6.7, 21.8]}},
            "building.modes.frequencies: 2 numbers, expected one for each of 3 modes, as many as floors",
        ),
        (
            {"stiffness": ..., "modes": MODES | {"frequencies": [6.7, 37.5, 21.8]}},
            "building.modes.frequencies: [6.7, 37.5, 21.8], expected frequencies in ascending order",
        ),
        (
            {"stiffness": ..., "modes": MODES | {"frequencies": [0.0, 21.8, 37.5]}},
            "building.modes.frequencies.0: 0.0, expected",
        ),
        (
            {"stiffness": ..., "modes": MODES | {"shapes": MODES["shapes"][:2]}},
            "building.modes.shapes: 2 shapes, expected one for each of 3 modes",
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
            {"damping_ratios": ..., "rayleigh": {"modes": [2, 2], "damping_ratios": [0.01, 0.01]}},
            "building.rayleigh.modes: [2, 2], expected two different modes from 1 to 3",
        ),
        (
            {"damping_ratios": ..., "rayleigh": {"modes": [1, 2], "damping_ratios": [0.2, 0.9]}},
            "building.rayleigh: mode 3 gets a damping ratio of 1.",
        ),
        (
            {"damping_ratios": ..., "rayleigh": {"modes": [1, 2], "damping_ratios": [0.05, 0.001]}},
            "building.rayleigh: mode 3 gets a damping ratio of -",
        ),
        (
            {"damping_ratios": ..., "rayleigh": {"modes": [1], "damping_ratios": [0.05, 0.001]}},
            "building.rayleigh.modes: [1], expected",
        ),
        ({"masses": []}, "building.masses: [], expected"),
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


def test_the_rig_as_it_is_is_the_papers_while_it_moves_little():
    asis, papers = (load_rig(CONFIGURATIONS / f"{name}.yaml") for name in ("ncree_as_a_rig", "ncree_three_storey"))
    np.testing.assert_allclose(asis.model.a, papers.model.a, rtol=1e-6, atol=1e-6 * np.abs(papers.model.a).max())
    assert asis.table == papers.table
    assert asis.interlocks == papers.interlocks


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


@st.composite
def rigs(draw: st.DrawFn) -> dict[str, Any]:
    """A rig file of 1 to 6 floors, from a table-top model to a full-scale frame."""

    def some(least: float, most: float) -> float:
        """A number in between, every magnitude as likely."""
        return float(least * (most / least) ** draw(st.floats(0.0, 1.0)))

    floors, height = draw(st.integers(1, 6)), some(0.3, 4.0)
    masses = np.array([some(0.5, 2.0) for _ in range(floors)]) * some(50.0, 5000.0) * height**3
    storeys = np.array([some(0.4, 2.5) for _ in range(floors)])
    stiffness = shear_stiffness(storeys)
    form = draw(st.sampled_from(["storey_stiffness", "stiffness", "modes"]))
    if form == "stiffness":
        twist = np.array([[some(0.5, 2.0) for _ in range(floors)] for _ in range(floors)])
        stiffness += 0.1 * twist @ twist.T / floors
    first = 2 * np.pi * some(0.3, min(12.0, 40.0 / floors))
    scale = (first / Building(masses, stiffness, stiffness).modes()[0][0]) ** 2
    storeys, stiffness = scale * storeys, scale * stiffness
    frequencies, shapes = Building(masses, stiffness, stiffness).modes()
    building: dict[str, Any] = {"storey_height": height, "masses": masses.tolist()}
    if form == "storey_stiffness":
        building[form] = storeys.tolist()
    elif form == "stiffness":
        building[form] = ((stiffness + stiffness.T) / 2).tolist()
    else:
        error = [[0.01 * draw(st.floats(-1.0, 1.0)) for _ in range(floors)] for _ in range(floors)]
        building[form] = {
            "frequencies": frequencies.tolist(),
            "shapes": (shapes / np.abs(shapes).max(axis=0) + error).T.tolist(),
        }
    if floors > 1 and draw(st.booleans()):
        modes = draw(st.permutations(range(1, floors + 1)))[:2]
        building["rayleigh"] = {"modes": modes, "damping_ratios": [some(0.001, 0.04)] * 2}
    else:
        building["damping_ratios"] = [some(0.001, 0.1) for _ in range(floors)]

    braces = []
    for _ in range(draw(st.integers(1, 3))):
        count, cosine = draw(st.integers(1, 4)), some(0.4, 1.0)
        capacity = some(0.005, 0.3) * G * float(masses.sum()) / (count * cosine)
        lag, flow, stroke = some(2e-4, 5e-3), some(50.0, 2000.0) * capacity, some(0.005, 0.05) * height
        actuator = {
            "capacity": capacity,
            "rate_limit": some(50.0, 1000.0) * capacity,
            "lag": lag,
            "integral_rate": some(0.1, 3.0) * first,
            "velocity_feedback": draw(st.sampled_from([0.0, flow * lag / some(0.1, 2.0)])),
            "flow_limit": flow,
            "stroke_limit": stroke,
            "stop_stiffness": some(5.0, 500.0) * capacity / stroke,
            "command_delay": draw(st.sampled_from([0.0, 0.0005, 0.003])),
        }
        stiffener = draw(st.sampled_from([0.0, some(0.05, 0.5) * float(storeys.min())]))
        floor = draw(st.integers(1, floors))
        group = {"floor": floor, "count": count, "cosine": cosine, "stiffener_stiffness": stiffener}
        braces.append(group | {"actuator": actuator})
    local = [
        {
            "frequency": some(1.0, 30.0) * first,
            "damping_ratio": some(0.001, 0.1),
            "mass": some(0.01, 1.0) * float(masses.sum()),
            "brace_share": [draw(st.floats(-1.0, 1.0)) for _ in braces],
            "accelerometer_share": [draw(st.floats(-1.0, 1.0)) for _ in range(floors)],
        }
        for _ in range(draw(st.integers(0, 2)))
    ]
    peak, stroke_time = some(3.0, 30.0), some(0.1, 0.4)
    speed, push = peak * some(0.02, 0.3), max(group["actuator"]["capacity"] for group in braces)
    stroke = max(group["actuator"]["stroke_limit"] for group in braces)
    ranges = {
        "displacement": some(0.01, 0.3) * height,
        "stroke": some(0.5, 1.5) * stroke,
        "acceleration": some(0.3, 5.0) * peak,
        "force": some(1.0, 2.0) * push,
        "ground_acceleration": some(0.2, 2.0) * peak,
    }
    return {
        "name": "any",
        "sample_rate": float(np.clip(some(2.0, 20.0) * 2 * (30 * first + 3 * frequencies[-1]) / np.pi, 50.0, 2e4)),
        "table": {
            "peak_acceleration": peak,
            "peak_jerk": some(30.0, 1000.0) * peak,
            "peak_velocity": speed,
            "peak_displacement": float(np.clip(speed * stroke_time, 0.02 * height, 1.5 * height)),
        },
        "building": building,
        "braces": braces,
        "local_modes": local,
        "sensors": {key: {"range": value, "noise": value / 1000, "bits": 16} for key, value in ranges.items()},
    }


@settings(REPEATED, max_examples=120)
@given(written=rigs())
def test_any_valid_rig_file_gives_a_stable_rig_of_its_size(tmp_path, written):
    rig = read(written, tmp_path)
    floors, groups, local = len(written["building"]["masses"]), len(written["braces"]), len(written["local_modes"])
    model = rig.model
    assert (rig.floors, rig.groups, len(rig.local_modes)) == (floors, groups, local)
    assert (len(model.inputs), len(model.outputs)) == (1 + groups, 2 * floors + 2 * groups)
    assert model.order == 2 * (floors + local) + 2 * groups
    braces = sum(group["count"] for group in written["braces"])
    assert len(rig.channel_sensors) == len(rig.channel_names) == len(model.outputs) - groups + braces + 1
    assert len(set(rig.channel_names)) == len(rig.channel_names)
    assert len(rig.capacity) == len(rig.rate_limit) == groups
    poles = model.poles()
    assert (poles.real < -1e-6 * np.abs(poles)).all(), f"undamped: {poles[np.argmax(poles.real / np.abs(poles))]}"
    damping = rig.building.damping
    np.testing.assert_allclose(damping, damping.T, atol=1e-12 * np.abs(damping).max())
    assert np.linalg.eigvalsh(damping)[0] > 0
