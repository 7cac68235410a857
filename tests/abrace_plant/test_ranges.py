# SPDX-License-Identifier: Apache-2.0
"""Wrong factors of 1000 are refused, key by key; numbers may carry their unit."""

from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from abrace_core import AbraceError
from abrace_plant.rig.file import load_rig

ROOT = Path(__file__).parents[2]
FACTORS = (1000.0, 1 / 1000.0)
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
DIMENSIONLESS = {
    "count",
    "floor",
    "bits",
    "shapes",
    "rayleigh.modes",
    "p_delta",
    "storey",
    "exponent",
    "beta",
    "order",
    "channels",
}
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
    elif (not isinstance(node, str) or node[0].isdigit()) and not DIMENSIONLESS & {
        path[-1],
        ".".join(map(str, path[-2:])),
    }:
        yield path


def at(node: Any, path: Keys) -> Any:
    for part in path:
        node = node[part]
    return node


def times(value: Any, factor: float) -> Any:
    if isinstance(value, list):
        return [times(one, factor) for one in value]
    if isinstance(value, str):
        number, unit = value.split(" ", 1)
        return f"{float(number) * factor:.17g} {unit}"
    return value * factor


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


@settings(REPEATED, max_examples=30)
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
        ([3e4, 2e4, 2e4, 2e4], 3.0, [1.43e5, 1.9e8, 1.9e8, 1.9e8], 2e4),
    ],
    ids=["table-top", "ten storeys", "0.2 Hz", "15 Hz", "base isolated", "stiff storeys on isolators"],
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


# --- a wrong factor is refused ---------------------------------------------------------------------------------------


def documented() -> dict[str, list[str]]:
    """For each key, whether 1000 times and a thousandth of it are refused."""
    return {key.strip(): list(verdicts) for verdicts, keys in WRITTEN_BY_HAND.items() for key in keys.split(",")}


WRITTEN_BY_HAND = {
    ("yes", "yes"): """
        sample_rate, table.peak_acceleration, table.peak_jerk, table.peak_velocity, table.peak_displacement,
        building.storey_height, building.masses, building.storey_stiffness, building.rayleigh.damping_ratios,
        braces.cosine, braces.stiffener_stiffness, braces.actuator.capacity, braces.actuator.rate_limit,
        braces.actuator.lag, braces.actuator.integral_rate, braces.actuator.velocity_feedback,
        braces.actuator.flow_limit, braces.actuator.stroke_limit, braces.actuator.stop_stiffness,
        local_modes.frequency, local_modes.mass, sensors.displacement.range, sensors.stroke.range,
        sensors.acceleration.range, sensors.force.range, sensors.ground_acceleration.range,
        table.dynamics.mass, table.dynamics.frequency, table.dynamics.damping_ratio, building.friction,
        building.hysteresis.stiffness, building.hysteresis.yield_drift, braces.actuator.friction,
        braces.actuator.deadband, braces.actuator.stall_force, braces.backlash,
        sensors.displacement.bandwidth, sensors.stroke.bandwidth, sensors.acceleration.bandwidth,
        sensors.force.bandwidth, sensors.ground_acceleration.bandwidth, sensors.anti_alias.cutoff,
        building.stiffness, building.damping_ratios, building.modes.frequencies
    """,
    ("yes", "no"): """
        braces.actuator.command_delay, local_modes.brace_share, local_modes.accelerometer_share,
        sensors.displacement.noise, sensors.stroke.noise, sensors.acceleration.noise, sensors.force.noise,
        sensors.ground_acceleration.noise, local_modes.transverse_share, sensors.stroke.hum,
        sensors.acceleration.hum, sensors.force.hum, sensors.ground_acceleration.hum, sensors.cross_axis
    """,
    ("yes", "some"): """
        local_modes.damping_ratio
    """,
    ("no", "no"): """
        sensors.displacement.hum, sensors.displacement.drift, sensors.stroke.drift, sensors.acceleration.bias,
        sensors.force.drift, sensors.ground_acceleration.bias
    """,
}
"""Keys by whether 1000 times and a thousandth are refused; some: in some of the rigs."""


