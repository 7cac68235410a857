# SPDX-License-Identifier: Apache-2.0
"""Margins against loops whose crossings are known in closed form, and the closed loop against the step-by-step one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.linear_model import LinearModel
from abrace_core.model.simulation import simulate, simulate_closed_loop
from abrace_lqg.analysis.margins import common_gain_margin, margins, margins_at
from abrace_lqg.loop import Loop, closed_loop, is_stable, sampled

PERIOD = 0.01


def integrator() -> LinearModel:
    """x' = w + U, measured as y1."""
    return LinearModel(np.zeros((1, 1)), np.ones((1, 2)), np.eye(1), np.zeros((1, 2)), ("w", "U"), ("y1",))


def gain(factor: float) -> LinearModel:
    """U = factor y1, at once (one state that does nothing)."""
    zero = np.zeros((1, 1))
    return LinearModel(np.eye(1) / 2, zero, zero, np.array([[factor]]), ("y1",), ("U",), PERIOD)


def oscillator(frequency: float, damping: float) -> LinearModel:
    """x'' + 2 zeta omega x' + omega^2 x = w + U, measured as y1 = x'."""
    a = np.array([[0.0, 1.0], [-(frequency**2), -2 * damping * frequency]])
    b = np.array([[0.0, 0.0], [1.0, 1.0]])
    return LinearModel(a, b, np.array([[0.0, 1.0]]), np.zeros((1, 2)), ("w", "U"), ("y1",))


@pytest.mark.parametrize("k", [5.0, 40.0, 70.0])
def test_an_integrator_has_the_margins_of_its_closed_form(k: float):
    # L = k T / (z - 1) / z: |L| = k T / (2 sin(w T/2)), phase -90 degrees - 3 w T/2
    found = margins(integrator(), gain(-k))
    crossing = 2 * np.arcsin(k * PERIOD / 2) / PERIOD
    phase = np.pi / 2 - 1.5 * crossing * PERIOD
    assert found.gain_db == pytest.approx(-20 * np.log10(k * PERIOD), abs=1e-6)  # at w T = 60 degrees |L| is k T
    assert found.phase_deg == pytest.approx(np.degrees(phase), abs=1e-6)
    assert found.delay == pytest.approx(phase / crossing, rel=1e-8)


def test_a_loop_that_a_lower_gain_makes_unstable_has_that_as_its_margin():
    # an unstable first-order plant, x' = x + U: U = -k x needs k above a bound near 1
    plant = LinearModel(np.eye(1), np.ones((1, 2)), np.eye(1), np.zeros((1, 2)), ("w", "U"), ("y1",))
    found = margins(plant, gain(-1.5))
    least = 10 ** (-found.gain_db / 20)
    assert is_stable(plant, gain(-1.5 * least * 1.0001))
    assert not is_stable(plant, gain(-1.5 * least * 0.9999))


def test_the_sensitivity_peak_is_the_distance_from_the_critical_point():
    k = 40.0
    omega = np.linspace(1, np.pi / PERIOD, 400_000)
    z = np.exp(1j * omega * PERIOD)
    expected = np.abs(1 / (1 + k * PERIOD / (z - 1) / z)).max()
    assert margins(integrator(), gain(-k)).sensitivity_peak == pytest.approx(expected, rel=1e-4)


def test_a_lightly_damped_crossing_is_not_missed():
    # |L| is above 1 only in a band of 0.02 rad/s around the resonance, where its phase is far from -180 degrees
    plant = oscillator(20.0, 1e-4)
    found = margins(plant, gain(-0.008))
    assert found.delay < 1.0
    omega = np.linspace(19.9, 20.1, 200_001)
    loop = Loop(plant, gain(-0.008)).transfer_function("U", omega)
    crossings = np.flatnonzero(np.diff(np.abs(loop) > 1))
    assert len(crossings) == 2
    angles = np.mod(np.angle(-loop[crossings]), 2 * np.pi)
    assert found.phase_deg == pytest.approx(np.degrees(np.minimum(angles, 2 * np.pi - angles)).min(), abs=0.1)
    assert found.delay == pytest.approx((angles / omega[crossings]).min(), rel=1e-3)


