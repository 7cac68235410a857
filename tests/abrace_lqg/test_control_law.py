# SPDX-License-Identifier: Apache-2.0
"""The run-time law is Eq. (13) without limits, and an observer of the applied command where it is limited."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from abrace_core import AbraceError
from abrace_core.model.controller_file import Controller
from abrace_core.model.linear_model import LinearModel
from abrace_core.model.simulation import simulate, simulate_closed_loop
from abrace_lqg.control_law import INNOVATION_WINDOW, ControlLaw
from abrace_lqg.design import ControllerDesign, design
from abrace_lqg.loop import sampled
from abrace_lqg.weights import load_weights

PERIOD = 0.002
NAMES = ("a1", "a2", "a3")
LQG3 = Path(__file__).parents[2] / "src/abrace_lqg/config/lqg3.yaml"


def random_controller(commands: int = 2) -> Controller:
    random = np.random.default_rng(5)
    a = 0.2 * random.standard_normal((6, 6))
    b, c, d = (random.standard_normal(shape) for shape in ((6, 3), (commands, 6), (commands, 3)))
    law = LinearModel(a, b, c, d, NAMES, tuple(f"U{i + 1}" for i in range(commands)), PERIOD)
    correction, prediction = random.standard_normal((6, commands)), random.standard_normal((3, 6 + commands))
    return Controller("random", law, correction, prediction, np.full(commands, 1e4), "none", "none", "none")


def frame() -> LinearModel:
    """One storey with an active brace: w and U to x1, xf, a1, f, where f carries some of U at once."""
    omega, zeta, mass = 8.0, 0.02, 1e4
    a = np.array([[0.0, 1.0], [-(omega**2), -2 * zeta * omega]])
    b = np.array([[0.0, 0.0], [-1.0, 1 / mass]])
    c = np.array([[1.0, 0.0], [0.8, 0.0], [-(omega**2), -2 * zeta * omega], [0.0, -100.0]])
    d = np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 1 / mass], [0.0, 1.0]])
    return LinearModel(a, b, c, d, ("w", "U"), ("x1", "xf", "a1", "f"), input_delay=(0.0, 0.0008))


def frame_design() -> ControllerDesign:
    weights = load_weights(LQG3).model_copy(update={"measured": ["a1"], "relative": {"a1": 0.3}})
    return design(frame(), weights, PERIOD)


def frame_controller() -> Controller:
    made = frame_design()
    limit = np.array([500.0])
    return Controller("frame", made.controller, made.correction, made.prediction, limit, "none", "none", "none")


def samples(count: int, seed: int = 6) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((count, 3))


def answers(law: ControlLaw, y: np.ndarray) -> np.ndarray:
    """The commands, each applied without a limit."""
    found = []
    for row in y:
        found.append(law.update(row.tolist()).tolist())
        law.advance(found[-1])
    return np.array(found)


def test_without_limits_it_gives_the_response_of_eq_13():
    controller, y = random_controller(), samples(200)
    expected = simulate(controller.law, y)
    np.testing.assert_allclose(answers(ControlLaw(controller, NAMES), y), expected, rtol=1e-10, atol=1e-12)


def test_it_picks_its_quantities_by_name():
    controller = random_controller()
    names = ("x1", "a3", "a1", "a2")
    found = ControlLaw(controller, names).update([9.0, 3.0, 1.0, 2.0])
    np.testing.assert_array_equal(found, ControlLaw(controller, NAMES).update([1.0, 2.0, 3.0]))
    with pytest.raises(AbraceError, match="measures a2, a3, expected some of x1, a1"):
        ControlLaw(controller, ("x1", "a1"))


def test_the_estimate_is_that_of_a_filter_with_the_limited_command_as_input():
    """Tustin's transformation by scipy of the filter q' = (A - L C) q + (B - L D) u + L y, u left open."""
    made, controller = frame_design(), frame_controller()
    plant = made.design_model.select(["a1"])
    gain, b, d = made.filter_gain, plant.b[:, 1:], plant.d[:, 1:]
    filtered = (plant.a - gain @ plant.c, np.hstack([b - gain @ d, gain]), -made.regulator_gain, np.zeros((1, 2)))
    a, b, c, d, _ = signal.cont2discrete(filtered, PERIOD, "bilinear")
    q, law = np.zeros(len(a)), ControlLaw(controller, ["a1"])
    cut = 0
    for y in np.random.default_rng(7).standard_normal(2000):
        # u = c q + d [u; y] for u, as the filter's own loop gives it
        expected = (c @ q + d[:, 1] * y) / (1 - d[:, 0])
        found = law.update([y]).copy()
        np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-8 * 500)
        force = np.clip(found, -500.0, 500.0)
        cut += (found != force).any()
        law.advance(force.tolist())
        q = a @ q + b @ [force[0], y]
    assert 100 < cut < 1900, "cut now and then"


def test_after_saturation_the_law_recovers_at_once_where_eq_13_alone_has_wound_up():
    controller = frame_controller()
    law, wound_up, free = (ControlLaw(controller, ["a1"]) for _ in range(3))
    # a slow quantity that keeps the command at its limit, and then is gone
    for y in [2.0] * 1000 + [0.0] * 50:
        force = np.clip(law.update([y]), -500.0, 500.0).tolist()
        law.advance(force)
        wound_up.advance(wound_up.update([y]).tolist())
        # the same observer with the applied force
        free.update([y])
        free.advance(force)
    np.testing.assert_array_equal(law.update([0.0]), free.update([0.0]))
    assert abs(wound_up.update([0.0])[0] - law.update([0.0])[0]) > 10, "expected Eq. (13) alone to wind up"


def test_it_runs_as_the_closed_loop_is_simulated_saturated_or_not():
    controller = frame_controller()
    plant = sampled(frame(), PERIOD)
    ground = 2 * np.random.default_rng(3).standard_normal(1500)
    outputs, commands = simulate_closed_loop(plant, controller.law, ground, np.array([500.0]), controller.correction)
    law, found = ControlLaw(controller, plant.outputs), []
    for row in outputs[:-2]:
        found.append(np.clip(law.update(row.tolist()), -500.0, 500.0).tolist())
        law.advance(found[-1])
    np.testing.assert_allclose(found, commands[2:], atol=1e-7)
    assert 0.02 < np.mean(np.abs(commands) == 500.0) < 0.98


def test_the_innovation_vanishes_where_the_rig_is_the_design_model_and_the_ground_is_still():
    """The estimate is then exact: the design model, stepped by Tustin's rule, starts from the estimate's state."""
    made, controller = frame_design(), frame_controller()
    plant = made.design_model.select(["a1"])
    model = (plant.a, plant.b[:, 1:], plant.c, plant.d[:, 1:])
    a, b, c, d, _ = signal.cont2discrete(model, PERIOD, "bilinear")
    law, q = ControlLaw(controller, ["a1"]), np.zeros(len(a))
    for u in 300 * np.sin(0.05 * np.arange(500)):
        law.update((c @ q + d @ [u]).tolist())
        law.advance([u])
        q = a @ q + b @ [u]
    assert law.innovation_rms()[0] < 1e-9 * np.abs(c @ q).max()


def test_the_innovation_is_the_rms_of_measured_minus_expected_values():
    controller = random_controller()
    law, q, innovations = ControlLaw(controller, NAMES), np.zeros(6), []
    np.testing.assert_array_equal(law.innovation_rms(), 0.0)
    for y in samples(300):
        command = controller.law.c @ q + controller.law.d @ y
        force = np.clip(command, -2.0, 2.0)
        law.update(y.tolist())
        law.advance(force.tolist())
        innovations.append(y - controller.prediction @ np.concatenate([q, force]))
        q = controller.law.a @ q + controller.law.b @ y + controller.correction @ (force - command)
    expected = np.sqrt(np.mean(np.array(innovations) ** 2, axis=0))
    np.testing.assert_allclose(law.innovation_rms(), expected, rtol=1e-10)


def test_the_rms_of_the_innovation_is_that_of_the_last_samples():
    law = ControlLaw(random_controller(), NAMES)
    answers(law, 1e6 * samples(10))
    answers(law, samples(INNOVATION_WINDOW + 200, 8))
    assert law.innovation_rms().max() < 1e4


def test_over_lost_samples_the_last_values_and_the_force_hold():
    controller = random_controller()
    law, expected_law = ControlLaw(controller, NAMES), ControlLaw(controller, NAMES)
    answers(law, samples(10))
    command = answers(expected_law, samples(10))[-1].tolist()
    law.bridge(3)
    for _ in range(3):
        expected_law.update(samples(10)[-1].tolist())
        expected_law.advance(command)
    y = samples(1, 9)
    np.testing.assert_array_equal(answers(law, y), answers(expected_law, y))
