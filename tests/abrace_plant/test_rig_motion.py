# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from abrace_core.model.simulation import simulate
from abrace_core.safety.table_stop import Table
from abrace_plant.rig.actuator import Actuator
from abrace_plant.rig.building import Building
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.model import BraceGroup, Rig
from abrace_plant.rig.motion import RigMotion
from abrace_plant.rig.sensors import Sensor, SensorSet

RIG = load_rig(Path(__file__).parents[2] / "src/abrace_plant/config/ncree_three_storey.yaml")
UNLIMITED = {"flow_limit": np.inf, "stroke_limit": np.inf, "capacity": 1e12}
TIME = np.arange(1000) / RIG.sample_rate


def with_actuators(rig: Rig, **changes: float) -> Rig:
    """The rig with other actuators."""
    braces = tuple(replace(group, actuator=replace(group.actuator, **changes)) for group in rig.braces)
    return replace(rig, braces=braces)


def motion(rig: Rig, ground: np.ndarray, commands: np.ndarray, refinement: int = 1) -> np.ndarray:
    """(samples, outputs) of the rig stepped sample by sample."""
    stepped = RigMotion(rig, refinement)
    return np.array([stepped.outputs(w, command) for w, command in zip(ground, commands, strict=True)])


def two_groups() -> Rig:
    """Four floors, braces with different servos below floors 1 and 3."""
    masses, stiffness = np.full(4, 5000.0), 4e6 * (2 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1))
    first = Actuator(2e4, 5e6, 0.8e-3, 6.0, 1.5e4, 1.2e7, 0.05, 4e7, command_delay=0.0005)
    second = Actuator(1e4, 5e6, 1.1e-3, 4.0, 0.9e4, 1.2e7, 0.05, 4e7, command_delay=0.0033)
    return Rig(
        "two",
        500.0,
        Table(10.0, 2000.0, 1.0, 0.25),
        Building(masses, stiffness, 1e-3 * stiffness),
        (BraceGroup(1, 2, 0.8, 1e5, first), BraceGroup(3, 1, 0.7, 0.0, second)),
        (),
        SensorSet(*[Sensor(1.0, 0.0, 16)] * 5),
    )


# --- linear motion ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rig", [RIG, RIG.bare_frame(), two_groups(), with_actuators(RIG, command_delay=0.002)])
def test_linear_motion_is_the_exact_discrete_model(rig):
    random = np.random.default_rng(0)
    ground, commands = random.normal(0.0, 0.3, 600), random.normal(0.0, 1500.0, (600, rig.groups))
    expected = simulate(rig.discrete_model(), np.column_stack([ground, commands]))
    found = motion(rig, ground, commands)
    assert (np.abs(found - expected).max(axis=0) < 1e-12 * np.abs(expected).max(axis=0)).all()


# --- energy ----------------------------------------------------------------------------------------------------------


def stored_energy(rig: Rig, state: np.ndarray) -> float:
    """Of floors [J], and of the servos, whose response to velocity is passive: count (tau f^2 + omega_i g^2) / 2 c."""
    n, groups = rig.floors, rig.groups
    x, v, f, g = np.split(state, [n, 2 * n, 2 * n + groups])
    stiffness = rig.building.stiffness.copy()
    energy = 0.0
    for j, group in enumerate(rig.braces):
        direction = group.direction(n)
        stiffness += group.stiffener_stiffness * np.outer(direction, direction)
        a = group.actuator
        energy += group.count * (a.lag * f[j] ** 2 + a.integral_rate * g[j] ** 2) / (2 * a.velocity_feedback)
    return energy + 0.5 * x @ stiffness @ x + 0.5 * rig.building.masses @ v**2


@settings(max_examples=15)
@given(
    start=st.lists(st.floats(-0.3, 0.3), min_size=4, max_size=4).filter(lambda v: max(map(abs, v)) > 0.01),
    capacity=st.sampled_from([2e3, 2e4, 1e12]),
    rig=st.sampled_from([two_groups(), two_groups().bare_frame()]),
)
def test_energy_decays_without_input(start, capacity, rig):
    rig = with_actuators(rig, flow_limit=np.inf, stroke_limit=np.inf, capacity=capacity)
    stepped = RigMotion(rig)
    stepped._state[4:8] = start
    energy = []
    for _ in range(400):
        stepped.outputs(0.0, np.zeros(rig.groups))
        energy.append(stored_energy(rig, stepped._state))
    assert (np.diff(energy) < 0).all()
    assert energy[-1] < 0.9 * energy[0]


# --- limits ----------------------------------------------------------------------------------------------------------


@settings(max_examples=15)
@given(amplitude=st.floats(1e3, 1e6), frequency=st.floats(0.3, 30.0), ground=st.floats(0.0, 20.0))
def test_force_never_exceeds_capacity_and_the_motion_stays_finite(amplitude, frequency, ground):
    rig = with_actuators(RIG, stroke_limit=np.inf)
    swing = np.sin(2 * np.pi * frequency * TIME)
    found = motion(rig, ground * swing, amplitude * swing[:, None])
    assert np.isfinite(found).all()
    assert np.abs(found[:, 7]).max() <= RIG.capacity[0] * (1 + 1e-9)


