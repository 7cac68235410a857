# SPDX-License-Identifier: Apache-2.0
"""Interlocks: when they act, and what they say."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from abrace_core.model.signals import channel_names
from abrace_plant.live.loop import rig_outputs
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.interlocks import Interlocks
from abrace_plant.rig.model import Interlock
from abrace_plant.rig.sensors import Measurement, OverRange, Sensor

SOURCE = Path(__file__).parents[2] / "src"
NAMES = channel_names(3, [2])


@pytest.fixture(scope="module")
def rig():
    return load_rig(SOURCE / "abrace_plant/config/ncree_three_storey.yaml")


def with_limits(rig, **limits: Interlock):
    return replace(rig, interlocks={**rig.interlocks, **limits})


def swinging(rig, samples: int, connected: bool = True) -> np.ndarray:
    """Readings (samples, channels) of the first mode, from the first sample on."""
    shape, omega = np.array([0.38, 0.8, 1.0]), 7.36
    motion = 0.03 * np.cos(omega * 0.002 * np.arange(samples))[:, None]
    readings = noise(rig, samples)
    readings[:, :3] += shape * motion
    readings[:, 3:4] += connected * 0.8 * shape[0] * motion
    readings[:, 4:7] -= omega**2 * shape * motion
    return readings


def noise(rig, samples: int, seed: int = 1) -> np.ndarray:
    """Readings (samples, channels) at rest."""
    return Measurement(rig.channel_sensors, seed, 0.002).record(np.zeros((samples, len(rig.channel_sensors))))


def tripped(interlocks: Interlocks, readings: np.ndarray, command: float = 0.0, **table: float):
    """The first trip and its sample; (None, samples) if there is none."""
    given = {"table_velocity": 0.0, "stopping_place": 0.0, "clipped": 0} | table
    for k, reading in enumerate(readings):
        if found := interlocks.check(reading, [command], **given):
            return found, k
    return None, len(readings)


# --- when an interlock acts ------------------------------------------------------------------------------------------


def test_a_value_has_to_be_exceeded_for_its_time_without_a_break(rig):
    readings = noise(rig, 400)
    readings[100:, 1] += 0.05
    for breaks, last in (([], 104), ([103], 108)):
        changed = readings.copy()
        changed[breaks, 1] = 0.0
        found, sample = tripped(Interlocks(with_limits(rig, velocity=Interlock(9.0, 0.01))), changed)
        assert (found.interlock, found.channel, found.limit, sample) == ("drift", "x2", 0.04, last)
        drift = f"{found.value:.3g} m for 10 ms, limit 0.04 (interlocks.drift)"
        assert str(found) == f"interstorey drift of storey 2: {drift}"
        assert found.value == pytest.approx(0.05, abs=5e-4)


@pytest.mark.filterwarnings("ignore:overflow")
def test_a_reading_that_is_not_a_number_trips_at_once(rig):
    readings = noise(rig, 50)
    readings[20:, NAMES.index("a3")] = np.nan
    interlocks = Interlocks(rig)
    found, sample = tripped(interlocks, readings)
    assert (found.channel, sample) == ("a3", 20)
    assert str(found) == "a3: nan, expected a number"
    assert tripped(interlocks, noise(rig, 50))[0] is None, "the filters have not seen it"
    assert str(tripped(interlocks, noise(rig, 1), command=np.inf)[0]) == "U: inf, expected a number"
    assert tripped(interlocks, np.full((1, 10), 1.7e308))[0].channel == "x1"


def test_an_interlock_that_only_warns_is_reported_and_stops_nothing(rig):
    interlocks = Interlocks(with_limits(rig, table_velocity=Interlock(0.9, 0.01, "warn")))
    assert tripped(interlocks, noise(rig, 60), table_velocity=-0.91) == (None, 60)
    (warning,) = interlocks.warnings
    assert (warning.interlock, warning.value, interlocks.trips["table_velocity"]) == ("table_velocity", 0.91, 1)
    assert tripped(interlocks, noise(rig, 1))[0] is None
    assert interlocks.warnings == []


def test_after_a_reset_every_time_counts_anew(rig):
    interlocks, readings = Interlocks(rig), noise(rig, 20)
    high = {"stopping_place": 0.3}
    assert tripped(interlocks, readings[:4], **high)[0] is None
    interlocks.reset()
    assert tripped(interlocks, readings[4:8], **high)[0] is None
    assert tripped(interlocks, readings[8:9], **high)[0].interlock == "table_displacement"
    assert interlocks.utilisation()["table_displacement"] == pytest.approx(0.3 / 0.24)


def test_a_bit_of_a_clipped_channel_trips_after_its_time(rig):
    found, sample = tripped(Interlocks(rig), noise(rig, 50), clipped=1 << NAMES.index("a2"))
    assert (found.interlock, found.channel, sample) == ("clipped", "a2", 9)
    assert "a2: at the end of its range, at" in str(found)


def test_the_force_error_waits_for_the_servos_delay_and_lag(rig):
    """A step of the command that the force follows as the actuator on the bench does is no error."""
    group = rig.braces[0]
    slow = replace(group, actuator=replace(group.actuator, lag=0.02, command_delay=0.013))
    late = with_limits(replace(rig, braces=(slow,)), force_error=Interlock(500.0, 0.002))
    time = np.arange(200) * 0.002
    readings = noise(rig, 200)
    command = np.where(time >= 0.1, 20e3, 0.0)
    readings[:, 7:9] += np.where(time > 0.113, 20e3 * (1 - np.exp(-(time - 0.113) / 0.02)), 0.0)[:, None]
    for constants, trips in ((late, False), (replace(late, braces=(group,)), True)):
        interlocks = Interlocks(constants)
        found = [
            interlocks.check(reading, [before], 0.0, 0.0, 0)
            for reading, before in zip(readings, [0.0, *command[:-1]], strict=True)
        ]
        assert any(one and one.interlock == "force_error" for one in found) == trips


def test_the_velocity_is_that_of_a_motion_in_the_building_s_band(rig):
    time = np.arange(3000) * 0.002
    readings = noise(rig, 3000)
    readings[:, 2] += 0.05 * np.sin(2 * np.pi * 1.2 * time) * np.minimum(time, 1)
    interlocks = Interlocks(rig)
    for reading in readings:
        interlocks.check(reading, [0.0], 0.0, 0.0, 0)
    assert interlocks.utilisation()["velocity"] * 0.8 == pytest.approx(0.05 * 2 * np.pi * 1.2, rel=0.02)


# --- sensors ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("channel", ["x1", "a2", "fb", "w"])
def test_a_sensor_that_repeats_itself_or_is_quieter_than_its_noise_is_named(rig, channel):
    readings = noise(rig, 400)
    place = NAMES.index(channel)
    stuck, dead = readings.copy(), readings.copy()
    stuck[100:, place] = readings[99, place]
    dead[100:, place] *= 0.05
    found, sample = tripped(Interlocks(rig), stuck)
    assert (found.interlock, found.channel, sample) == ("stuck", channel, 124)
    found, sample = tripped(Interlocks(rig), dead)
    assert (found.interlock, found.channel) == ("dead", channel)
    assert 199 <= sample <= 210


def test_a_sensor_quieter_than_its_converters_step_may_rest_on_one_reading(rig):
    quiet = replace(rig.sensors, acceleration=replace(rig.sensors.acceleration, noise=0.0))
    assert tripped(Interlocks(replace(rig, sensors=quiet)), noise(replace(rig, sensors=quiet), 400))[0] is None


@pytest.mark.parametrize("rate", [50.0, 200.0])
def test_noise_of_one_step_of_the_converter_is_not_stuck_at_a_low_sample_rate(rig, rate):
    """Of ten samples of such a sensor, those of 50 ms at 200 Hz, all are the same once in 15 000."""
    sensors = [replace(sensor, noise=sensor.step) for sensor in rig.channel_sensors]
    kinds = ("displacement", "stroke", "acceleration", "force", "ground_acceleration")
    own = {kind: replace(getattr(rig.sensors, kind), noise=getattr(rig.sensors, kind).step) for kind in kinds}
    slow = replace(rig, sample_rate=rate, sensors=replace(rig.sensors, **own))
    readings = Measurement(sensors, 1, 1 / rate).record(np.zeros((20_000, len(sensors))))
    assert tripped(Interlocks(slow), readings)[0] is None
    readings[1000:, 2] = readings[999, 2]
    found, sample = tripped(Interlocks(slow), readings)
    assert (found.interlock, found.channel) == ("stuck", "x3")
    assert sample < 1030


@pytest.mark.parametrize(
    ("channel", "force", "interlock"),
    [
        ("f1a", 12e3, ""),
        ("f1a", 13e3, "force_error"),
        ("f1a", 55e3, "force"),
        ("f2", 24e3, ""),
        ("f2", 26e3, "force_error"),
    ],
)
def test_the_limits_of_forces_are_in_proportion_to_the_capacity_of_each_actuator(channel, force, interlock):
    """The first group's actuators have 50 kN, the second one's 100 kN; the limits are 108 and 25 kN."""
    rig = load_rig(SOURCE / "abrace_plant/config/five_storey.yaml")
    readings, interlocks = noise(rig, 100), Interlocks(rig)
    readings[:, rig.channel_names.index(channel)] += force
    trips = [interlocks.check(reading, [0.0, 0.0], 0.0, 0.0, 0) for reading in readings]
    assert {(trip.interlock, trip.channel) for trip in trips if trip} == (
        {(interlock, channel)} if interlock else set()
    )
    assert interlocks.greatest()["force"] == pytest.approx(force, rel=0.05)


def test_the_limits_of_the_check_list_s_first_force_go_together(tmp_path):
    """Those of docs/first_force.md; commands are cut at the rig file's own limit."""
    text = (SOURCE / "abrace_plant/config/ncree_three_storey.yaml").read_text()
    content = yaml.safe_load(text)
    content["braces"][0]["actuator"]["command_limit"] = 250.0
    first = {
        "force": 1000.0,
        "force_error": 500.0,
        "oscillation": 500.0,
        "drift": 5e-3,
        "stroke": 5e-3,
        "acceleration": 0.5,
    }
    for name, value in first.items():
        content["interlocks"][name]["value"] = value
    (tmp_path / "first_rig.yaml").write_text(yaml.safe_dump(content))
    rig = load_rig(tmp_path / "first_rig.yaml")
    (braces, _), found = rig_outputs(rig), Interlocks(rig)
    for _ in range(200):
        braces.follow([20e3])
    assert braces.value == [250.0]
    assert braces.saturated
    quiet = noise(rig, 200)
    assert tripped(found, quiet)[0] is None
    assert {name: found.table[name].value for name in first} == first


