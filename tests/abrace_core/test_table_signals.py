# SPDX-License-Identifier: Apache-2.0
"""White noise and multisines that a table can play: from rest to rest."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from abrace_core import AbraceError
from abrace_core.model.table_signals import table_multisine, table_noise
from abrace_core.safety.table_stop import TableState

BAND = (0.1, 10.0)


def path(acceleration: np.ndarray, rate: float = 500.0) -> tuple[np.ndarray, np.ndarray]:
    """Velocity and displacement, a sample at rest after the end included."""
    state, states = TableState(1 / rate), []
    for value in (*acceleration.tolist(), 0.0):
        state.update(value)
        states.append((state.velocity, state.displacement))
    velocity, displacement = np.array(states).T
    return velocity, displacement


@settings(max_examples=20)
@given(
    seconds=st.floats(2.0, 60.0),
    rate=st.sampled_from([100.0, 500.0]),
    low=st.sampled_from([0.0, 0.1, 1.0]),
    seed=st.integers(0, 1000),
)
def test_noise_begins_and_ends_at_rest_in_the_middle_with_its_rms(seconds, rate, low, seed):
    samples = round(seconds * rate)
    noise = table_noise(samples, rate, (low, 10.0), 0.25, seed)
    assert noise.shape == (samples,)
    assert np.sqrt(np.mean(noise**2)) == pytest.approx(0.25, rel=1e-12)
    velocity, displacement = path(noise, rate)
    assert abs(velocity[-1]) < 1e-9 * np.abs(velocity).max()
    assert abs(displacement[-1]) < 1e-9 * np.abs(displacement).max()


@pytest.mark.parametrize("seed", [1, 2, 3, 11])
def test_noise_from_a_tenth_of_a_hertz_keeps_within_a_stroke_of_25_cm(seed):
    velocity, displacement = path(table_noise(120_000, 500.0, BAND, 0.25, seed))
    assert np.abs(displacement).max() < 0.18
    assert np.abs(velocity).max() < 0.25


def test_noise_fades_in_and_out_and_is_the_same_for_a_seed():
    noise, again, other = (table_noise(20_000, 500.0, BAND, 1.0, seed) for seed in (1, 1, 2))
    assert noise.tobytes() == again.tobytes()
    assert abs(np.corrcoef(noise, other)[0, 1]) < 0.2
    assert np.abs(noise[[0, -1]]).max() < 1e-3
    assert np.std(noise[8000:12000]) > 0.9


@pytest.mark.parametrize("low", [0.1, 0.3, 2.0])
def test_a_multisine_repeats_bit_for_bit_between_its_fades_from_rest_to_rest(low):
    motion = table_multisine(120.0, 16.384, 500.0, (low, 10.0), 0.25, 1)
    fade = round(max(1.0, 1 / low) * 500)
    assert len(motion) == 2 * fade + 8192 * ((60_000 - 2 * fade) // 8192)
    whole = motion[fade + 1 : len(motion) - fade - 1]
    np.testing.assert_array_equal(whole[8192:], whole[:-8192])
    assert np.sqrt(np.mean(whole[:8192] ** 2)) == pytest.approx(0.25, rel=1e-9)
    velocity, displacement = path(motion)
    assert abs(velocity[-1]) < 1e-12
    assert abs(displacement[-1]) < 1e-10
    assert np.abs(displacement).max() < 0.08


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"band": (0.0, 10.0)}, "multisine band 0.0 to 10.0 Hz on the table: expected a lowest frequency above 0"),
        (
            {"duration": 39.0},
            "multisine of 39 s with a period of 16.384 s: expected at least 39.436 s, two",
        ),
        ({"rms": 0.0}, "multisine rms 0.0: expected more than 0"),
    ],
)
def test_a_multisine_that_a_table_cannot_play_is_refused(change, message):
    arguments = {"duration": 80.0, "period": 16.384, "band": (0.3, 10.0), "rms": 0.25} | change
    with pytest.raises(AbraceError, match=message):
        table_multisine(sample_rate=500.0, seed=1, **arguments)
