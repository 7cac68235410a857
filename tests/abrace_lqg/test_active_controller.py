# SPDX-License-Identifier: Apache-2.0
"""A force that comes in without a jump, whatever acted before, and changes laws without one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from interpreter import yields

from abrace_core import AbraceError
from abrace_core.model.controller_file import Controller
from abrace_core.model.linear_model import LinearModel
from abrace_lqg.active_controller import SETTLING_TIME, ActiveController
from abrace_lqg.control_law import ControlLaw

PERIOD, RAMP = 0.002, 0.5
STEPS, SETTLING = round(RAMP / PERIOD), round(SETTLING_TIME / PERIOD)
STEEPEST = np.pi / 2 / STEPS
NAMES = ("x1", "xf", "a1", "f")


def controller(name: str = "one", gain: float = 1000.0, commands: tuple[str, ...] = ("U",)) -> Controller:
    """A law whose command for a steady a1 = 1 converges to `gain`."""
    m = len(commands)
    law = LinearModel([[0.9]], [[0.1]], np.full((m, 1), gain), np.zeros((m, 1)), ("a1",), commands, PERIOD)
    limit = np.full(m, 1e5)
    return Controller(name, law, np.zeros((1, m)), np.zeros((1, 1 + m)), limit, "none", "none", "none")


def run(active: ActiveController, count: int, a1: float = 1.0) -> np.ndarray:
    """(count,) forces in answer to a steady a1."""
    found = []
    for _ in range(count):
        force = active.force((0.0, 0.0, a1, 0.0), 0).tolist()
        active.advance(force)
        found.append(force[0])
    return np.array(found)


def reset_controller(one: Controller, force: float = 0.0) -> ActiveController:
    active = ActiveController(one, RAMP)
    active.reset(NAMES, one.law.outputs, np.full(len(one.law.outputs), force))
    return active


@pytest.mark.parametrize("force", [0.0, -3000.0])
def test_the_force_fades_in_from_the_applied_one(force: float):
    found = np.concatenate([[force], run(reset_controller(controller(), force), STEPS + 5)])
    assert np.abs(np.diff(found)).max() < STEEPEST * (1000.0 - force) + 1e-9
    assert (np.diff(found[: STEPS + 1]) >= 0).all()
    np.testing.assert_allclose(found[STEPS:], 1000.0, rtol=1e-9)


def test_without_ramp_time_the_first_force_is_the_laws():
    one, active = controller(), ActiveController(controller(), 0.0)
    active.reset(NAMES, ("U",), np.zeros(1))
    law = ControlLaw(one, NAMES)
    for _ in range(20):
        expected = law.update((0.0, 0.0, 1.0, 0.0)).tolist()
        law.advance(expected)
        assert run(active, 1).tolist() == expected
    assert active.state == "in use"


def test_a_change_of_controller_has_no_jump_in_force():
    active = reset_controller(controller())
    before = run(active, STEPS + 10)[-1]
    active.prepare_change(controller("two", -2000.0))()
    assert (active.state, active.controller.name) == ("warming up", "two")
    np.testing.assert_allclose(run(active, SETTLING), before, rtol=1e-9, err_msg="nothing changes meanwhile")
    assert active.state == "fading in"
    found = np.concatenate([[before], run(active, STEPS)])
    assert np.abs(np.diff(found)).max() < STEEPEST * 3000.0 * 1.001
    assert found[-1] == pytest.approx(-2000.0)
    assert active.state == "in use"


def test_a_change_to_the_same_law_does_not_change_the_force():
    """Both estimates are updated with the applied force, so that they are equal."""
    active, alone = reset_controller(controller()), reset_controller(controller())
    random = np.random.default_rng(1)
    run(active, STEPS + 10)
    run(alone, STEPS + 10)
    active.prepare_change(controller())()
    for a1 in random.standard_normal(SETTLING + STEPS + 10):
        np.testing.assert_allclose(run(active, 1, a1), run(alone, 1, a1), atol=1e-9)


def test_both_estimates_are_updated_with_the_applied_force():
    one, two = controller(), replace(controller("two", 500.0), correction=np.array([[1e-4]]))
    active, parallel = reset_controller(one), ControlLaw(two, NAMES)
    run(active, STEPS + 10)
    active.prepare_change(two)()
    for a1 in np.random.default_rng(2).standard_normal(SETTLING + STEPS):
        force = np.clip(active.force((0.0, 0.0, a1, 0.0), 0), -100.0, 100.0).tolist()
        active.advance(force)
        parallel.update((0.0, 0.0, a1, 0.0))
        parallel.advance(force)
    assert active.state == "in use"
    np.testing.assert_array_equal(active.force((0.0, 0.0, 1.0, 0.0), 0), parallel.update((0.0, 0.0, 1.0, 0.0)))


def test_lost_samples_are_bridged():
    active, law = reset_controller(controller()), ControlLaw(controller(), NAMES)
    run(active, STEPS + 10, 0.0)
    for a1, lost in ((0.0, 0), (1.0, 0), (2.0, 4), (0.0, 0)):
        z = (0.0, 0.0, a1, 0.0)
        force = active.force(z, lost).tolist()
        active.advance(force)
        law.bridge(lost)
        assert force == law.update(z).tolist()
        law.advance(force)
    assert force[0] > 100, "the state moved"


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (replace(controller("two"), law=replace(controller().law, sample_period=0.004)), "sample period 0.004 s"),
        (replace(controller("two"), force_limit=np.array([5.0])), r"within \[5.0\] N, expected U within"),
        (replace(controller("two"), law=replace(controller().law, inputs=("a7",))), "two measures a7"),
        (controller("two", commands=("U1", "U2")), "two: U1, U2 within"),
    ],
)
def test_a_controller_that_does_not_fit_is_refused_and_nothing_changes(other: Controller, message: str):
    active = reset_controller(controller())
    before = run(active, STEPS + 10)[-1]
    with pytest.raises(AbraceError, match=message):
        active.prepare_change(other)
    assert (active.state, active.controller.name) == ("in use", "one")
    assert run(active, 1)[0] == pytest.approx(before)


def test_a_change_is_refused_before_the_first_sample_and_during_another():
    active = ActiveController(controller(), RAMP)
    with pytest.raises(AbraceError, match="one is waiting for samples, expected one in use"):
        active.prepare_change(controller("two"))
    active.reset(NAMES, ("U",), np.zeros(1))
    with pytest.raises(AbraceError, match="one is fading in"):
        active.prepare_change(controller("two"))
    run(active, STEPS + 1)
    active.prepare_change(controller("two"))()
    with pytest.raises(AbraceError, match="two is warming up"):
        active.prepare_change(controller("three"))


def test_after_a_fault_during_a_change_the_new_controller_is_in_use():
    active = reset_controller(controller())
    run(active, STEPS + 10)
    active.prepare_change(controller("two", 500.0))()
    active.reset(NAMES, ("U",), np.zeros(1))
    assert run(active, STEPS + 200)[-1] == pytest.approx(500.0)


def test_a_controller_for_another_rig_is_refused():
    with pytest.raises(AbraceError, match="gives U, the rig takes U1, U2"):
        ActiveController(controller(), RAMP).reset(NAMES, ("U1", "U2"), np.zeros(2))
    with pytest.raises(AbraceError, match="measures a1"):
        ActiveController(controller(), RAMP).reset(("x1", "f"), ("U",), np.zeros(1))


def test_the_innovation_is_reported_by_name():
    active = ActiveController(controller(), RAMP)
    assert active.innovation_rms() == {}
    active.reset(NAMES, ("U",), np.zeros(1))
    run(active, 100, 3.0)
    assert active.innovation_rms() == {"a1": pytest.approx(3.0)}, "nothing was expected"


def test_an_answer_keeps_the_interpreter():
    """Each time that it let it go, a second thread that is busy would delay it by some 0.1 ms; np.dot lets it go."""
    states, random = 10, np.random.default_rng(1)
    law = LinearModel(
        0.9 * np.eye(states),
        random.normal(size=(states, 3)),
        random.normal(size=(1, states)),
        np.zeros((1, 3)),
        ("x1", "a1", "f"),
        ("U",),
        PERIOD,
    )
    one = Controller("one", law, np.zeros((states, 1)), np.zeros((3, states + 1)), np.full(1, 1e5), "n", "n", "n")
    active = reset_controller(one)
    run(active, STEPS)
    active.prepare_change(replace(one, name="two"))()
    assert yields(lambda: run(active, 1), 2000) == 0


def test_a_measured_value_that_is_not_finite_is_named_and_one_that_no_law_measures_is_not():
    active = reset_controller(controller())
    active.require_finite(7, (np.nan, np.nan, 1.0, np.inf))
    with pytest.raises(AbraceError, match=r"^acceleration\[0\] of sample 8 is nan, expected a finite number$"):
        active.require_finite(8, (0.0, 0.0, np.nan, 0.0))
