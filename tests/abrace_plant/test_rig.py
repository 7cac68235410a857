# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import linalg

from abrace_core.model.linear_model import pole_table
from abrace_core.safety.table_stop import Table
from abrace_plant.rig.actuator import Actuator
from abrace_plant.rig.building import Building, modal_damping
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.model import BraceGroup, LocalMode, Rig
from abrace_plant.rig.sensors import Sensor, SensorSet

RIG = load_rig(Path(__file__).parents[2] / "src/abrace_plant/config/ncree_three_storey.yaml")

# what the paper prints (rad/s and damping ratios; A2's further pairs as poles; Table 1's shape)

MASS, OMEGA, ZETA = 2000.0, 7.0, 0.02
SENSOR = Sensor(range=1.0, noise=0.0, bits=16)


def single_storey(**brace: float) -> Rig:
    """One floor on one brace; without arguments no stiffener and an actuator without velocity feedback."""
    changes = {"capacity": 1e6, "rate_limit": 1e9, "lag": 8e-4, "integral_rate": 6.0, "velocity_feedback": 0.0}
    limits = {"flow_limit": np.inf, "stroke_limit": np.inf, "stop_stiffness": 0.0}
    actuator = Actuator(**limits, **(changes | {key: value for key, value in brace.items() if key in changes}))
    group = BraceGroup(1, 1, 0.8, brace.get("stiffener_stiffness", 0.0), actuator)
    building = Building(np.array([MASS]), np.array([[MASS * OMEGA**2]]), np.array([[2 * ZETA * OMEGA * MASS]]))
    return Rig("single", 500.0, Table(10.0, 2000.0, 1.0, 0.25), building, (group,), (), SensorSet(*[SENSOR] * 5))


def zeros(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: float) -> np.ndarray:
    """Finite transmission zeros of a single-input, single-output system."""
    n = len(a)
    pencil = np.block([[a, b], [c, np.array([[d]])]])
    values = linalg.eig(pencil, np.diag([1.0] * n + [0.0]), right=False)
    return values[np.isfinite(values) & (np.abs(values) < 1e7)]


# --- the paper's rig -------------------------------------------------------------------------------------------------


def test_local_modes_are_hardly_excited_by_the_table():
    omega = 2 * np.pi * np.linspace(0.5, 30.0, 20_000)
    near = omega[omega > 50]
    without = replace(RIG, local_modes=()).model.select(["a3"], ["w"]).frequency_response(near)[:, 0, 0]
    found = RIG.model.select(["a3"], ["w"]).frequency_response(near)[:, 0, 0]
    assert np.abs(found - without).max() < 0.05, "of the table's acceleration"
    command = RIG.model.select(["a3"], ["U"]).frequency_response(near)[:, 0, 0]
    assert np.abs(command).max() > 2 * np.median(np.abs(command)), "but by the actuators"


def test_actuator_on_the_bench_has_unity_gain_and_0_8_ms_of_lag():
    omega = 2 * np.pi * np.linspace(0.1, 30.0, 600)
    response = RIG.braces[0].actuator.bench_model().frequency_response(omega)[:, 0, 0]
    np.testing.assert_allclose(np.abs(response), 1.0, rtol=0.01)
    phase = -np.unwrap(np.angle(response))
    assert np.abs(phase - 0.0008 * omega).max() < 0.008, "within half a degree of 0.8 ms, 0 to 30 Hz"
    fast = omega > 2 * np.pi * 5
    np.testing.assert_allclose(phase[fast] / omega[fast], 0.0008, rtol=0.05)


def test_zeros_of_f_over_u_are_the_poles_of_the_frame_with_its_stiffeners():
    part = RIG.model.select(["f"], ["U"])
    found = zeros(part.a, part.b, part.c, 0.0)
    # force-free: the stiffeners stay, the actuators' velocity feedback and the force drop out; the servo's integral
    # leaves one real zero
    group = RIG.braces[0]
    stiffness = RIG.building.stiffness + np.diag([group.stiffener_stiffness, 0.0, 0.0])
    mass = RIG.building.masses
    a = np.block([[np.zeros((3, 3)), np.eye(3)], [-stiffness / mass[:, None], -RIG.building.damping / mass[:, None]]])
    expected = [*np.linalg.eigvals(a), -group.actuator.integral_rate]
    for mode in RIG.local_modes:
        expected += [*np.roots([1.0, 2 * mode.damping_ratio * mode.frequency, mode.frequency**2])]
    assert len(found) == len(expected)
    for zero in expected:
        assert np.abs(found - zero).min() < 1e-6 * abs(zero), f"zero {zero} is missing"