def test_force_rises_no_faster_than_the_valve_lets_it():
    rig = with_actuators(RIG, velocity_feedback=0.0, flow_limit=2e6)
    for refinement, tolerance in ((1, 5e-3), (10, 5e-5)):
        force = motion(rig, np.zeros(20), np.full((20, 1), 20e3), refinement)[:, 7]
        np.testing.assert_allclose(force[:5], np.arange(5) * 2e6 * 0.002, rtol=tolerance)
        assert force[-1] == pytest.approx(20e3, rel=0.03)


def test_beyond_its_stroke_the_actuator_stands_on_its_stop():
    """A static push: the stop takes what the stroke beyond its limit times its stiffness is; the load cell feels it."""
    damped = replace(RIG.building, damping=0.05 * RIG.building.stiffness)
    rig = with_actuators(replace(RIG, building=damped), stroke_limit=0.002, stop_stiffness=2e6)
    still = np.full(6000, 3.0)
    found = motion(rig, still, np.zeros((6000, 1)))[-1]
    stroke, group = found[3], rig.braces[0]
    assert stroke < -0.002
    stiffness = rig.building.stiffness + np.diag([group.stiffener_stiffness, 0.0, 0.0])
    push = group.count * group.cosine * found[7]
    expected = np.linalg.solve(stiffness, -rig.building.masses * 3.0 + np.array([push, 0.0, 0.0]))
    np.testing.assert_allclose(found[:3], expected, rtol=1e-3)
    hydraulic = found[7] - 2e6 * -(stroke + 0.002)
    assert abs(hydraulic) <= group.actuator.capacity * (1 + 1e-9)
    free = motion(with_actuators(rig, stroke_limit=1.0), still, np.zeros((6000, 1)))[-1]
    assert stroke > free[3], "the stop holds it back"


@pytest.mark.parametrize(
    "limits",
    [
        {"capacity": 8000.0},
        {"flow_limit": 1e6, "command_delay": 0.0013},
        {"stroke_limit": 0.03},
        {"capacity": 8e3, "flow_limit": 1.2e7, "stroke_limit": 0.05},
    ],
    ids="-".join,
)
def test_limited_motion_converges_with_the_square_of_the_substep(limits):
    rig = with_actuators(RIG, **(UNLIMITED | limits))
    time = np.arange(750) / RIG.sample_rate
    ground = 3.0 * np.sin(7.3 * time) + np.sin(23.0 * time)
    command = 2.8e4 * np.sin(15.0 * time)[:, None]
    exact = motion(rig, ground, command, refinement=256)
    linear = motion(
        with_actuators(RIG, **UNLIMITED, command_delay=rig.braces[0].actuator.command_delay), ground, command
    )
    size = np.abs(exact).max(axis=0)
    assert (np.abs(linear - exact)[:, 7] > 0.01 * size[7]).mean() > 0.2, "limited much of the time"
    refinements = np.array([1, 2, 4, 8, 16])
    error = [np.sqrt(np.mean(((motion(rig, ground, command, r) - exact) / size) ** 2)) for r in refinements]
    order = -np.polyfit(np.log(refinements), np.log(error), 1)[0]
    assert 1.7 < order < 2.6, f"order {order:.2f}, errors {error}"
    assert error[0] < 2e-3, "at the rig's own substeps, of each quantity's peak"


# --- braces taken off ------------------------------------------------------------------------------------------------


def test_a_rig_with_all_braces_off_is_the_bare_frame():
    random = np.random.default_rng(1)
    ground, command = random.normal(0.0, 0.3, 500), np.full((500, 1), 5000.0)
    found = motion(RIG.disconnect([1]), ground, command)
    bare = motion(RIG.bare_frame(), ground, np.zeros((500, 0)))
    np.testing.assert_allclose(found[:, [0, 1, 2, 4, 5, 6]], bare, rtol=1e-9, atol=1e-12)
    assert not found[:, [3, 7]].any(), "neither stroke nor force"


def test_one_group_of_two_may_be_off():
    whole = with_actuators(two_groups(), **UNLIMITED)
    rig, alone = whole.disconnect([2]), replace(whole, braces=whole.braces[:1])
    random = np.random.default_rng(1)
    ground, command = random.normal(0.0, 0.3, 500), random.normal(0.0, 3e3, (500, 2))
    found, expected = motion(rig, ground, command), motion(alone, ground, command[:, :1])
    np.testing.assert_allclose(found[:, [0, 1, 2, 3, 4, 6, 7, 8, 9, 10]], expected, rtol=1e-9, atol=1e-9)


def test_a_group_that_does_not_exist_cannot_be_taken_off():
    with pytest.raises(Exception, match="brace group 2: expected one of the rig's groups, 1 to 1"):
        RIG.disconnect([2])