def test_a_loop_below_unit_gain_has_no_phase_or_delay_margin_to_lose():
    found = margins(oscillator(20.0, 0.05), gain(-0.5))
    assert found.phase_deg == 180.0
    assert found.delay == np.inf


def test_negative_feedback_is_a_negative_controller():
    omega = np.array([3.0])
    z = np.exp(1j * omega * PERIOD)
    found = Loop(integrator(), gain(-2.0)).transfer_function("U", omega)
    np.testing.assert_allclose(found, 2 * PERIOD / (z - 1) / z)


def two_floors() -> tuple[LinearModel, LinearModel]:
    random = np.random.default_rng(3)
    a = random.standard_normal((4, 4)) - 4 * np.eye(4)
    model = LinearModel(
        a,
        random.standard_normal((4, 3)),
        random.standard_normal((3, 4)),
        random.standard_normal((3, 3)),
        ("w", "U1", "U2"),
        ("x1", "a1", "a2"),
        input_delay=(0.0, 0.004, 0.013),
    )
    controller = LinearModel(
        0.3 * np.eye(2),
        0.1 * random.standard_normal((2, 2)),
        random.standard_normal((2, 2)),
        0.1 * random.standard_normal((2, 2)),
        ("a2", "a1"),
        ("U1", "U2"),
        PERIOD,
    )
    return model, controller


def test_the_closed_loop_is_the_one_that_is_stepped_sample_by_sample():
    model, controller = two_floors()
    plant = sampled(model, PERIOD)
    ground = np.random.default_rng(1).standard_normal(300)
    outputs, commands = simulate_closed_loop(plant, controller, ground, np.full(2, 1e9))
    found = simulate(closed_loop(model, controller), ground[:, None])
    np.testing.assert_allclose(found[:, :3], outputs, atol=1e-10)
    # a command in force from sample k on is, at sample k+1, the one in force until there
    np.testing.assert_allclose(found[:-1, 3:], commands[1:], atol=1e-10)


def test_a_model_without_ground_motion_has_the_margins_of_that_with_it():
    model, controller = two_floors()
    commands = model.select(inputs=controller.outputs)
    assert closed_loop(commands, controller).inputs == model.select(inputs=()).inputs == ()
    assert margins(commands, controller).gain_db == pytest.approx(margins(model, controller).gain_db, rel=1e-9)


def test_margins_of_an_unstable_loop_are_refused():
    with pytest.raises(AbraceError, match="not stable"):
        margins(integrator(), gain(5.0))


def scaled(controller: LinearModel, name: str, factor: float) -> LinearModel:
    """The controller with a factor in one of its inputs or outputs."""
    b, c, d = controller.b.copy(), controller.c.copy(), controller.d.copy()
    if name in controller.inputs:
        b[:, controller.inputs.index(name)] *= factor
        d[:, controller.inputs.index(name)] *= factor
    else:
        c[controller.outputs.index(name)] *= factor
        d[controller.outputs.index(name)] *= factor
    return replace(controller, b=b, c=c, d=d)


def strong() -> tuple[LinearModel, LinearModel]:
    model, controller = two_floors()
    return model, replace(controller, c=2 * controller.c, d=3 * controller.d)


@pytest.mark.parametrize("name", ["U1", "U2", "a2", "a1"])
def test_the_loop_broken_at_one_signal_reaches_its_edge_where_that_gain_margin_says(name: str):
    model, controller = strong()
    edge = 10 ** (margins_at(model, controller)[name].gain_db / 20)
    assert 1.05 < edge < 1e3
    assert all(is_stable(model, scaled(controller, name, factor)) for factor in (0.9999 * edge, 1.0001 / edge))
    assert not all(is_stable(model, scaled(controller, name, factor)) for factor in (1.0001 * edge, 0.9999 / edge))


