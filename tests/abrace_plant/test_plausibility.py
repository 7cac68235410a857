# SPDX-License-Identifier: Apache-2.0
"""Which wrong units are detected: what docs/rig.md says about it is checked here, key by key."""

from collections.abc import Iterator
from copy import deepcopy
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from abrace_core.errors import AbraceError
from abrace_plant.rig.file import load_rig

ROOT = Path(__file__).parents[2]
G = 9.80665
FACTORS = (1000.0, 1 / 1000.0, G, 1 / G)
OF_A_FRAME = "sac_la_20"
"""A rig whose building is a frame file's, and whose twenty groups are alike."""
RIGS = {
    path.stem: yaml.safe_load(path.read_text())
    for path in sorted((ROOT / "src/abrace_plant/config").glob("*.yaml"))
    if path.stem != OF_A_FRAME
}
for rig in RIGS.values():
    del rig["interlocks"]  # limits are checked by themselves: test_limits.py
PAPERS = RIGS["ncree_three_storey"]
DIMENSIONLESS = {"count", "floor", "bits", "shapes", "rayleigh.modes", "p_delta", "storey", "exponent", "beta", "order"}
Keys = tuple[str | int, ...]


def refusal(written: dict[str, Any], folder: Path) -> str:
    """The message without the file's name; empty where the rig is accepted."""
    path = folder / "rig.yaml"
    path.write_text(yaml.dump(written, Dumper=yaml.CSafeDumper))
    try:
        load_rig(path)
    except AbraceError as error:
        return str(error).removeprefix(f"rig file {path}: ")
    return ""


def quantities(node: Any, path: Keys = ()) -> Iterator[Keys]:
    """Where a rig file has numbers, or lists of numbers, that may be in a wrong unit."""
    if isinstance(node, dict):
        for key, value in node.items():
            yield from quantities(value, (*path, key))
    elif isinstance(node, list) and isinstance(node[0], dict):
        for i, value in enumerate(node):
            yield from quantities(value, (*path, i))
    elif not isinstance(node, str) and not DIMENSIONLESS & {path[-1], ".".join(map(str, path[-2:]))}:
        yield path


def at(node: Any, path: Keys) -> Any:
    for part in path:
        node = node[part]
    return node


def times(value: Any, factor: float) -> Any:
    return [times(one, factor) for one in value] if isinstance(value, list) else value * factor


def mistaken(written: dict[str, Any], path: Keys, factor: float) -> dict[str, Any]:
    """The rig with one quantity, every number of it where it is a list, multiplied by a factor."""
    changed = deepcopy(written)
    at(changed, path[:-1])[path[-1]] = times(at(written, path), factor)
    return changed


def key_of(path: Keys) -> str:
    return ".".join(str(part) for part in path if not isinstance(part, int))


AS_IT_IS = "ncree_as_a_rig"
KEYS = {key_of(path) for name, written in RIGS.items() if name != AS_IT_IS for path in quantities(written)}
"""Of the other rigs: those that the rig as it is shares with them are theirs."""

# --- a sensible rig is never refused ---------------------------------------------------------------------------------


def similar(length: float, density: float, acceleration: float) -> dict[str, Any]:
    """The paper's rig at another scale of length, of mass for the same volume, and of acceleration."""
    mass, time = density * length**3, (length / acceleration) ** 0.5
    force = mass * acceleration
    scales = {
        "sample_rate": 1 / time,
        "table.peak_acceleration": acceleration,
        "table.peak_jerk": acceleration / time,
        "table.peak_velocity": length / time,
        "table.peak_displacement": length,
        "building.storey_height": length,
        "building.masses": mass,
        "building.stiffness": force / length,
        "braces.stiffener_stiffness": force / length,
        "braces.actuator.capacity": force,
        "braces.actuator.rate_limit": force / time,
        "braces.actuator.lag": time,
        "braces.actuator.integral_rate": 1 / time,
        "braces.actuator.velocity_feedback": force * time / length,
        "braces.actuator.flow_limit": force / time,
        "braces.actuator.stroke_limit": length,
        "braces.actuator.stop_stiffness": force / length,
        "local_modes.frequency": 1 / time,
        "local_modes.mass": mass,
    }
    kinds = {"displacement": length, "stroke": length, "force": force}
    written = deepcopy(PAPERS)
    for path in quantities(PAPERS):
        scale = kinds.get(str(path[1]), acceleration) if path[0] == "sensors" else scales.get(key_of(path), 1.0)
        written = mistaken(written, path, scale)
    return written


