# SPDX-License-Identifier: Apache-2.0
"""A controller that answers every n-th sample of its rig, its command held in between: simulated, proven, run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

import abrace
from abrace_core import AbraceError
from abrace_core.model.controller_file import Controller, load_controller, save_controller
from abrace_core.model.lifting import divisor
from abrace_core.model.signals import response_names
from abrace_core.model.simulation import simulate_closed_loop
from abrace_lqg.active_controller import ActiveController
from abrace_lqg.analysis.margins import common_gain_margin, margins_at
from abrace_lqg.analysis.mode_damping import mode_effects
from abrace_lqg.analysis.prediction import Excitation, predicted_rms
from abrace_lqg.design import delayed
from abrace_lqg.design import design as design_controller
from abrace_lqg.loop import Loop, closed_loop, open_loop
from abrace_lqg.weights import load_weights
from abrace_plant.rig.file import load_rig

if TYPE_CHECKING:
    from abrace_core.model.linear_model import LinearModel

RIG = "ncree_three_storey"
PERIOD, HELD = 0.002, 5
LIMIT = np.array([900.0])
SOURCES = Path(__file__).parents[2] / "src"
RIG_FILE, WEIGHTS = SOURCES / f"abrace_plant/config/{RIG}.yaml", SOURCES / "abrace_lqg/config/lqg3.yaml"


@pytest.fixture(scope="module")
def plant() -> LinearModel:
    return load_rig(RIG_FILE).discrete_model()


@pytest.fixture(scope="module")
def design() -> abrace.Design:
    return abrace.design(RIG, "lqg3", sample_period=HELD * PERIOD)


def stepped(
    plant: LinearModel, law: LinearModel, correction: np.ndarray, ground: np.ndarray, limit: float
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs, and commands in force until each sample, computed sample by sample."""
    x, q, acting, next_one = np.zeros(plant.order), np.zeros(law.order), np.zeros(1), np.zeros(1)
    measured = [plant.outputs.index(name) for name in law.inputs]
    outputs, commands, until = [], [], np.zeros(1)
    for k, w in enumerate(ground):
        acting = next_one
        u = np.concatenate([[w], acting])
        y = plant.c @ x + plant.d @ u
        outputs.append(y)
        commands.append(until)
        until = acting
        if k % HELD == 0:
            wanted = law.c @ q + law.d @ y[measured]
            next_one = np.clip(wanted, -limit, limit)
            q = law.a @ q + law.b @ y[measured] + correction @ (next_one - wanted)
        x = plant.a @ x + plant.b @ u
    return np.array(outputs), np.array(commands)


@pytest.mark.parametrize("samples", [1, 2, 6, 1003])
def test_the_simulated_loop_is_the_loop_as_it_is_stepped(
    plant: LinearModel, design: abrace.Design, samples: int
) -> None:
    ground = np.random.default_rng(2).normal(size=samples)
    controller = design.controller
    expected = stepped(plant, controller.law, controller.correction, ground, LIMIT[0])
    found = simulate_closed_loop(plant, controller.law, ground, LIMIT, controller.correction)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9 * max(np.abs(other).max(), 1e-3))
    assert samples < 1000 or (np.abs(found[1]) == LIMIT).mean() > 0.1, "much of what it wants is cut"


def monodromy(plant: LinearModel, law: LinearModel, gain: float) -> np.ndarray:
    """Of states, law, command in force: over one of the law's samples, by the steps of the rig."""
    order, states = plant.order, law.order
    c = plant.c[[plant.outputs.index(name) for name in law.inputs]]
    d = plant.d[[plant.outputs.index(name) for name in law.inputs], 1:]
    eye = np.eye(order + states + 2)  # state, law, command in force, the next one
    acting, coming = slice(order + states, order + states + 1), slice(order + states + 1, None)
    step, answer, change = eye.copy(), eye.copy(), eye.copy()
    change[acting], change[acting, coming], change[acting, acting] = 0.0, 1.0, 0.0
    step[:order, :order], step[:order, acting] = plant.a, plant.b[:, 1:]
    answer[order : order + states, :order], answer[order : order + states, acting] = law.b @ c, law.b @ d
    answer[order : order + states, order : order + states] = law.a
    answer[coming] = gain * np.hstack([law.d @ c, law.c, law.d @ d, np.zeros((1, 1))])
    whole = eye
    for k in range(HELD):
        whole = step @ (answer if k == 0 else eye) @ change @ whole
    return whole


def test_the_poles_are_those_of_the_monodromy_matrix(plant: LinearModel, design: abrace.Design) -> None:
    law = design.controller.law
    found = np.linalg.eigvals(closed_loop(plant, law).a)
    expected = np.linalg.eigvals(monodromy(plant, law, 1.0))
    distance = np.abs(found[:, None] - expected).min(axis=1)
    assert distance[np.abs(found) > 1e-3].max() < 1e-7
    assert design.proof.models[0].stable