def test_the_ends_of_the_range_are_those_where_a_measurement_clips():
    sensors = [Sensor(range=6.0, noise=0.0, bits=16), Sensor(range=28000.0, noise=0.0, bits=5)]
    measurement, over_range = Measurement(sensors, 1, 0.002), OverRange(sensors)
    for share, bits in ((1.2, 0b11), (-1.2, 0b11), (-1.0, 0b11), (0.97, 0b10), (0.9, 0), (-0.9, 0), (0.0, 0)):
        assert over_range.check(measurement.read(share * np.array([6.0, 28000.0]))) == bits, share


def test_a_rig_with_more_channels_than_a_message_has_bits_is_watched_in_all():
    sensors = [Sensor(range=1.0, noise=0.0, bits=8)] * 70
    over_range = OverRange(sensors)
    assert over_range.check(np.full(70, 1.0)) == 2**70 - 1


def test_a_start_or_a_reset_in_motion_trips_nothing(rig):
    readings = swinging(rig, 4000)
    interlocks = Interlocks(rig)
    assert tripped(interlocks, readings)[0] is None
    interlocks.reset()
    assert tripped(interlocks, readings[333:])[0] is None
    assert interlocks.utilisation()["implausible_acceleration"] < 0.5


def test_a_disconnected_brace_has_no_interlocks(rig):
    readings = swinging(rig, 4000, connected=False)
    assert tripped(Interlocks(rig), readings)[0].interlock == "implausible_stroke"
    assert tripped(Interlocks(rig.disconnect([1])), readings, command=20e3)[0] is None
