# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_plant.rig.sensors import BLOCK, FAULTS, Measurement, Sensor, SensorFault, SensorSet, parse_fault


def test_reading_is_the_nearest_step_of_the_converter():
    sensor = Sensor(range=8.0, noise=0.0, bits=4)  # steps of 1
    values = np.array([0.2, -0.7, 3.4999, 3.5001, -8.0])
    readings = Measurement([sensor] * 5, seed=1, sample_period=0.002).read(values)
    assert readings.tolist() == [0.0, -1.0, 3.0, 4.0, -8.0]


def test_readings_beyond_the_range_are_clipped_to_the_codes_of_the_converter():
    measurement = Measurement([Sensor(range=0.1, noise=0.0, bits=16)] * 2, seed=1, sample_period=0.002)
    low, high = measurement.read(np.array([-5.0, 5.0]))
    step = 0.1 / 2**15
    assert (low, high) == pytest.approx((-0.1, 0.1 - step), abs=1e-12)


def test_noise_is_white_has_its_standard_deviation_and_leaves_channels_uncorrelated():
    channels = [Sensor(range=100.0, noise=0.5, bits=24), Sensor(range=100.0, noise=0.02, bits=24)]
    measurement = Measurement(channels, seed=3, sample_period=0.002)
    readings = np.array([measurement.read(np.array([1.0, -2.0])) for _ in range(12_000)])
    np.testing.assert_allclose(readings.std(axis=0), [0.5, 0.02], rtol=0.05)
    np.testing.assert_allclose(readings.mean(axis=0), [1.0, -2.0], atol=0.03)
    noise = (readings - readings.mean(axis=0)) / readings.std(axis=0)
    assert abs(np.mean(noise[:, 0] * noise[:, 1])) < 0.05
    for lag in (1, 7, BLOCK):
        assert abs(np.mean(noise[lag:, 0] * noise[:-lag, 0])) < 0.05, f"correlation at lag {lag}"


def test_channels_follow_the_order_of_the_recorded_quantities_then_the_table():
    kinds = [Sensor(range=float(i + 1), noise=0.0, bits=16) for i in range(5)]
    sensors = SensorSet(*kinds)
    assert [channel.range for channel in sensors.channels(3, 2, 4)] == [1, 1, 1, 2, 2, 3, 3, 3, 4, 4, 4, 4, 5]


def test_bias_and_drift_grow_from_the_first_sample_across_blocks():
    measurement = Measurement(
        [Sensor(range=10.0, noise=0.0, bits=24, bias=0.25, drift=-0.1)], seed=1, sample_period=0.002
    )
    samples = 3 * BLOCK + 100
    readings = np.array([measurement.read(np.array([1.0]))[0] for _ in range(samples)])
    np.testing.assert_allclose(readings, 1.25 - 0.1 * 0.002 * np.arange(samples), atol=10 / 2**23)


def dying(kind: str, start: int, samples: int = 200) -> np.ndarray:
    """(samples, 2) readings of a ramp and of its negative, the first channel dead from `start` on."""
    measurement = Measurement([Sensor(range=10.0, noise=0.0, bits=24)] * 2, seed=1, sample_period=0.002)
    measurement.faults = (SensorFault(0, kind, start),)
    return np.array([measurement.read(np.array([0.01 * k, -0.01 * k])) for k in range(samples)])


@pytest.mark.parametrize("kind", FAULTS)
def test_a_channel_dies_at_its_sample_and_leaves_the_others_alone(kind):
    readings = dying(kind, 50)
    ramp = 0.01 * np.arange(200)
    np.testing.assert_allclose(readings[:50, 0], ramp[:50], atol=1e-6)
    np.testing.assert_allclose(readings[:, 1], -ramp, atol=1e-6)
    dead = readings[50:, 0]
    if kind == "noise":
        assert dead.std() == pytest.approx(10 / 3, rel=0.2)
        assert np.abs(dead).max() <= 10.0
    else:
        np.testing.assert_allclose(dead, readings[49, 0] if kind == "stuck" else 0.0)


def test_a_channel_that_is_mended_reads_again():
    measurement = Measurement([Sensor(range=10.0, noise=0.0, bits=24)], seed=1, sample_period=0.002)
    measurement.faults = (SensorFault(0, "zero", 0),)
    assert measurement.read(np.array([2.0]))[0] == 0.0
    measurement.faults = ()
    assert measurement.read(np.array([2.0]))[0] == pytest.approx(2.0, abs=1e-5)


def test_noise_of_an_open_input_leaves_the_other_channels_noise_as_it_is():
    sensors = [Sensor(range=10.0, noise=0.1, bits=24)] * 2
    well, ill = (Measurement(sensors, seed=7, sample_period=0.002) for _ in range(2))
    ill.faults = (SensorFault(0, "noise", 0),)
    readings = np.array([(well.read(np.zeros(2)), ill.read(np.zeros(2))) for _ in range(100)])
    assert (readings[:, 0, 1] == readings[:, 1, 1]).all()


def test_faults_are_described_by_channel_kind_and_time():
    names = ("x1", "a1", "w")
    assert parse_fault("a1=stuck", names, 0.002) == SensorFault(1, "stuck", 0)
    assert parse_fault("w=noise@20.0", names, 0.002) == SensorFault(2, "noise", 10_000)
    assert parse_fault("x1=zero@0.003", names, 0.002).start == 2, "the first sample not before that time"


@pytest.mark.parametrize(
    "text", ["", "a1", "a1=", "a4=stuck", "a1=dead", "a1=stuck@", "a1=stuck@soon", "a1=zero@-1", "x1=zero@nan"]
)
def test_a_fault_that_is_none_is_refused_with_what_there_is(text):
    with pytest.raises(AbraceError, match=r"expected CHANNEL=KIND.*x1, a1, w.*stuck, zero, noise"):
        parse_fault(text, ("x1", "a1", "w"), 0.002)


def test_a_whole_record_reads_as_sample_after_sample():
    channels = [
        Sensor(range=1.0, noise=0.05, bits=12, bias=0.1, drift=0.01),
        *[Sensor(range=0.5, noise=0.02, bits=10)] * 3,
    ]
    values = np.random.default_rng(0).normal(0.0, 0.3, (3 * BLOCK + 100, 4))
    one, other = (Measurement(channels, seed=4, sample_period=0.002) for _ in range(2))
    for measurement in (one, other):
        measurement.faults = (
            SensorFault(1, "stuck", 70),
            SensorFault(2, "zero", BLOCK + 3),
            SensorFault(3, "noise", 9),
        )
    expected = np.array([one.read(row) for row in values])
    parts = np.split(values, [40, 71, 700])
    np.testing.assert_array_equal(np.vstack([other.record(part) for part in parts]), expected)
