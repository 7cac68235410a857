"""The rig sample by sample: timing of inputs, faults, determinism."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from abrace_core.simulation import simulate
from abrace_plant.live.loop import COMMAND, GROUND, RAMP_TIME, RigLoop
from abrace_plant.rig.file import load_rig

TIMEOUT = 0.02


@pytest.fixture(scope="module")
def rig():
    return load_rig(Path(__file__).parents[2] / "src/abrace_plant/config/ncree_three_storey.yaml")


def loop_of(rig) -> RigLoop:
    return RigLoop(rig, 1, TIMEOUT)


def drive(loop: RigLoop, forces, ground=None) -> np.ndarray:
    """Answer sample after sample with these forces; returns the commands in force until each sample."""
    commands = []
    for k, force in enumerate(forces):
        sample = loop.sample()
        commands.append(sample.command[0])
        if force is not None:
            loop.receive_command(sample.sequence, [force])
        if ground is not None:
            loop.receive_ground_acceleration(sample.sequence, ground[k])
    return np.array(commands)


def test_a_command_from_sample_k_is_in_force_until_sample_k_plus_2(rig):
    commands = drive(loop_of(rig), [100.0 * k for k in range(20)])
    np.testing.assert_array_equal(commands[2:], [100.0 * k for k in range(18)])
    np.testing.assert_array_equal(commands[:2], 0)


def test_readings_are_the_rigs_exact_motion_within_the_sensors_noise(rig):
    random = np.random.default_rng(3)
    forces, ground = random.normal(0, 500, 800), random.normal(0, 0.1, 800)
    loop = loop_of(rig)
    readings = []
    for force, acceleration in zip(forces, ground, strict=True):
        sample = loop.sample()
        readings.append(sample.reading)
        loop.receive_command(sample.sequence, [force])
        loop.receive_ground_acceleration(sample.sequence, acceleration)
    inputs = np.column_stack([[0, *ground[:-1]], [0, *forces[:-1]]])
    exact = np.column_stack([simulate(rig.discrete_model(), inputs), inputs[:, 0]])
    channels = rig.sensors.channels(rig.floors, rig.groups)
    noise = np.array([channel.noise + channel.range / 2**channel.bits for channel in channels])
    assert (np.abs(np.array(readings) - exact) < 6 * noise).all()


def test_the_same_seed_and_inputs_give_the_same_readings(rig):
    one, two = loop_of(rig), loop_of(rig)
    for k in range(50):
        np.testing.assert_array_equal(one.sample().reading, two.sample().reading)
        for loop in (one, two):
            loop.receive_command(k, [50.0 * k])


def test_an_answer_says_which_sample_it_answers(rig):
    loop = loop_of(rig)
    loop.sample()
    assert not loop.answered(COMMAND)
    loop.receive_command(0, [1.0])
    assert loop.answered(COMMAND)
    assert not loop.answered(GROUND)
    loop.sample()
    assert not loop.answered(COMMAND)


def test_old_and_future_answers_are_counted_and_do_not_act(rig):
    loop = loop_of(rig)
    drive(loop, [0.0] * 5)
    loop.receive_command(99, [1000.0])
    loop.receive_command(2, [1000.0])
    drive(loop, [None] * 3)
    assert loop.counters()["late_commands"] >= 2
    assert not loop.sample().command.any()


@pytest.mark.parametrize("bad", [[float("nan")], [float("inf")], [1.0, 2.0], []])
def test_a_bad_command_is_a_latched_fault(rig, bad):
    loop = loop_of(rig)
    drive(loop, [2000.0] * 20)
    loop.sample()
    loop.receive_command(loop.sequence, bad)
    drive(loop, [2000.0] * round(RAMP_TIME * 500 + 5))
    assert loop.fault_reason
    assert not loop.sample().command.any()


def test_two_answers_to_a_sample_are_a_fault(rig):
    loop = loop_of(rig)
    loop.sample()
    loop.receive_command(0, [1.0])
    loop.receive_command(0, [1.0])
    assert "one sender was expected" in loop.fault_reason


def test_a_command_that_stays_away_is_a_fault_and_the_force_ends_smoothly(rig):
    loop = loop_of(rig)
    drive(loop, [8000.0] * 30)
    commands = drive(loop, [None] * round((TIMEOUT + RAMP_TIME) * 500 + 5))
    assert "no brace_command" in loop.fault_reason
    assert commands[-1] == 0
    assert np.abs(np.diff(commands)).max() < 8000.0 * np.pi / 2 / (RAMP_TIME * 500) * 1.02


def test_a_zero_command_may_stay_away(rig):
    loop = loop_of(rig)
    drive(loop, [500.0] * 10 + [0.0] * 5 + [None] * 200)
    assert loop.fault_reason is None


def test_a_ground_motion_that_stays_away_brings_the_table_to_rest_but_not_the_braces(rig):
    loop = loop_of(rig)
    drive(loop, [1000.0] * 30, [1.0] * 30)
    drive(loop, [1000.0] * 400)
    assert "no ground_motion" in loop.fault_reason
    sample = loop.sample()
    assert abs(sample.reading[-1]) < 0.01
    assert sample.command[0] == 1000.0


def test_only_clearing_ends_a_fault(rig):
    loop = loop_of(rig)
    drive(loop, [1000.0] * 10)
    loop.fault("emergency stop")
    assert drive(loop, [1000.0] * 400)[-1] == 0
    loop.clear_faults()
    assert loop.fault_reason is None
    assert drive(loop, [1000.0] * 5)[-1] == 1000.0


@settings(max_examples=20)
@given(
    forces=st.lists(st.one_of(st.none(), st.floats()), min_size=1, max_size=60),
    stop=st.integers(0, 60),
)
def test_the_force_is_finite_within_capacity_and_rate_whatever_comes(rig, forces, stop):
    loop = loop_of(rig)
    commands = []
    for k, force in enumerate(forces):
        sample = loop.sample()
        commands.append(sample.command[0])
        assert np.isfinite(sample.reading).all()
        if force is not None:
            loop.receive_command(k, [force])
        if k == stop:
            loop.fault("emergency stop")
    capacity, step = rig.capacity[0], rig.rate_limit[0] / rig.sample_rate
    assert np.isfinite(commands).all()
    assert np.abs(commands).max() <= capacity
    assert np.abs(np.diff(commands, prepend=0.0)).max() <= step * (1 + 1e-12)