def test_the_margins_are_where_the_stepped_loop_becomes_unstable(plant: LinearModel, design: abrace.Design) -> None:
    law = design.controller.law
    margin = common_gain_margin(plant, law)
    assert margins_at(plant, law)["U"].gain_db == pytest.approx(margin, abs=0.01)
    growth = [
        np.abs(np.linalg.eigvals(monodromy(plant, law, 10 ** (db / 20)))).max() for db in (margin - 0.1, margin + 0.1)
    ]
    lower = [
        np.abs(np.linalg.eigvals(monodromy(plant, law, 10 ** (-db / 20)))).max() for db in (margin - 0.1, margin + 0.1)
    ]
    assert max(growth[0], lower[0]) < 1 < max(growth[1], lower[1])
    assert design.proof.margins.gain_db <= margin + 0.01
    for signal in ("U", "a1"):
        broken, omega = open_loop(plant, law, signal), np.array([3.0, 30.0, 300.0])
        whole = Loop(plant, law).transfer_function(signal, omega)
        np.testing.assert_allclose(broken.frequency_response(omega)[:, 0, 0], whole, rtol=1e-6)


def test_a_command_that_acts_after_a_sample_of_the_rig_leaves_more_than_one_that_acts_after_one_of_its_own(
    plant: LinearModel, design: abrace.Design
) -> None:
    rig, law = load_rig(RIG_FILE), design.controller.law
    slow = margins_at(rig.model, law)["U"]
    assert margins_at(plant, law)["U"].delay == pytest.approx(slow.delay + (HELD - 1) * PERIOD, rel=0.1)


def test_the_predicted_rms_is_that_of_the_stepped_loop(plant: LinearModel, design: abrace.Design) -> None:
    law, frequency = design.controller.law, 7.0
    time = PERIOD * np.arange(30_000)
    outputs, commands = stepped(plant, law, np.zeros((law.order, 1)), np.sin(2 * np.pi * frequency * time), np.inf)
    predicted = predicted_rms(plant, law, Excitation(np.sqrt(0.5), (frequency - 1e-4, frequency + 1e-4)))
    whole = slice(-10_000, None)  # of its periods
    for name, values in zip(plant.outputs, outputs[whole].T, strict=True):
        assert predicted[name] == pytest.approx(np.sqrt(np.mean(values**2)), rel=1e-3), name
    assert predicted["U"] == pytest.approx(np.sqrt(np.mean(commands[whole] ** 2)), rel=1e-3)


def test_a_mode_beyond_half_the_controllers_rate_keeps_its_frequency(plant: LinearModel, design: abrace.Design) -> None:
    own = np.log(np.linalg.eigvals(plant.a).astype(complex)) / PERIOD
    fast = 2 * np.pi * 70.0
    pole = np.exp(PERIOD * fast * (-0.02 + 1j * np.sqrt(1 - 0.02**2)))
    a = np.zeros((plant.order + 2, plant.order + 2))
    a[:-2, :-2], a[-2:, -2:] = plant.a, [[pole.real, pole.imag], [-pole.imag, pole.real]]
    b, c = np.vstack([plant.b, np.zeros((2, 2))]), np.hstack([plant.c, np.zeros((len(plant.c), 2))])
    found = mode_effects(replace(plant, a=a, b=b, c=c), design.controller.law, plant)
    (effect,) = [one for one in found if one.frequency == pytest.approx(fast)]
    assert effect.damping == pytest.approx(0.02)
    assert (effect.controlled_frequency, effect.damping_kept) == (pytest.approx(fast), pytest.approx(1.0))
    slowest = min(own[own.imag > 1.0], key=abs)
    assert found[0].frequency == pytest.approx(abs(slowest))
    assert found[0].controlled_damping > 0.05


def test_the_file_says_for_which_rig_it_was_made(design: abrace.Design, tmp_path: Path) -> None:
    for name in ("lqg3.yaml", "lqg3.mat"):
        save_controller(design.controller, tmp_path / name)
        read = load_controller(tmp_path / name)
        assert (read.law.sample_period, read.rig_period) == (HELD * PERIOD, PERIOD)
    assert "    rig_period: 0.002\n" in (tmp_path / "lqg3.yaml").read_text()
    save_controller(abrace.design(RIG, "lqg3").controller, tmp_path / "own.yaml")
    assert "rig_period" not in (tmp_path / "own.yaml").read_text()


