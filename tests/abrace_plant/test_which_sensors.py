# SPDX-License-Identifier: Apache-2.0
"""A rig with some of the sensors that it could have: what is not measured is nowhere, and not zero, dead or stuck."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml
from bag_of_run import write_bag
from udp_target import LAYOUT

from abrace_bags import read_run
from abrace_core import AbraceError
from abrace_core.model import signals
from abrace_core.model.own_law import GuardedLaw
from abrace_core.safety.wire import Head, Responses
from abrace_plant.devices.device import Wanted
from abrace_plant.devices.layout import Packet, read_layout
from abrace_plant.devices.sensor_check import check_sensors
from abrace_plant.emulator.target import Target
from abrace_plant.live.simulated_run import simulated_run
from abrace_plant.nodes.check_sensors import recorded_readings
from abrace_plant.rig.detectors import cells_missing, missing_sensors
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.interlocks import Interlocks
from abrace_plant.rig.sensors import KINDS

if TYPE_CHECKING:
    from abrace_plant.rig.model import Rig

CONFIG = Path(__file__).parents[2] / "src/abrace_plant/config"
CONTENT = yaml.safe_load((CONFIG / "five_storey.yaml").read_text())
COMPLETE = load_rig(CONFIG / "five_storey.yaml")
EVERY = signals.channel_names(5, [2, 1])
OF_KIND = {
    "displacement": EVERY[:5],
    "stroke": EVERY[5:7],
    "acceleration": EVERY[7:12],
    "force": EVERY[12:15],
    "ground_acceleration": EVERY[15:],
}


def rig_with(folder: Path, *channels: str, **kinds: Any) -> Rig:
    """The five storeys with sensors for these channels alone; `kinds` overwrite what the file says of a kind."""
    sensors = {}
    for kind, names in OF_KIND.items():
        if some := [name for name in names if name in channels]:
            sensors[kind] = {**CONTENT["sensors"][kind], "channels": some}
    path = folder / "rig.yaml"
    path.write_text(yaml.safe_dump({**CONTENT, "sensors": {**sensors, **kinds}}))
    return load_rig(path)


THREE = ("a1", "a3", "a5", "f1a", "f1b", "f2", "w")
MOTION = 0.2 * np.sin(2 * np.pi * 1.2 * np.arange(1500) * 0.002)


def push(number: int, *_: list[float]) -> list[float]:
    return [2000.0 * math.sin(0.02 * number), -1000.0]


@pytest.fixture(scope="module")
def three(tmp_path_factory):
    return rig_with(tmp_path_factory.mktemp("three"), *THREE)


@pytest.mark.parametrize("seed", range(8))
def test_any_subset_reads_what_the_complete_rig_reads_and_nothing_trips(seed, tmp_path):
    random = np.random.default_rng(seed)
    chosen = [name for name in EVERY if random.random() < 0.4] or ["a2"]
    rig = rig_with(tmp_path, *chosen)
    assert rig.channel_names == tuple(chosen)
    seen: list[list[float]] = []

    def law(number: int, z: list[float], _: list[float]) -> list[float]:
        seen.append(z)
        return push(number, z)

    run, whole = simulated_run(rig, MOTION, law), simulated_run(COMPLETE, MOTION, push)
    assert not run.stopped
    assert run.without == rig.not_measured == tuple(name for name in EVERY if name not in chosen)
    assert run.names == rig.recorded_names
    assert np.isfinite(run.outputs).all()
    assert np.isnan(run.ground_acceleration).all() == ("w" not in chosen)
    np.testing.assert_array_equal(run.command, whole.command)
    for name in run.names:
        # the noise is drawn for the channels that there are
        sensor = {"x": 8.4e-5, "a": 5.6e-3, "f": 67.0}[name[0]] if name[:2] != "xf" else 3.4e-5
        np.testing.assert_allclose(run[name], whole[name], atol=12 * sensor, err_msg=name)
    names = signals.response_names(5, 2)
    assert {name for name, value in zip(names, seen[-1], strict=True) if math.isnan(value)} == set(names) - {*run.names}
    write_bag(run, tmp_path / "bag")
    read = read_run(tmp_path / "bag")
    assert (read.names, read.without) == (run.names, run.without)
    np.testing.assert_allclose(read.outputs, run.outputs, rtol=1e-14)
    if "w" in chosen:
        assert read.all_names[-1] == "w"
    else:
        with pytest.raises(AbraceError, match="no channel 'w', it has"):
            read["w"]


def test_a_force_is_the_mean_of_the_load_cells_that_there_are(tmp_path):
    rig = rig_with(tmp_path, "f1b", "a1", "w")
    assert rig.recorded_names == ("a1", "f1")
    assert cells_missing(rig) == ["f1a", "f2"]
    run = simulated_run(rig, MOTION, push)
    assert run["f1"][-1] == pytest.approx(run.command[-1, 0], abs=500)
    values, responses = rig.as_in_message([1.0, 30.0, 2.0]), Responses()
    payload = Responses().pack(
        0, Head(0, 1, 0, 0, 3), "", (2, 1), values[:5], values[7:12], values[5:7], values[12:15], [0.0, 0.0], 2.0, 0.0
    )
    _, _, z = responses.unpack(payload)
    assert z[-2] == 30.0
    assert math.isnan(z[-1])
    # the load cell of a run that began with it is expected in every sample
    whole = Responses()
    cells = [10.0, 20.0, 5.0]
    for sequence in range(2):
        cells[0] = math.nan if sequence else 10.0
        arrays = values[:5], values[7:12], values[5:7], cells, [0.0, 0.0]
        _, _, z = whole.unpack(Responses().pack(0, Head(sequence, 1, 0, 0, 3), "", (2, 1), *arrays, 2.0, 0.0))
    assert math.isnan(z[-2]), "it fails"
    _, _, z = whole.unpack(Responses().pack(0, Head(0, 2, 0, 0, 3), "", (2, 1), *arrays, 2.0, 0.0))
    assert z[-2] == 20.0, "of another run, which has none there"


def test_interlocks_watch_what_is_there_and_the_rest_is_said(three):
    found = Interlocks(three)
    assert set(found.table) == {
        "acceleration", "force", "force_error", "oscillation", "table_displacement", "table_velocity", "noisy", "dead",
        "stuck", "clipped",
    }  # fmt: skip
    assert missing_sensors(three) == (
        "not measured: x1, x2, x3, x4, x5, xf1, xf2, a2, a4; interlocks that do not watch: drift, displacement, "
        "velocity, stroke, acceleration of a2, a4, implausible_acceleration, implausible_stroke"
    )
    assert not missing_sensors(COMPLETE)
    assert set(found.utilisation()) == set(found.table)


def test_a_drift_is_watched_where_both_its_floors_are(tmp_path):
    rig = rig_with(tmp_path, "x1", "x2", "x4", "xf1", "xf2", "a4", "w")
    watched = Interlocks(rig)
    reading = np.random.default_rng(0).standard_normal((400, 7)) * [sensor.noise for sensor in rig.channel_sensors]
    reading[200:, rig.channel_names.index("x2")] += 0.05
    for row in reading:
        trip = watched.check(row, [0.0, 0.0], 0.0, 0.0, 0)
        if trip:
            break
    assert trip is not None
    assert trip.name == "interstorey drift of storey 2"
    assert "drift of x3, x4, x5" in missing_sensors(rig)
    assert "implausible_stroke of xf2" in missing_sensors(rig)
    assert "no load cell f1a, f1b, f2: rest cannot be measured there" in missing_sensors(rig)


def test_a_stroke_is_compared_with_a_displacement_only_if_that_of_the_floor_below_is_measured_too(tmp_path):
    assert "implausible_stroke" not in Interlocks(rig_with(tmp_path, "x3", "xf2")).table
    assert "implausible_stroke" in Interlocks(rig_with(tmp_path, "x2", "x3", "xf2")).table


def test_exact_sensors_read_the_outputs_and_the_ground_of_the_channels_that_there_are(tmp_path):
    outputs, ground = np.arange(28.0).reshape(2, 14), np.array([-1.0, -2.0])
    rig = rig_with(tmp_path, "x2", "a5", "f1a", "f1b", "f2")
    # z is x1 to x5, xf1, xf2, a1 to a5, f1, f2
    np.testing.assert_array_equal(rig.readings_of(outputs, ground), [[1, 11, 12, 12, 13], [15, 25, 26, 26, 27]])
    with_table = rig_with(tmp_path, "a5", "w")
    np.testing.assert_array_equal(with_table.readings_of(outputs, ground), [[11, -1], [25, -2]])


def test_a_target_without_a_channel_of_the_table_reads_what_there_is(tmp_path):
    last = []
    for rig in (rig_with(tmp_path, "a1", "a5"), COMPLETE):
        target = Target(rig, 0)
        for number in range(250):
            wanted = Wanted.FOLLOW if number else Wanted.HOLD_ZERO
            target.command(
                number + 1, np.array([0.0, 0.0, 0.005 * number]), target.outputs.last_arm + (not number), wanted
            )
            reading = target.step()
        last.append(reading)
    few, whole = last
    assert abs(whole[EVERY.index("w")]) > 1.0
    np.testing.assert_allclose(few, whole[[EVERY.index("a1"), EVERY.index("a5")]], atol=0.07)


def test_a_channel_at_its_end_has_the_bit_of_its_place_in_the_message(three):
    for i, name in enumerate(three.channel_names):
        assert three.bits_in_message(1 << i) == 1 << EVERY.index(name)
    assert three.bits_in_message(0b101) == 1 << 7 | 1 << 11
    pulse = np.concatenate([np.zeros(100), np.full(100, 30.0), np.zeros(200)])
    run, whole = (simulated_run(rig, pulse, lambda *_: [0.0, 0.0]) for rig in (three, COMPLETE))
    assert run.clipped_samples is not None
    assert whole.clipped_samples is not None
    assert set(run.clipped_samples) == {*whole.clipped_samples} & {*THREE}
    assert {"w", "a5"} <= set(run.clipped_samples)


@pytest.mark.parametrize(
    ("kinds", "message"),
    [
        (
            {"acceleration": {**CONTENT["sensors"]["acceleration"], "channels": ["a1", "a7"]}},
            "a7, expected one of a1, a2",
        ),
        (
            {"acceleration": {**CONTENT["sensors"]["acceleration"], "channels": ["a1", "a1"]}},
            "channels.1: a1, expected",
        ),
        (
            {"acceleration": {**CONTENT["sensors"]["acceleration"], "channels": ["x1"]}},
            "channels.0: x1, expected one of",
        ),
        ({"force": {**CONTENT["sensors"]["force"], "channels": ["f1"]}}, "f1, expected one of f1a, f1b, f2, each once"),
        ({"acceleration": {**CONTENT["sensors"]["acceleration"], "channels": []}}, "sensors.acceleration.channels"),
        (dict.fromkeys(KINDS), "sensors: none, expected one or more of displacement, stroke, acceleration"),
    ],
)
def test_channels_that_there_are_not_are_refused(kinds, message, tmp_path):
    with pytest.raises(AbraceError, match="rig file ") as refused:
        rig_with(tmp_path, "a1", **kinds)
    assert message in str(refused.value)


def test_a_target_sends_the_channels_that_there_are(three):
    layout = read_layout(LAYOUT)
    fields = [field for field in layout.sample if not isinstance(field.field, list)]
    crc = fields.pop()
    (of_channels,) = (field for field in layout.sample if "a1" in field.names)
    sent = layout.model_copy(update={"sample": [*fields, of_channels.model_copy(update={"field": [*THREE]}), crc]})
    kept = [field for field in sent.sample if field.field != "table_displacement"]
    packet = Packet(sent.model_copy(update={"sample": kept}), "sample", three.channel_names)
    assert packet.decode(packet.encode(range(7), 1)).signals == tuple(range(7))
    more = of_channels.model_copy(update={"field": ["x1"]})
    with pytest.raises(AbraceError, match=r"field: 'x1', expected one of .* a1, a3, a5, f1a, f1b, f2, w"):
        Packet(sent.model_copy(update={"sample": [more, *kept]}), "sample", three.channel_names)


def test_sensors_are_checked_from_the_record_of_such_a_rig(three, tmp_path):
    run = simulated_run(three, MOTION, push)
    write_bag(run, tmp_path / "bag")
    readings = recorded_readings(replace(read_run(tmp_path / "bag")), three)
    assert readings.shape == (len(MOTION), len(THREE))
    found = check_sensors(three, readings)
    assert [channel.name for channel in found.channels] == [*THREE]
    assert found.well, found.text()
    readings[:, 1] = readings[0, 1]
    assert "dead" in check_sensors(three, readings).channels[1].faults[0]
    with pytest.raises(AbraceError, match=r"has the channels a1, a3, .*, expected those of the rig five_storey: x1"):
        recorded_readings(run, COMPLETE)


def test_an_own_law_gets_nan_for_what_is_not_measured_and_stops_at_a_sensor_that_fails():
    class Skyhook:
        def begin(self, floors: int, groups: int, sample_period: float) -> None:
            """Nothing is kept."""

        def force(self, sample: Any) -> float:
            return -10.0 * float(np.nansum(sample.acceleration))

    law = GuardedLaw(Skyhook(), 0.002, 0.0)
    law.begin(2, 1)
    z = [math.nan, math.nan, 0.01, 1.0, math.nan, 5.0]
    assert law.force(0, z, [0.0], 0) == [-10.0]
    z[2] = math.nan
    with pytest.raises(AbraceError, match=r"stroke\[0\] of sample 1 is nan, expected a finite number"):
        law.force(1, z, [0.0], 0)