SCALES = {"length": st.floats(0.1, 3.0), "density": st.floats(0.15, 10.0), "acceleration": st.floats(0.15, 6.0)}
"""Storeys of 0.3 to 9 m, first frequencies of 0.24 to 8.2 Hz."""
REPEATED = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
"""For properties of files: every example overwrites the last one's."""


@settings(REPEATED, max_examples=80)
@given(**SCALES)
def test_the_papers_rig_at_any_scale_is_accepted(tmp_path, length, density, acceleration):
    assert refusal(similar(length, density, acceleration), tmp_path) == ""


@pytest.mark.parametrize(
    ("masses", "height", "stiffness", "capacity"),
    [
        ([2.0, 2.0, 2.0], 0.3, [2.5e3, 2.5e3, 2.5e3], 8.0),
        ([4e5] * 10, 3.6, [1.2e9, 1.2e9, 1.1e9, 1.1e9, 1e9, 9e8, 8e8, 7e8, 6e8, 4e8], 1e6),
        ([3e4], 3.0, [4.8e4], 5e3),
        ([500.0], 1.0, [4.4e6], 1e3),
        ([2e4, 2e4, 2e4, 2e4], 3.0, [3e5, 6e7, 6e7, 5e7], 3e4),
    ],
    ids=["table-top", "ten storeys", "0.2 Hz", "15 Hz", "base isolated"],
)
def test_sensible_rigs_of_other_kinds_are_accepted(tmp_path, masses, height, stiffness, capacity):
    written = deepcopy(PAPERS)
    del written["local_modes"]
    floors, scale = len(masses), capacity / PAPERS["braces"][0]["actuator"]["capacity"]
    written["sample_rate"] = 1000.0
    written["building"] = {
        "storey_height": height,
        "masses": masses,
        "storey_stiffness": stiffness,
        "damping_ratios": [0.02] * floors,
    }
    written["braces"][0]["stiffener_stiffness"] = 0.1 * stiffness[0]
    for key in ("capacity", "rate_limit", "velocity_feedback", "flow_limit", "stop_stiffness"):
        written["braces"][0]["actuator"][key] *= scale
    for key in ("range", "noise"):
        written["sensors"]["force"][key] *= scale
    assert refusal(written, tmp_path) == ""


# --- and a mistake is detected ------------------------------------------------------------------------------------


def documented() -> dict[str, list[str]]:
    """The table of docs/rig.md: for each key, which factors are detected."""
    table = (ROOT / "docs/rig.md").read_text().partition("| key | times 1000 |")[2].partition("\n\n")[0]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]
    return {key.strip(" `"): verdicts for keys, *verdicts in rows for key in keys.split(",")}


def test_the_page_says_which_mistakes_are_detected_in_the_rigs_of_the_folder(tmp_path):
    detected: dict[str, list[list[bool]]] = {}
    for name, written in RIGS.items():
        for path in quantities(written):
            if name == AS_IT_IS and key_of(path) in KEYS:
                continue
            verdicts = detected.setdefault(key_of(path), [[] for _ in FACTORS])
            for verdict, factor in zip(verdicts, FACTORS, strict=True):
                verdict.append(bool(refusal(mistaken(written, path, factor), tmp_path)))
    words = {
        key: ["yes" if all(each) else "some" if any(each) else "no" for each in verdicts]
        for key, verdicts in detected.items()
    }
    assert documented() == words


@settings(REPEATED, max_examples=8)
@given(**SCALES)
def test_what_is_detected_by_1000_is_detected_at_any_scale(tmp_path, length, density, acceleration):
    written, detected = similar(length, density, acceleration), documented()
    for path in quantities(written):
        for factor, verdict in zip(FACTORS[:2], detected[key_of(path)], strict=False):
            if verdict == "yes":
                assert refusal(mistaken(written, path, factor), tmp_path), f"{key_of(path)} times {factor}"