def test_a_rate_that_is_no_part_of_the_rigs_is_refused(design: abrace.Design) -> None:
    wrong = r"0\.003 s, expected 0\.002 s, the rig's, or a whole multiple of it"
    with pytest.raises(AbraceError, match=f"sample_period: {wrong}"):
        abrace.design(RIG, "lqg3", sample_period=0.003)
    law = replace(design.controller.law, sample_period=0.003)
    own = replace(design.controller, law=law, rig_period=0.0)
    with pytest.raises(AbraceError, match=f"controller lqg3: sample period {wrong}"):
        abrace.simulate(RIG, np.zeros(100), controller=own)
    with pytest.raises(AbraceError, match=r"controller lqg3: made for a rig that samples every 0\.002 s, not 0\.005 s"):
        design.controller.of_rig(0.005)
    assert [divisor(0.01, period) for period in (0.01, 0.002, 0.005)] == [1, 5, 2]


def test_it_is_designed_for_the_delay_of_the_rig_and_its_own_hold() -> None:
    model, weights = load_rig(RIG_FILE).model, load_weights(WEIGHTS)
    whole = PERIOD + HELD * PERIOD / 2
    found = design_controller(model, weights, HELD * PERIOD, PERIOD).design_model
    omega = np.array([7.0, 38.0, 200.0])
    expected = delayed(model, whole / 1.5, whole / 1.5).frequency_response(omega)
    np.testing.assert_allclose(found.frequency_response(omega), expected, rtol=1e-6, atol=1e-15)


def active(controller: Controller, ramp_time: float = 0.0) -> ActiveController:
    found = ActiveController(controller, ramp_time)
    found.reset(response_names(3, 1), ("U",), np.zeros(1))
    return found


def test_it_answers_every_nth_sample_and_goes_on_with_the_mean_of_what_was_applied(design: abrace.Design) -> None:
    random = np.random.default_rng(6)
    samples = random.normal(size=(4 * HELD, 8))
    one, law = active(design.controller), design.controller.law
    q, picked = np.zeros(law.order), samples[:, [response_names(3, 1).index(name) for name in law.inputs]]
    one.force([0.0] * 8, 0)  # the fade of no samples begins with the second answer
    for k in range(HELD):
        one.advance([0.0])
        if k < HELD - 1:
            one.force([1.0] * 8, 0)
    for k, values in enumerate(samples):
        found = one.force(values.tolist(), 0).tolist()
        if k % HELD == 0:
            expected = law.c @ q + law.d @ picked[k]
            applied = []
        np.testing.assert_allclose(found, expected, rtol=1e-9)
        applied.append(found[0] + random.normal())
        one.advance([applied[-1]])
        if k % HELD == HELD - 1:
            first = picked[k - HELD + 1]
            q = law.a @ q + law.b @ first + design.controller.correction @ (np.mean(applied) - expected)


@pytest.mark.parametrize("lost", [*range(1, 12)])
def test_over_lost_samples_it_keeps_to_its_samples(design: abrace.Design, lost: int) -> None:
    """The same as a controller of its own rate that loses those of them that it answers."""
    controller, random = design.controller, np.random.default_rng(7)
    alone = ActiveController(replace(controller, rig_period=0.0), 0.0)
    alone.reset(response_names(3, 1), ("U",), np.zeros(1))
    one, samples = active(controller), random.normal(size=(40, 8))
    received = [k for k in range(40) if not 12 < k <= 12 + lost]
    missing, before = 0, -1
    for k in received:
        gap = k - before - 1
        missing += sum(number % HELD == 0 for number in range(before + 1, k))
        before = k
        found = one.force(samples[k].tolist(), gap).tolist()
        one.advance(found)
        if k % HELD == 0:
            expected = alone.force(samples[k].tolist(), missing).tolist()
            alone.advance(expected)
            missing = 0
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-6)


def test_a_rig_is_controlled_by_a_fifth_of_its_samples(design: abrace.Design) -> None:
    motion = {"peak_acceleration": 0.98, "duration": 12.0}
    free = abrace.simulate(RIG, "el_centro", **motion)
    controlled = abrace.simulate(RIG, "el_centro", controller=design, **motion)
    fast = abrace.simulate(RIG, "el_centro", controller=abrace.design(RIG, "lqg3"), **motion)
    assert controlled["x3"].std() < 0.6 * free["x3"].std()
    assert controlled["x3"].std() == pytest.approx(fast["x3"].std(), rel=0.25)
    steps = np.flatnonzero(np.diff(controlled.command[600:, 0]))
    assert set(np.diff(steps).tolist()) == {HELD}
    model = abrace.simulate(abrace.load_rig(RIG).model, "el_centro", controller=design, **motion)
    assert model.sample_period == PERIOD
    assert model["x3"].std() == pytest.approx(controlled["x3"].std(), rel=0.1)
    assert abrace.margins(RIG, design).gain_db >= design.proof.margins.gain_db - 0.01