def test_static_command_reaches_the_load_cell_in_full_and_pushes_its_floor():
    model = RIG.model
    still = model.d - model.c @ np.linalg.solve(model.a, model.b)
    names = model.outputs
    assert still[names.index("f"), 1] == pytest.approx(1.0)
    group = RIG.braces[0]
    stiffness = RIG.building.stiffness + np.diag([group.stiffener_stiffness, 0.0, 0.0])
    push = np.array([group.count * group.cosine, 0.0, 0.0])
    np.testing.assert_allclose(still[:3, 1], np.linalg.solve(stiffness, push), rtol=1e-9)
    assert (still[:3, 1] > 0).all(), "a positive command pushes in +x"


# --- closed forms on a single storey ---------------------------------------------------------------------------------


def test_single_storey_answers_the_table_as_an_oscillator():
    rig = single_storey()
    omega = np.array([1.0, 6.9, 7.0, 7.1, 30.0])
    x = -1 / (OMEGA**2 - omega**2 + 2j * ZETA * OMEGA * omega)
    response = rig.model.select(["x1", "xf", "a1", "f"], ["w"]).frequency_response(omega)[:, :, 0]
    np.testing.assert_allclose(response[:, 0], x, rtol=1e-9)
    np.testing.assert_allclose(response[:, 1], 0.8 * x, rtol=1e-9)
    np.testing.assert_allclose(response[:, 2], 1 - omega**2 * x, rtol=1e-9, err_msg="absolute acceleration")
    np.testing.assert_allclose(response[:, 3], 0.0, atol=1e-9, err_msg="no velocity feedback, no force")


def test_velocity_feedback_acts_as_its_equivalent_dashpot():
    c, rate = 50.0, 3.0
    (frequency, ratio), *_ = pole_table(single_storey(velocity_feedback=c, integral_rate=rate, lag=1e-5).model.poles)
    # f = -c v (i omega) / (i omega + omega_i), with v = 0.8 x', pushes the floor with 0.8 f
    added = 0.8**2 * c * OMEGA**2 / (OMEGA**2 + rate**2)
    assert ratio == pytest.approx(ZETA + added / (2 * MASS * OMEGA), rel=0.01)
    assert frequency == pytest.approx(OMEGA, rel=0.01)


def test_braces_between_floors_push_the_floor_and_pull_the_one_below():
    masses, stiffness = np.full(3, 1000.0), 1e6 * (2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1))
    building = Building(masses, stiffness, modal_damping(masses, stiffness, np.full(3, 0.01)))
    actuator = single_storey().braces[0].actuator
    groups = (BraceGroup(1, 2, 0.8, 0.0, actuator), BraceGroup(3, 1, 0.6, 0.0, actuator))
    rig = replace(single_storey(), building=building, braces=groups)
    still = -rig.model.c @ np.linalg.solve(rig.model.a, rig.model.b)
    assert rig.model.outputs == ("x1", "x2", "x3", "xf1", "xf2", "a1", "a2", "a3", "f1", "f2")
    np.testing.assert_allclose(still[:3, 1], np.linalg.solve(building.stiffness, [1.6, 0.0, 0.0]), rtol=1e-9)
    np.testing.assert_allclose(still[:3, 2], np.linalg.solve(building.stiffness, [0.0, -0.6, 0.6]), rtol=1e-9)
    x = still[:3]
    np.testing.assert_allclose(still[3], 0.8 * x[0], atol=1e-15)
    np.testing.assert_allclose(still[4], 0.6 * (x[2] - x[1]), atol=1e-15)


def test_local_mode_is_driven_by_the_braces_and_seen_by_stroke_and_accelerometer():
    mode = LocalMode(50.0, 0.01, 400.0, (0.1,), (0.3,))
    rig = replace(single_storey(), local_modes=(mode,))
    omega = np.array([20.0, 49.0, 51.0])
    part = rig.model.select(["x1", "xf", "a1", "f"], ["U"]).frequency_response(omega)[:, :, 0]
    x, force = part[:, 0], part[:, 3]
    modal = 0.1 * force / (400.0 * (50.0**2 - omega**2 + 2j * 0.01 * 50.0 * omega))
    np.testing.assert_allclose(part[:, 1], 0.8 * x + 0.1 * modal, rtol=1e-9)
    np.testing.assert_allclose(part[:, 2], -(omega**2) * (x + 0.3 * modal), rtol=1e-9)
