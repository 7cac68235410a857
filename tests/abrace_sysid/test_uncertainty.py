# SPDX-License-Identifier: Apache-2.0
"""What intervals, orders and pooled poles promise, on data enough to tell: each fails if its rule is weakened."""

import numpy as np
import pytest

from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import LinearModel
from abrace_core.model.model_ensemble import draw_models
from abrace_sysid.fitting.maximum_likelihood import fit_poles
from abrace_sysid.fitting.observation import Observation
from abrace_sysid.fitting.options import IdentificationOptions
from abrace_sysid.fitting.servo_forms import rig_modes
from abrace_sysid.identification import identify
from abrace_sysid.models.modal import modal_covariance, modal_model
from abrace_sysid.recorded.test import Test
from abrace_sysid.spectra.frequency_response import FrequencyResponse

PAIRS = ((8.0, 0.1), (21.0, 0.1))
"""Frequency [rad/s] and damping ratio of a plant of two modes."""

NOISE = 0.01
"""Of each channel, over its rms."""

SIX_MODES = IdentificationOptions(modes=6)
"""As many as the paper's rig has: no other number is tried."""


@pytest.fixture(scope="module")
def plant() -> LinearModel:
    a = np.zeros((4, 4))
    for i, (frequency, damping) in enumerate(PAIRS):
        a[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[0.0, 1.0], [-(frequency**2), -2 * damping * frequency]]
    b = np.array([[0.0], [1.0], [0.0], [1.0]])
    c = np.array([[0.0, 1.0, 0.0, 0.7], [0.0, 0.6, 0.0, -1.0]])
    return LinearModel(a, b, c, np.zeros((2, 1)), ("U",), ("v1", "v2"))


def measured(plant: LinearModel, lines: int, seed: int) -> FrequencyResponse:
    """Independent lines with noise, as a periodic test gives them."""
    omega = np.linspace(2.0, 40.0, lines)
    exact = discretize(plant, 0.02).frequency_response(omega)[:, :, 0]
    sigma = np.full(exact.shape, NOISE * np.sqrt(np.mean(np.abs(exact) ** 2, axis=0)))
    real, imaginary = np.random.default_rng(seed).standard_normal((2, *exact.shape)) / np.sqrt(2)
    return FrequencyResponse("U", plant.outputs, omega, exact + sigma * (real + 1j * imaginary), sigma, 0.02, "noisy")


def errors(plant: LinearModel, lines: int, seeds: int) -> tuple[np.ndarray, float]:
    """Errors of frequencies and damping ratios in standard deviations, and the share within their 95 % intervals."""
    poles = plant.poles
    scaled, inside = [], []
    for seed in range(seeds):
        observation = Observation.of_response(measured(plant, lines, seed), "noisy")
        for pair, (frequency, damping) in zip(
            fit_poles([observation], poles[poles.imag > 0]).pairs(), PAIRS, strict=True
        ):
            for found, true, deviation, (low, high) in (
                (pair.frequency, frequency, pair.frequency_deviation, pair.frequency_interval),
                (pair.damping, damping, pair.damping_deviation, pair.damping_interval),
            ):
                scaled.append((found - true) / deviation)
                inside.append(low <= true <= high)
    return np.array(scaled), float(np.mean(inside))


def test_deviations_and_intervals_are_neither_too_narrow_nor_too_wide(plant):
    scaled, inside = errors(plant, lines=300, seeds=150)
    rms = np.sqrt(np.mean(scaled**2))
    assert 0.9 < rms < 1.1, f"errors are {rms:.2f} standard deviations, rms of {len(scaled)}"
    assert 0.93 < inside < 0.97, f"{inside:.1%} of {len(scaled)} intervals hold the true value"


def test_deviations_of_few_lines_allow_for_their_leverage(plant):
    # without MacKinnon and White's correction 1.57
    scaled, _ = errors(plant, lines=20, seeds=150)
    rms = np.sqrt(np.mean(scaled**2))
    assert rms < 1.42, f"errors are {rms:.2f} standard deviations, rms of {len(scaled)}"


def test_no_pole_is_found_in_noise(plant):
    found = []
    for seed in range(15):
        found.append(len(rig_modes([Observation.of_response(measured(plant, 300, seed), "noisy")])))
    assert found == [len(PAIRS)] * 15


