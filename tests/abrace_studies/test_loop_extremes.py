# SPDX-License-Identifier: Apache-2.0
"""Peaks and rms of many closed loops are those of the loops run one by one."""

from __future__ import annotations

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import LinearModel
from abrace_core.model.simulation import simulate, simulate_closed_loop
from abrace_studies.batches.loop_extremes import Motions, loop_extremes

PERIOD = 0.002
LENGTHS = (5000, 1, 2, 15, 16, 17, 2049)


def loop_of(groups: int, gain: float) -> tuple[LinearModel, LinearModel, np.ndarray, np.ndarray]:
    """A structure of six modes, a law of filtered accelerations, capacities, a correction."""
    generator = np.random.default_rng(1)
    pairs = [(-0.02 * omega, omega) for omega in (7.0, 23.0, 38.0, 56.0, 105.0, 135.0)]
    a = np.zeros((12, 12))
    for i, (real, imaginary) in enumerate(pairs):
        a[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[real, imaginary], [-imaginary, real]]
    commands = ("U",) if groups == 1 else tuple(f"U{i + 1}" for i in range(groups))
    inputs, outputs = ("w", *commands), ("x1", "x2", "x3", "a1", "a2", "a3")
    b, c, d = (generator.uniform(-1, 1, shape) for shape in ((12, len(inputs)), (6, 12), (6, len(inputs))))
    delays = (0.0, *(0.0007 for _ in commands))
    model = discretize(LinearModel(a, b, c, d, inputs, outputs, input_delay=delays), PERIOD)
    into, out = generator.uniform(size=(3, 2)), generator.uniform(size=(groups, 3))
    law = LinearModel(
        np.diag([0.99, 0.95, 0.9]), into, -gain * out, np.zeros((groups, 2)), ("a1", "a2"), commands, PERIOD
    )
    return model, law, np.full(groups, 0.01), 0.1 * generator.uniform(size=(3, groups))


def motions() -> Motions:
    return Motions.of(np.random.default_rng(2).standard_normal(length) for length in LENGTHS)


def by_one(model: LinearModel, law: LinearModel, capacity: np.ndarray, correction: np.ndarray, ground: np.ndarray):
    outputs, commands = simulate_closed_loop(model, law, ground, capacity, correction)
    values = np.hstack([outputs, commands])
    cut = np.count_nonzero((np.abs(commands) >= capacity).any(axis=1))
    return np.abs(values).max(axis=0), np.sqrt(np.mean(values**2, axis=0)), cut


@pytest.mark.parametrize("groups", [1, 2])
@pytest.mark.parametrize("limited", [False, True])
def test_peaks_and_rms_are_those_of_the_simulated_loops(groups, limited):
    model, law, capacity, correction = loop_of(groups, 1e-2)
    every = motions()
    limit = capacity if limited else np.full(len(capacity), 1e30)
    found = loop_extremes(model, law, every, capacity if limited else None, correction)
    assert found.names == (*model.outputs, *law.outputs)
    for i, length in enumerate(LENGTHS):
        peak, rms, cut = by_one(model, law, limit, correction, every.ground[i, :length])
        scale = 1e-12 * np.maximum(found.peak[0], 1e-30)  # as the longest record has it
        np.testing.assert_allclose(found.peak[i], peak, rtol=1e-9, atol=scale.max())
        np.testing.assert_allclose(found.rms[i], rms, rtol=1e-9, atol=scale.max())
        assert found.saturated[i] == cut
    assert (found.saturated[0] > 100) == limited, "the motion should have taken the commands to their limits"


def test_a_scaled_motion_has_the_numbers_that_it_has_alone_to_the_last_bit():
    model, law, capacity, correction = loop_of(1, 1e-2)
    every = motions()
    chosen, scale = np.array([6, 0, 6]), np.array([1.0, 2.0, 3.0])
    found = loop_extremes(model, law, every, capacity, correction, chosen=chosen, scale=scale)
    for i in range(3):
        alone = loop_extremes(model, law, every, capacity, correction, chosen=chosen[i : i + 1], scale=scale[i : i + 1])
        assert np.array_equal(alone.peak[0], found.peak[i])
        assert np.array_equal(alone.rms[0], found.rms[i])
    whole = Motions.of([3.0 * every.ground[6, : LENGTHS[6]]])
    assert np.array_equal(loop_extremes(model, law, whole, capacity, correction).peak[0], found.peak[2])


def test_without_a_controller_the_commands_are_zero():
    model = loop_of(2, 1.0)[0]
    every = motions()
    found = loop_extremes(model, None, every)
    free = simulate(model.select(inputs=["w"]), every.ground[:1].T)
    np.testing.assert_allclose(found.peak[0, :-2], np.abs(free).max(axis=0), rtol=1e-9)
    assert not found.peak[:, -2:].any()


def test_an_unstable_loop_is_infinite_and_stays_bounded_where_its_command_is_limited():
    model, law, capacity, _ = loop_of(1, 1e3)
    long = Motions.of([np.random.default_rng(2).standard_normal(50_000)])
    linear = loop_extremes(model, law, long)
    assert np.isinf(linear.peak).all()
    assert np.isinf(linear.rms).all()
    limited = loop_extremes(model, law, long, capacity)
    assert limited.peak[0, -1] == capacity[0]
    assert np.isfinite(limited.rms).all()


def test_what_does_not_fit_is_refused():
    model, law, capacity, _ = loop_of(1, 1.0)
    with pytest.raises(AbraceError, match="capacities"):
        loop_extremes(model, law, motions(), np.append(capacity, 1.0))
    with pytest.raises(AbraceError, match=r"the controller gives U every 0\.002 s, the model takes U1, U2"):
        loop_extremes(loop_of(2, 1.0)[0], law, motions())
    with pytest.raises(AbraceError, match="a motion without samples"):
        Motions.of([np.zeros(0)])
    with pytest.raises(AbraceError, match="not finite at sample 3"):
        Motions.of([np.array([0.0, 0.0, 0.0, np.nan])])