def test_these_factors_are_refused_in_the_rigs_of_the_folder(tmp_path):
    refused: dict[str, list[list[bool]]] = {}
    for name, written in RIGS.items():
        for path in quantities(written):
            if name == AS_IT_IS and key_of(path) in KEYS:
                continue
            verdicts = refused.setdefault(key_of(path), [[] for _ in FACTORS])
            for verdict, factor in zip(verdicts, FACTORS, strict=True):
                verdict.append(bool(refusal(mistaken(written, path, factor), tmp_path)))
    words = {
        key: ["yes" if all(each) else "some" if any(each) else "no" for each in verdicts]
        for key, verdicts in refused.items()
    }
    assert documented() == words


UNITS = ": a wrong unit? A number may carry its own, such as 24.5 kN"


@pytest.mark.parametrize(
    ("path", "factor", "expected"),
    [
        (("building", "masses"), 1e-3, "building.masses: 0.404 kg/m^3 in a cube as high as the storey, expected 5 to"),
        (("building", "storey_height"), 1e3, "building.storey_height.0: 3000.0, expected less than or equal to 10"),
        (
            ("sensors", "force", "range"),
            1e-3,
            "sensors.force.range: 0.00114 times the greatest capacity, expected 0.5 to 5",
        ),
    ],
)
def test_the_message_names_key_value_and_range_in_one_line(tmp_path, path, factor, expected):
    message = refusal(mistaken(PAPERS, path, factor), tmp_path)
    assert message.startswith(expected), message
    assert message.endswith(UNITS) or "expected less than or equal to" in message
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


# --- a number may carry its unit -------------------------------------------------------------------------------------

IN_UNITS = {
    ("sample_rate",): "0.5 kHz",
    ("table", "peak_acceleration"): "1 g",
    ("table", "peak_velocity"): "100 cm/s",
    ("table", "peak_displacement"): "250 mm",
    ("building", "masses"): ["1144.16 kgf s^2/m", "11.22 t", "10.92 t"],
    ("braces", 0, "stiffener_stiffness"): "1.2 kN/mm",
    ("braces", 0, "actuator", "capacity"): "2500 kgf",
    ("braces", 0, "actuator", "lag"): "0.8 ms",
    ("local_modes", 0, "frequency"): "9 Hz",
    ("local_modes", 0, "damping_ratio"): "1.2 %",
    ("sensors", "acceleration", "range"): "0.6 g",
    ("sensors", "force", "range"): "28 kN",
}


def test_numbers_may_carry_their_unit(tmp_path):
    written = deepcopy(PAPERS)
    for path, text in IN_UNITS.items():
        at(written, path[:-1])[path[-1]] = text
    written["interlocks"] = {"force": {"value": "26.5 kN", "time": "10 ms"}, "drift": {"value": "5 cm", "time": 0.01}}
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(written))
    rig = load_rig(tmp_path / "rig.yaml")
    assert (rig.sample_rate, rig.table.peak_velocity) == (500.0, 1.0)
    assert (rig.table.peak_acceleration, rig.table.peak_displacement) == pytest.approx((9.80665, 0.25))
    assert rig.building.masses.tolist() == pytest.approx([1144.16 * 9.80665, 11220.0, 10920.0])
    assert rig.braces[0].stiffener_stiffness == pytest.approx(1.2e6)
    assert rig.braces[0].actuator.capacity == pytest.approx(24516.625)
    assert (rig.braces[0].actuator.lag, rig.local_modes[0].damping_ratio) == pytest.approx((0.0008, 0.012))
    assert rig.local_modes[0].frequency == pytest.approx(56.5486678)
    assert (rig.sensors.acceleration.range, rig.sensors.force.range) == pytest.approx((5.88399, 28e3))
    assert (rig.interlocks["force"].value, rig.interlocks["force"].time) == pytest.approx((26500.0, 0.01))
    assert rig.interlocks["drift"].value == pytest.approx(0.05)
