# SPDX-License-Identifier: Apache-2.0
"""What a linear rig has not, each effect alone against theory or another solver, then all of them together."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import signal
from scipy.integrate import solve_ivp

from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import LinearModel
from abrace_core.model.simulation import simulate
from abrace_plant.rig.building import Building, gravity_stiffness, storey_direction
from abrace_plant.rig.effects import effects
from abrace_plant.rig.equations import equations
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.hysteresis import Hysteresis
from abrace_plant.rig.model import BraceGroup, Rig
from abrace_plant.rig.motion import RigMotion
from abrace_plant.rig.sensors import AntiAlias, Measurement, Sensor
from abrace_plant.rig.table_dynamics import TableDynamics

CONFIGURATIONS = Path(__file__).parents[2] / "src/abrace_plant/config"
PAPERS = load_rig(CONFIGURATIONS / "ncree_three_storey.yaml")
AS_IT_IS = load_rig(CONFIGURATIONS / "ncree_as_a_rig.yaml")
PERIOD = 1 / PAPERS.sample_rate
M, K = 1000.0, 4e5
"""One storey of 20 rad/s."""
NO_COMMAND = np.zeros(0)


def one_storey(**changes: object) -> Rig:
    """A frame of one storey without damping and braces."""
    building = Building(np.array([M]), np.array([[K]]), np.zeros((1, 1)))
    return replace(PAPERS, building=replace(building, **changes), braces=(), local_modes=())


def held(**changes: float) -> Rig:
    """A brace at a floor that does not move; its servo has no integral."""
    backlash = changes.pop("backlash", 0.0)
    actuator = replace(PAPERS.braces[0].actuator, capacity=1e12, flow_limit=np.inf, integral_rate=0.0)
    building = Building(np.array([1e15]), np.array([[1e15]]), np.zeros((1, 1)))
    group = BraceGroup(1, 1, 1.0, 0.0, replace(actuator, **changes), backlash=backlash)
    return replace(PAPERS, building=building, braces=(group,), local_modes=())


def outputs(rig: Rig, ground: np.ndarray, commands: np.ndarray | None = None, refinement: int = 1) -> np.ndarray:
    """(samples, channels) [z, w] of a rig."""
    motion = RigMotion(rig, refinement)
    given = np.zeros((len(ground), rig.groups)) if commands is None else commands
    return np.array([[*motion.outputs(*one), motion.ground_acceleration] for one in zip(ground, given, strict=True)])


def released(rig: Rig, displacement: float, samples: int) -> tuple[np.ndarray, RigMotion]:
    """(samples,) displacement of one storey that is let go, from the moment it is, and its motion."""
    motion = RigMotion(rig)
    motion._state[0] = displacement
    return np.array([displacement] + [motion.outputs(0.0, NO_COMMAND)[0] for _ in range(samples - 1)]), motion


# --- nothing is on by itself -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ncree_three_storey", "five_storey", "ten_storey", "single_storey"])
def test_a_rig_without_effects_is_its_linear_model_to_the_last_bit(name):
    rig = load_rig(CONFIGURATIONS / f"{name}.yaml")
    found, model = equations(rig), rig.model
    assert effects(rig) == []
    np.testing.assert_array_equal(found.a, model.a)
    np.testing.assert_array_equal(found.b, model.b)
    np.testing.assert_array_equal(found.outputs[:-1, :-1], model.c.T)
    assert not len(found.elements)
    assert RigMotion(rig)._filtered.size == 0


def test_every_effect_of_the_rig_as_it_is_is_named():
    text = "; ".join(effects(AS_IT_IS))
    for word in (
        *("friction of 60, 20, 20 N", "storey 1 yields", "seals", "0.1 mm of backlash", "deadband", "29400 N"),
        *("table of 27000 kg", "anti-alias filters of 200 Hz", "transducers", "2 % of cross-axis"),
    ):
        assert word in text


# --- friction --------------------------------------------------------------------------------------------------------


def test_free_decay_under_friction_loses_four_times_its_drift_a_cycle_then_sticks():
    limit, start = 100.0, 0.0102
    lost, omega = limit / K, np.sqrt(K / M)
    found, motion = released(one_storey(friction=(limit,)), start, 2500)
    time = PERIOD * np.arange(len(found))
    half = np.floor(time * omega / np.pi).astype(int)
    half = np.minimum(half, int((start - lost) / (2 * lost)) + 1)
    # of the half cycle n: about (-1)^n lost, from (-1)^n (start - 2 n lost)
    sign = (-1.0) ** half
    exact = sign * (lost + (start - (2 * half + 1) * lost) * np.cos(omega * time - np.pi * half))
    moving = time < (half.max()) * np.pi / omega
    assert half[moving].max() > 15
    np.testing.assert_allclose(found[moving], exact[moving], atol=0.04 * lost)
    finer = RigMotion(one_storey(friction=(limit,)), 16)
    finer._state[0] = start
    again = np.array([start] + [finer.outputs(0.0, NO_COMMAND)[0] for _ in range(len(found) - 1)])
    np.testing.assert_allclose(again[moving], exact[moving], atol=0.0025 * lost)
    rest = found[np.flatnonzero(~moving)[5] :]
    assert np.ptp(rest) < 1e-12, "it sticks"
    assert abs(rest[0]) < lost
    assert abs(motion._state[1]) < 1e-12


def test_below_its_limit_friction_holds_the_floor_to_the_table():
    time = PERIOD * np.arange(1000)
    ground = 0.9 * np.sin(8.0 * time)
    found = outputs(one_storey(friction=(M * 1.0,)), ground)
    assert np.abs(found[:, 0]).max() < 1e-5 * 0.9 / 20**2, "of what it would move without"
    np.testing.assert_allclose(found[10:, 1], ground[10:], atol=2e-3)
    assert np.abs(outputs(one_storey(friction=(M * 0.8,)), ground)[:, 0]).max() > 1e-5, "more makes it slip"


def test_friction_of_seals_is_in_the_load_cell_and_the_servo_takes_it_back():
    still, slow = np.zeros(300), {"lag": 0.05, "velocity_feedback": 0.0, "integral_rate": 0.0}
    for servo, first, later in ((slow, 200.0 * np.exp(-0.002 / 0.05), 200.0), ({}, 17.0, 5.0)):
        quiet, rubbing = (outputs(with_actuator(friction=limit, **servo), 0.5 + still) for limit in (0.0, 200.0))
        felt = rubbing[:, 7] - quiet[:, 7]
        assert felt[0] == pytest.approx(first, abs=0.15 * first), "the floor falls back, its brace's seals hold it"
        assert np.abs(felt[5:150]).max() < later


def with_actuator(rig: Rig = PAPERS, **changes: float) -> Rig:
    return replace(rig, braces=tuple(replace(one, actuator=replace(one.actuator, **changes)) for one in rig.braces))


# --- storeys that yield, and weight -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("exponent", "beta"), [(1.0, 0.5), (2.0, 0.7), (5.0, 1.0)])
def test_a_storey_that_yields_moves_as_an_adaptive_solver_says(exponent, beta):
    spring = Hysteresis(1, 0.6 * K, 0.004, exponent, beta)
    time = PERIOD * np.arange(1500)
    ground = 3.0 * np.sin(14.0 * time) * np.minimum(time, 1.0)

    def rates(t: float, y: np.ndarray) -> list[float]:
        x, v, z = y
        turn = beta * np.sign(z * v) + 1 - beta
        force = 0.4 * K * x + 0.6 * K * z
        return [v, -force / M - np.interp(t, time, ground), v * (1 - abs(z / 0.004) ** exponent * turn)]

    exact = solve_ivp(rates, (0.0, time[-1]), [0.0] * 3, t_eval=time, max_step=PERIOD, rtol=1e-9, atol=1e-12).y[0]
    assert np.abs(exact).max() > 2 * 0.004, "it yields"
    found = outputs(one_storey(hysteresis=(spring,)), ground)[:, 0]
    assert np.abs(found - exact).max() < 2e-4 * np.abs(exact).max()


def test_weight_takes_its_part_of_the_stiffness():
    height, weight = 3.0, 9.80665 * M
    softer = one_storey(stiffness=np.array([[K]]) - gravity_stiffness(np.array([M]), height))
    assert softer.building.modes()[0][0] == pytest.approx(np.sqrt((K - weight / height) / M))
    np.testing.assert_allclose(
        gravity_stiffness(np.array([2.0, 1.0]), 4.0) @ [1.0, 1.0],
        [3.0 * 9.80665 / 4, 0.0],
        err_msg="all above the storey",
    )


def test_work_is_what_is_stored_and_what_springs_and_friction_lose():
    building = replace(
        PAPERS.building,
        friction=(2000.0, 900.0, 600.0),
        hysteresis=(Hysteresis(1, 8e5, 0.01, 1.0, 0.6), Hysteresis(3, 8e5, 0.004, 2.0, 0.5)),
    )
    rig = replace(PAPERS, building=building).bare_frame()
    motion = RigMotion(rig, 8)
    time = PERIOD * np.arange(2500)
    ground = 2.0 * np.sin(7.0 * time) * np.minimum(1.0, time) + 0.5 * np.sin(21.0 * time)
    states, forces = [], []
    for acceleration in ground:
        motion.outputs(acceleration, NO_COMMAND)
        states.append(motion._state.copy())
        forces.append(motion._elements["force"].copy())
    x, v = np.split(np.array(states), 2, axis=1)
    drift = x @ np.array([storey_direction(storey, 3) for storey in (1, 3)]).T
    springs = np.array(forces)[:, :2] + np.array([8e5, 8e5]) * drift
    slip = np.diff(x @ np.array([storey_direction(storey, 3) for storey in (1, 2, 3)]).T, axis=0)
    linear = building.stiffness - sum(8e5 * np.outer(d, d) for d in (storey_direction(1, 3), storey_direction(3, 3)))

    def work(power: np.ndarray) -> float:
        return float(PERIOD * (power[1:] + power[:-1]).sum() / 2)

    stored = 0.5 * (v[-1] @ (building.masses * v[-1]) + x[-1] @ linear @ x[-1])
    into_springs = np.sum((springs[1:] + springs[:-1]) / 2 * np.diff(drift, axis=0))
    lost = np.sum(np.abs(slip) @ np.array(building.friction))
    viscous = work(np.einsum("ti,ij,tj->t", v, building.damping, v))
    given = work(-ground * (v @ building.masses))
    assert given == pytest.approx(stored + into_springs + lost + viscous, rel=2e-3)
    assert lost > 0.05 * given
    assert into_springs > 0.2 * given


# --- valve and pins --------------------------------------------------------------------------------------------------


def test_a_valve_that_is_wide_open_slows_with_the_root_of_the_pressure_drop_until_it_stalls():
    stall, flow = 2e4, 2e6
    rig = held(stall_force=stall, flow_limit=flow, velocity_feedback=0.0)
    found = outputs(rig, np.zeros(40), np.full((40, 1), 1e9))[:, 3]
    # f' = flow sqrt(1 - f / stall), from the second sample on; it stalls after 2 stall / flow
    left = np.maximum(0.0, 1 - flow * PERIOD * np.arange(40) / (2 * stall))
    np.testing.assert_allclose(found, stall * (1 - left**2), atol=2e-3 * stall)
    back = np.concatenate([np.full((40, 1), 1e9), np.full((10, 1), -1e9)])
    force = outputs(rig, np.zeros(50), back)[:, 3]
    helped = stall * ((np.sqrt(2) - flow * PERIOD / (2 * stall)) ** 2 - 1)
    assert force[41] == pytest.approx(helped, rel=0.01), "the load helps"


def test_a_valve_does_nothing_within_its_deadband():
    rig, still = held(deadband=30.0), np.zeros(100)
    assert not outputs(rig, still, np.full((100, 1), 25.0))[:, 3].any()
    for command in (100.0, -100.0):
        found = outputs(rig, still, np.full((100, 1), command))[-1, 3]
        assert found == pytest.approx(np.sign(command) * 70.0, abs=1e-6)


def test_a_brace_crosses_its_backlash_at_the_speed_of_the_valves_flow_and_without_force():
    backlash, command = 5e-4, 200.0
    rig = held(backlash=backlash)
    commands = np.concatenate([np.full((150, 1), -command), np.full((150, 1), command)])
    found = outputs(rig, np.zeros(300), commands)
    stroke, force = found[:, 1], found[:, 3]
    assert force[140] == pytest.approx(-command, rel=1e-6)
    assert stroke[140] == pytest.approx(-backlash / 2)
    assert stroke[-1] == pytest.approx(backlash / 2)
    crossing = np.flatnonzero(np.abs(stroke) < 0.999 * backlash / 2)
    crossing = crossing[crossing > 150]
    assert np.abs(force[crossing]).max() < 1e-9
    speed = command / rig.braces[0].actuator.velocity_feedback
    np.testing.assert_allclose(np.diff(stroke[crossing]) / PERIOD, speed, rtol=5e-3)
    assert len(crossing) == pytest.approx(backlash / speed / PERIOD, abs=1)


# --- table -----------------------------------------------------------------------------------------------------------


def test_table_and_building_move_each_other_as_two_masses_do():
    table = TableDynamics(2500.0, 100.0, 0.3)
    rig = replace(one_storey(damping=np.array([[800.0]])), table_dynamics=table)
    # floor and table by their mass matrix: M (x'' + e'' + w_c) + C x' + K x = 0, and the table's reaction to it
    masses = np.array([[M, M], [0.0, table.mass]])
    stiffness = np.array([[K, 0.0], [-K, table.mass * table.frequency**2]])
    damping = np.array([[800.0, 0.0], [-800.0, 2 * 0.3 * table.mass * table.frequency]])
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-np.linalg.solve(masses, np.hstack([stiffness, damping]))]])
    b = np.array([[0.0], [0.0], *-np.linalg.solve(masses, np.array([[M], [table.mass]]))])
    c = np.vstack([[1.0, 0.0, 0.0, 0.0], a[2] + a[3], a[3]])
    d = np.array([[0.0], b[2] + b[3] + 1.0, b[3] + 1.0])
    model = discretize(LinearModel(a, b, c, d, ("w",), ("x", "a", "table")), PERIOD)
    ground = np.random.default_rng(3).normal(0.0, 1.0, 800)
    np.testing.assert_allclose(outputs(rig, ground), simulate(model, ground[:, None]), atol=1e-9)


def test_a_table_stands_on_its_supports_until_it_is_commanded_and_then_braces_shake_it():
    rig = replace(PAPERS, table_dynamics=TableDynamics(27000.0, 138.0, 0.4))
    command = 2000.0 * np.sin(23.0 * PERIOD * np.arange(1500))[:, None]
    parked, ground = outputs(rig, np.zeros(1500), command), np.zeros(1500)
    np.testing.assert_array_equal(parked, outputs(PAPERS, ground, command))
    ground[300] = 1e-6
    found = outputs(rig, ground, command)
    np.testing.assert_array_equal(found[:300], parked[:300])
    shear = found[:, 4:7] @ PAPERS.building.masses
    assert np.abs(found[800:, -1]).max() > 0.003
    assert abs(np.corrcoef(found[800:, -1], shear[800:])[0, 1]) > 0.9, (
        "with the base shear, below the table's resonance"
    )


# --- sensors ---------------------------------------------------------------------------------------------------------


def test_anti_alias_filters_and_transducers_are_those_of_scipy():
    sensors = replace(PAPERS.sensors, anti_alias=AntiAlias(20.0, 4))
    sensors = replace(sensors, ground_acceleration=replace(sensors.ground_acceleration, bandwidth=35.0))
    rig = replace(PAPERS, sensors=sensors)
    time = PERIOD * np.arange(1500)
    ground = np.sin(2 * np.pi * 20.0 * time)
    found, unfiltered = outputs(rig, ground), outputs(PAPERS, ground)
    of_table, of_filter = (signal.butter(order, 2 * np.pi * f, analog=True) for order, f in ((2, 35.0), (4, 20.0)))
    expected = signal.lsim((np.polymul(of_table[0], of_filter[0]), np.polymul(of_table[1], of_filter[1])), ground, time)
    np.testing.assert_allclose(found[:, -1], expected[1], atol=1e-9)
    # the others in substeps: SciPy's filter of the samples is that of a line between them
    for channel in (2, 3, 4, 7):
        through = signal.lsim(of_filter, unfiltered[:, channel], time)[1]
        assert np.abs(found[:, channel] - through).max() < 0.01 * np.abs(through).max()


def test_hum_is_a_line_at_its_frequency_with_a_phase_of_each_channels_own_and_noise_stays_as_it_is():
    sensor = Sensor(range=10.0, noise=0.01, bits=32)
    humming = replace(sensor, hum=0.2)
    still = np.zeros((5000, 2))
    found, quiet = (Measurement([one] * 2, 4, PERIOD).record(still) for one in (humming, sensor))
    spectrum = np.fft.rfft(found - quiet, axis=0) / 2500
    line = round(60.0 * 5000 * PERIOD)
    np.testing.assert_allclose(np.abs(spectrum[line]), 0.2, rtol=1e-6)
    assert np.abs(np.delete(spectrum, line, axis=0)).max() < 1e-6
    assert abs(np.angle(spectrum[line, 0] / spectrum[line, 1])) > 0.1


def test_an_accelerometer_adds_its_share_of_what_is_across():
    along, across, share = AS_IT_IS.local_modes[0].accelerometer_share, (0.4, 0.8, 1.0), 0.03
    command = 3000.0 * np.sin(56.0 * PERIOD * np.arange(500))[:, None]

    def accelerations(shares: tuple[float, ...], transverse: tuple[float, ...] = (), cross: float = 0.0) -> np.ndarray:
        mode = replace(PAPERS.local_modes[0], accelerometer_share=shares, transverse_share=transverse)
        rig = replace(PAPERS, local_modes=(mode,), sensors=replace(PAPERS.sensors, cross_axis=cross))
        return outputs(rig, np.zeros(500), command)[:, 4:7]

    without = accelerations((0.0, 0.0, 0.0))
    both = np.stack([accelerations(along), accelerations(across) - without], axis=-1)
    np.testing.assert_allclose(accelerations(along, across, share), both @ np.array([1.0, share]), atol=1e-9)
    np.testing.assert_array_equal(accelerations(along, across), accelerations(along))


# --- all together ----------------------------------------------------------------------------------------------------


def shaken(rig: Rig, refinement: int = 1) -> np.ndarray:
    time = PERIOD * np.arange(750)
    ground = 1.2 * np.sin(7.3 * time) + 0.4 * np.sin(23.0 * time)
    return outputs(rig, ground, 4000.0 * np.sin(15.0 * time)[:, None], refinement)


def test_the_rig_as_it_is_is_accurate_at_its_own_substeps_and_converges():
    exact = shaken(AS_IT_IS, 32)
    size = np.abs(exact).max(axis=0)
    assert (np.abs(shaken(PAPERS) - exact).max(axis=0) > 0.03 * size)[[0, 1, 2, 3]].all(), "far from linear"
    error = [np.sqrt(np.mean(((shaken(AS_IT_IS, r) - exact) / size) ** 2)) for r in (1, 4)]
    assert error[0] < 3e-4, "of each quantity's peak"
    assert error[1] < 0.4 * error[0]


def test_a_disconnected_brace_has_no_friction_backlash_or_valve():
    found = outputs(AS_IT_IS.disconnect([1]), np.sin(PERIOD * np.arange(300)), np.full((300, 1), 5000.0))
    assert np.isfinite(found).all()
    assert not found[:, [3, 7]].any()