@pytest.mark.parametrize(
    ("path", "factor", "expected"),
    [
        (("building", "masses"), 1e-3, "building.masses: 11.2204 kg, expected * is it in t (1000 kg)?"),
        (("building", "masses"), 1 / G, "building.masses: 1144.16 kg, expected * is it in kgf s^2/m (9.81 kg)?"),
        (("building", "stiffness"), 1e-3, "building.stiffness: 8415.92 N/m, expected *kN/m (1000 N/m)*"),
        (("building", "stiffness"), 1e-6, "building.stiffness: 8.41592 N/m, expected *kN/mm (1e+06 N/m)*"),
        (("building", "storey_height"), 1e3, "building.storey_height: 3000 m, *; is it in mm (0.001 m)?"),
        (("braces", 0, "actuator", "capacity"), 1e-3, "braces.0.actuator.capacity: 24.5166 N, * is it in kN (1000 N)*"),
        (("braces", 0, "actuator", "capacity"), 1 / G, "braces.0.actuator.capacity: 2500 N, * is it in kgf (9.81 N)*"),
        (("braces", 0, "actuator", "capacity"), 1e3, "braces.0.actuator.capacity: * is it 1000 times too great?"),
        (("braces", 0, "actuator", "lag"), 1e3, "braces.0.actuator.lag: 0.8 s, expected * is it in ms (0.001 s)?"),
        (("braces", 0, "actuator", "stroke_limit"), 1e3, "braces.0.actuator.stroke_limit: 50 m, * mm (0.001 m)?"),
        (("sensors", "acceleration", "range"), 1 / G, "sensors.acceleration.range: 0.61183 m/s^2, * is it in g (9.81*"),
        (
            ("sensors", "force", "range"),
            1e-3,
            "sensors.force.range: 28 N, expected 12300 to 123000 N (0.5 to 5 *",
        ),
        (("sensors", "force", "range"), G, "sensors.force.range: 274586 N, * is it 9.81 times too great?"),
        (("sensors", "displacement", "range"), 1e3, "sensors.displacement.range: 100 m, * or mm (0.001 m)?"),
        (("building", "damping_ratios"), 1e2, "building.damping_ratios.0: 0.799313 of critical, * is it in % (0.01*"),
    ],
)
def test_the_message_names_key_value_range_and_the_likely_unit(tmp_path, path, factor, expected):
    message = refusal(mistaken(PAPERS, path, factor), tmp_path)
    assert fnmatchcase(message, expected), message
    assert "\n" not in message


def test_a_rate_limit_that_is_too_low_to_ramp_the_force_down_is_refused_with_the_least_that_is_not(tmp_path):
    written = deepcopy(PAPERS)
    actuator = written["braces"][0]["actuator"]
    actuator["rate_limit"] = 2.5 * actuator["capacity"]
    assert refusal(written, tmp_path) == (
        "braces.0.actuator.rate_limit: 61291.6 N/s, expected at least 77030 N/s to bring 24516.6 N to zero in 0.5 s"
    )
    actuator["rate_limit"] = 77030.0
    assert refusal(written, tmp_path) == ""


@pytest.mark.parametrize("kind", ["masses", "storey_stiffness"])
@pytest.mark.parametrize("factor", [1e3, 1e-3])
@pytest.mark.parametrize("floor", range(5))
def test_a_single_floor_in_another_unit_is_detected_by_its_own_key(tmp_path, kind, factor, floor):
    written = mistaken(RIGS["five_storey"], ("building", kind, floor), factor)
    assert refusal(written, tmp_path).startswith(f"building.{kind}.{floor}: ")


def test_masses_in_t_and_stiffnesses_in_kilonewtons_are_detected_together(tmp_path):
    written = mistaken(mistaken(PAPERS, ("building", "masses"), 1e-3), ("building", "stiffness"), 1e-3)
    message = refusal(written, tmp_path)
    assert message.startswith("building.masses: 11.2204 kg, expected ")
    assert "t (1000 kg)" in message