@pytest.fixture(scope="module")
def pooled(rig, laboratory_of):
    return identify(laboratory_of(rig, 1).table_test(60), laboratory_of(rig, 2).command_test(60), SIX_MODES)


def test_the_poles_of_both_tests_answer_to_each_of_them(rig, laboratory_of, pooled):
    one, other = laboratory_of(rig, 1), laboratory_of(rig, 2)
    tests = {
        "table": (other.table_test(60), other.command_test(60)),
        "command": (one.table_test(60), one.command_test(60)),
    }
    for changed, both in tests.items():
        moved = [
            abs(pair.frequency - before.frequency) / before.frequency_deviation
            for pair, before in zip(
                identify(*both, SIX_MODES).poles.common_pairs[1:3], pooled.poles.common_pairs[1:3], strict=True
            )
        ]
        assert max(moved) > 0.1, f"another {changed} test moves the poles by {moved} standard deviations"


def with_friction(seeds: int, seconds: float = 160.0, period: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    """(seeds, samples) noise, and the velocity that it gives an oscillator of 8 rad/s and 4 % with Coulomb friction."""
    excitation = np.stack([np.random.default_rng(seed).standard_normal(int(seconds / period)) for seed in range(seeds)])
    displacement, velocity, found, step = np.zeros(seeds), np.zeros(seeds), np.zeros(excitation.shape), period / 20
    for k in range(excitation.shape[1]):
        found[:, k] = velocity
        for _ in range(20):
            force = excitation[:, k] - 64.0 * displacement - 0.64 * velocity - 0.08 * np.sign(velocity)
            velocity = velocity + step * force
            displacement = displacement + step * velocity
    return excitation, found


def test_deviations_hold_what_friction_does_to_the_best_linear_approximation():
    # by lines alone, as if the distortion of one line knew nothing of the others': damping 1.6, frequency 0.7
    excitation, velocity = with_friction(seeds=60)
    found = []
    for seed, (u, v) in enumerate(zip(excitation, velocity, strict=True)):
        noisy = v + 1e-4 * np.random.default_rng(1000 + seed).standard_normal(len(v))
        test = Test("friction", 0.05, ("U",), ("v",), u[:, None], noisy[:, None], hold="zero")
        observation = Observation.of_test(test, ["U"], (0.3, 4.0))
        (pair,) = fit_poles([observation], np.array([-0.5 + 8.0j])).pairs()
        found.append((pair.frequency, pair.damping, pair.frequency_deviation, pair.damping_deviation))
    values, deviations = np.split(np.array(found), 2, axis=1)
    frequency, damping = np.sqrt(np.mean(((values - values.mean(axis=0)) / deviations) ** 2, axis=0))
    assert values[:, 1].mean() > 0.05, "friction adds damping"
    assert damping < 1.4, f"errors of damping are {damping:.2f} standard deviations, rms"
    assert 0.85 < frequency < 1.3, f"errors of frequency are {frequency:.2f} standard deviations, rms"


def test_models_drawn_from_the_joint_covariance_scatter_as_those_of_other_tests_do(plant):
    poles, omega = plant.poles, np.linspace(4.0, 30.0, 25)
    fits = [
        fit_poles([Observation.of_response(measured(plant, 300, seed), "noisy")], poles[poles.imag > 0], spread="joint")
        for seed in range(50)
    ]
    models = [modal_model(fit, {}).frequency_response(omega)[:, :, 0] for fit in fits]
    drawn_models = draw_models(modal_model(fits[0], {}), modal_covariance(fits[0]), 50, 1)
    drawn = [one.frequency_response(omega)[:, :, 0] for one in drawn_models]
    ratio = np.std(drawn, axis=0) / np.std(models, axis=0)
    assert 0.9 < np.sqrt(np.mean(ratio**2)) < 1.1, f"drawn models scatter {ratio.mean():.2f} times as much"
    assert ratio.min() > 0.6, ratio
    assert ratio.max() < 1.5, ratio


def test_the_poles_of_both_tests_are_as_good_as_those_of_the_better_one(pooled):
    # the noise of the table's accelerometer goes to all channels: eight of them do not count eight times
    together = pooled.poles.common_pairs[0]
    best = min(pairs[0].damping_deviation for pairs in (pooled.poles.table_pairs, pooled.poles.command_pairs))
    assert together.damping_deviation < 1.05 * best, (together.damping_deviation, best)
