import numpy as np
import pytest

from abrace_plant.sensors import BLOCK, Measurement, Sensor, SensorSet


def test_reading_is_the_nearest_step_of_the_converter():
    sensor = Sensor(range=8.0, noise=0.0, bits=4)  # steps of 1
    values = np.array([0.2, -0.7, 3.4999, 3.5001, -8.0])
    readings = Measurement([sensor] * 5, seed=1).read(values)
    assert readings.tolist() == [0.0, -1.0, 3.0, 4.0, -8.0]


def test_readings_beyond_the_range_are_clipped_to_the_codes_of_the_converter():
    measurement = Measurement([Sensor(range=0.1, noise=0.0, bits=16)] * 2, seed=1)
    low, high = measurement.read(np.array([-5.0, 5.0]))
    step = 0.1 / 2**15
    assert (low, high) == pytest.approx((-0.1, 0.1 - step), abs=1e-12)


def test_quantisation_error_stays_within_half_a_step():
    values = np.random.default_rng(0).uniform(-0.099, 0.099, (500, 1))
    measurement = Measurement([Sensor(range=0.1, noise=0.0, bits=12)], seed=1)
    error = np.array([measurement.read(value)[0] for value in values]) - values[:, 0]
    step = 0.1 / 2**11
    assert np.abs(error).max() <= step / 2 * (1 + 1e-9)
    assert np.std(error) == pytest.approx(step / np.sqrt(12), rel=0.1)


def test_noise_is_white_has_its_standard_deviation_and_leaves_channels_uncorrelated():
    channels = [Sensor(range=100.0, noise=0.5, bits=24), Sensor(range=100.0, noise=0.02, bits=24)]
    measurement = Measurement(channels, seed=3)
    readings = np.array([measurement.read(np.array([1.0, -2.0])) for _ in range(3 * BLOCK)])
    np.testing.assert_allclose(readings.std(axis=0), [0.5, 0.02], rtol=0.05)
    np.testing.assert_allclose(readings.mean(axis=0), [1.0, -2.0], atol=0.03)
    noise = (readings - readings.mean(axis=0)) / readings.std(axis=0)
    assert abs(np.mean(noise[:, 0] * noise[:, 1])) < 0.05
    for lag in (1, 7, BLOCK):
        assert abs(np.mean(noise[lag:, 0] * noise[:-lag, 0])) < 0.05, f"correlation at lag {lag}"


def test_same_seed_gives_the_same_readings_and_another_seed_others():
    channels = [Sensor(range=1.0, noise=0.01, bits=16)]

    def readings(seed: int) -> bytes:
        measurement = Measurement(channels, seed)
        return np.array([measurement.read(np.zeros(1)) for _ in range(BLOCK + 10)]).tobytes()

    assert readings(5) == readings(5)
    assert readings(5) != readings(6)


def test_reading_does_not_change_the_true_values():
    values = np.array([0.123456])
    Measurement([Sensor(range=1.0, noise=0.1, bits=8)], seed=0).read(values)
    assert values[0] == 0.123456


def test_channels_follow_the_order_of_the_recorded_quantities_then_the_table():
    kinds = [Sensor(range=float(i + 1), noise=0.0, bits=16) for i in range(5)]
    sensors = SensorSet(*kinds)
    assert [channel.range for channel in sensors.channels(3, 2)] == [1, 1, 1, 2, 2, 3, 3, 3, 4, 4, 5]
