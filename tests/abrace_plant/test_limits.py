# SPDX-License-Identifier: Apache-2.0
"""The limits of the interlocks: as the rig file gives them, or from the rig's numbers; and which are refused."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from abrace_core import AbraceError
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.interlocks import Interlocks
from abrace_plant.rig.limits import INTERLOCKS
from abrace_plant.rig.model import Interlock

CONFIGURATIONS = Path(__file__).parents[2] / "src/abrace_plant/config"
RIGS = ("ncree_three_storey", "ncree_as_a_rig", "five_storey", "ten_storey", "single_storey", "sac_la_20")


def content(name: str = "ncree_three_storey") -> dict[str, Any]:
    return yaml.safe_load((CONFIGURATIONS / f"{name}.yaml").read_text())


def table_of(written: dict[str, Any], folder: Path) -> dict[str, Interlock]:
    (folder / "rig.yaml").write_text(yaml.safe_dump(written))
    return Interlocks(load_rig(folder / "rig.yaml")).table


@pytest.mark.parametrize("name", RIGS)
def test_every_rig_of_the_folder_states_every_interlock(name, tmp_path):
    written = content(name)
    assert list(written["interlocks"]) == list(INTERLOCKS)
    for key, interlock in table_of(written, tmp_path).items():
        stated = written["interlocks"][key]
        assert (interlock.time, interlock.action, interlock.reset) == (stated["time"], "stop", "person"), key
        assert interlock.value == stated.get("value", 0.0), key
        assert ("value" in stated) == bool(INTERLOCKS[key][1]), key


def test_the_page_states_the_units_and_limits_of_the_papers_rig():
    page = (CONFIGURATIONS.parents[2] / "docs/rig.md").read_text()
    lines = page.partition("| key | unit |")[2].partition("\n\n")[0].splitlines()[2:]
    rows = [[cell.strip(" `") for cell in line.strip("|").split("|")] for line in lines]
    written = content()["interlocks"]
    assert [row[0] for row in rows] == list(INTERLOCKS)
    for key, unit, _, value, time, _ in rows:
        assert unit.replace("²", "^2") == INTERLOCKS[key][1], key
        assert float(value or 0) == written[key].get("value", 0.0), key
        assert float(time) == written[key]["time"], key


@pytest.mark.parametrize("name", RIGS)
def test_a_rig_without_interlocks_has_them_from_its_own_numbers(name, tmp_path):
    written = content(name)
    stated = written.pop("interlocks")
    table = table_of(written, tmp_path)
    assert list(table) == list(INTERLOCKS)
    for key, interlock in table.items():
        assert interlock.action == "stop"
        if "value" in stated[key]:
            assert stated[key]["value"] / 2 < interlock.value < stated[key]["value"] * 2, key


def test_an_interlock_that_is_left_out_is_derived_and_the_others_are_as_given(tmp_path):
    written = content()
    written["interlocks"] = {"drift": {"value": 0.02, "time": 0.0, "action": "warn"}}
    table = table_of(written, tmp_path)
    assert table["drift"] == Interlock(0.02, 0.0, "warn", "person")
    assert table["stroke"].value == pytest.approx(0.9 * 0.04)


@pytest.mark.parametrize("key", [key for key, (_, unit) in INTERLOCKS.items() if unit and not key.startswith("table_")])
@pytest.mark.parametrize("factor", [1000.0, 0.001])
def test_a_value_in_another_unit_is_refused(key, factor, tmp_path):
    written = content()
    written["interlocks"][key]["value"] *= factor
    if (key, factor) == ("dead", 0.001):
        table_of(written, tmp_path)  # as good as stuck
        return
    with pytest.raises(AbraceError, match=rf"rig file \S+: interlocks\.{key}\.value: \S+ .*, expected "):
        table_of(written, tmp_path)


@pytest.mark.parametrize(
    ("key", "change", "expected"),
    [
        ("drift", {"value": 0.1}, r"interlocks\.drift\.value: 0\.1 m, expected less than 0\.1 m, the displacement"),
        ("stroke", {"value": 0.045}, r"interlocks\.stroke\.value: 0\.045 m, expected less than 0\.04 m, the sensors"),
        ("table_velocity", {"value": 950.0}, r"interlocks\.table_velocity\.value: 950 m/s, expected less than"),
        ("drift", {"time": 10.0}, r"interlocks\.drift\.time: 10\.0, expected .*less than or equal to 2"),
        ("drift", {"action": "off"}, r"interlocks\.drift\.action: 'off', expected 'stop' or 'warn'"),
        ("drift", {"reset": "self"}, r"interlocks\.drift\.reset: 'self', expected 'person'"),
        ("tilt", {"value": 1.0}, r"interlocks\.tilt: unknown key"),
    ],
)
def test_a_wrong_interlock_is_refused_with_its_key(key, change, expected, tmp_path):
    written = content()
    written["interlocks"].setdefault(key, {}).update(change)
    with pytest.raises(AbraceError, match=expected):
        table_of(written, tmp_path)
