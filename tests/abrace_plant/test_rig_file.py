from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from abrace_core.errors import AbraceError
from abrace_plant.rig_file import load_rig

CONFIGURATION = Path(__file__).parents[2] / "src/abrace_plant/config/ncree_three_storey.yaml"


def content() -> dict[str, Any]:
    return yaml.safe_load(CONFIGURATION.read_text())


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


def edited(path: tuple[str | int, ...], value: object) -> dict[str, Any]:
    """The paper's rig with one key changed; `...` deletes it."""
    written = content()
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
        (("braces", 0, "floor"), 1.5, "braces.0.floor", "integer"),
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
        (b"", "expected keys and values, found NoneType"),
        (b"- 1\n- 2\n", "expected keys and values, found list"),
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