def test_the_loop_broken_at_one_signal_is_the_plant_with_the_others_closed():
    model, controller = strong()
    omega = np.array([0.7, 12.0, 200.0])
    z = np.exp(1j * omega * PERIOD)
    plant = sampled(model, PERIOD).select(controller.inputs, controller.outputs).frequency_response(omega)
    law = controller.frequency_response(omega)
    found = Loop(model, controller).transfer_function("U1", omega)
    for k in range(len(omega)):
        # U2 closed by hand: u2 = l22 u2 + l21 u1, then u1 -> l11 u1 + l12 u2
        loop = law[k] @ plant[k] / z[k]
        expected = -(loop[0, 0] + loop[0, 1] * loop[1, 0] / (1 - loop[1, 1]))
        np.testing.assert_allclose(found[k], expected, rtol=1e-10)


def test_the_margin_of_all_commands_together_is_where_they_all_leave_stability():
    model, controller = strong()
    found = common_gain_margin(model, controller)
    for share, stable in ((0.999, True), (1.001, False)):
        edges = [10 ** (sign * share * found / 20) for sign in (1, -1)]
        both = [is_stable(model, replace(controller, c=e * controller.c, d=e * controller.d)) for e in edges]
        assert all(both) is stable
    one = integrator(), gain(-40.0)
    assert common_gain_margin(*one) == pytest.approx(margins(*one).gain_db, abs=2e-3)
    with pytest.raises(AbraceError, match="the closed loop is not stable"):
        common_gain_margin(integrator(), gain(-200.0))


def test_a_signal_that_the_loop_does_not_have_is_refused():
    with pytest.raises(AbraceError, match="'a3': expected one of U1, U2, a2, a1"):
        margins_at(*strong(), ["a3"])
    with pytest.raises(AbraceError, match="'a3': expected one of"):
        Loop(*strong()).transfer_function("a3", np.ones(1))


def test_a_loop_with_poles_that_coincide_is_evaluated_all_the_same():
    # a double integrator has no basis of eigenvectors
    a = np.array([[0.0, 1.0], [0.0, 0.0]])
    b = np.array([[0.0, 0.0], [1.0, 1.0]])
    plant = LinearModel(a, b, np.array([[1.0, 0.0], [0.0, 1.0]]), np.zeros((2, 2)), ("w", "U"), ("y1", "y2"))
    law = LinearModel(
        np.eye(1) / 2, np.zeros((1, 2)), np.zeros((1, 1)), np.array([[-4.0, -6.0]]), ("y1", "y2"), ("U",), PERIOD
    )
    omega = np.array([3.0])
    z = np.exp(1j * omega * PERIOD)
    # held: x1 = T^2/2 (z + 1)/(z - 1)^2 u, x2 = T/(z - 1) u
    expected = (4 * PERIOD**2 / 2 * (z + 1) / (z - 1) ** 2 + 6 * PERIOD / (z - 1)) / z
    np.testing.assert_allclose(Loop(plant, law).transfer_function("U", omega), expected, rtol=1e-8)
    assert is_stable(plant, law)
    assert margins(plant, law).phase_deg > 30


def test_a_response_that_is_not_finite_has_no_margins_but_an_error():
    with (
        np.errstate(divide="ignore", invalid="ignore"),
        pytest.raises(AbraceError, match="no finite response at 0 rad/s"),
    ):
        Loop(integrator(), gain(-1.0)).components(np.array([0.0]))


def test_a_model_of_another_sample_period_is_refused():
    with pytest.raises(AbraceError, match=r"sample period 0\.01 s, expected 0\.02 s, the rig's, or a whole"):
        closed_loop(sampled(integrator(), 0.02), gain(-1.0))
