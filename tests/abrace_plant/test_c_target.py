# SPDX-License-Identifier: Apache-2.0
"""The C target: what a laboratory copies follows only while it is armed, and comes to rest by itself."""

import ctypes
import math
import random
import re
import struct
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest
from c_target import (
    ARMED,
    ASKED,
    BAD_COMMAND,
    DISARMED,
    EMERGENCY_STOP,
    FOLLOW,
    HOLD_ZERO,
    MISSED_TICKS,
    NO_COMMANDS,
    NOT_FINITE,
    OBEYED,
    OLD,
    OTHER_ARM,
    OWN_LIMIT,
    REFUSED,
    REPEATED,
    RESTARTED,
    SAFE,
    SOURCES,
    STOPPING,
    WRONG_CONSTANT,
    WRONG_CRC,
    WRONG_LENGTH,
    CTarget,
    Rig,
    Sample,
    command_packet,
    compiled,
    target_library,
    target_program,
)
from source_tree import ROOT

from abrace_plant.devices.c_target import Settings, TargetStruct

STEP = (200.0, 100.0)
"""N that the rig of these tests allows in a tick."""
LIFE, RAMP = 25, 50
"""Ticks of life time and ramp."""


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    return target_library(tmp_path_factory.mktemp("target"))


@pytest.fixture
def target(library: ctypes.CDLL) -> CTarget:
    return CTarget(library)


def test_python_has_the_structures_of_the_header(tmp_path):
    names = [name for name, *_ in TargetStruct._fields_]
    texts = [f'printf("%zu ", offsetof(abrace_target, {name}));' for name in names]
    texts += ['printf("%zu %zu", sizeof(abrace_target), sizeof(abrace_target_settings));']
    source = tmp_path / "offsets.c"
    include = "#include <stddef.h>\n#include <stdio.h>\n#include <abrace_target.h>\n"
    source.write_text(f"{include}int main(void) {{ {' '.join(texts)} return 0; }}\n")
    said = subprocess.run([compiled(tmp_path / "offsets", source)], capture_output=True, text=True, check=True).stdout
    found = [getattr(TargetStruct, name).offset for name in names]
    assert [*map(int, said.split())] == [*found, ctypes.sizeof(TargetStruct), ctypes.sizeof(Settings)]


def following(library: ctypes.CDLL, outputs: tuple[float, ...] = (800.0, -300.0, 0.0), **rig: object) -> CTarget:
    """A target that has followed for 20 ticks."""
    target = CTarget(library, Rig(**rig))
    target.arm()
    target.follow(outputs, 20)
    return target


def stopping(library: ctypes.CDLL) -> CTarget:
    target = following(library)
    target.command(SAFE, 1)
    target.tick()
    return target


def disarmed(library: ctypes.CDLL) -> CTarget:
    """A target that was armed with 1 and has stopped."""
    target = stopping(library)
    for _ in range(RAMP + 2):
        target.tick()
    return target


def ticks_to_rest(target: CTarget, most: int = 2000) -> int:
    """Ticks without a command until the target is disarmed."""
    for tick in range(most):
        if target.state == DISARMED:
            return tick
        target.tick()
    raise AssertionError(f"not at rest after {most} ticks")


def test_a_target_that_has_started_follows_nothing(target: CTarget):
    for arm in (0, 1, 2, 2**32 - 1):
        assert target.command(FOLLOW, arm, (500.0, 100.0, 1.0)) == REFUSED
        assert target.tick() == [0, 0, 0]
    for arm in (0, 2, 2**32 - 1):
        assert target.command(HOLD_ZERO, arm) == REFUSED
    assert (target.state, target.c.power, target.c.causes, target.c.applied_counter) == (DISARMED, 0, RESTARTED, 0)


def test_the_next_number_arms_and_its_commands_are_followed(target: CTarget):
    assert target.command(HOLD_ZERO, 1, (500.0, 100.0, 1.0)) == OBEYED
    assert target.tick() == [0, 0, 0]
    assert (target.state, target.c.power, target.c.causes, target.c.last_arm) == (ARMED, 1, 0, 1)
    assert target.command(FOLLOW, 1, (150.0, -60.0, 1.0)) == OBEYED
    assert target.tick() == [150, -60, 1]
    assert target.c.applied_counter == 2


def test_outputs_keep_to_capacity_rate_limit_acceleration_and_jerk(target: CTarget):
    target.arm()
    found = np.array([target.follow((1e300, -1e300, 1e300)) for _ in range(8)])
    assert found[:, 0] == pytest.approx([200, 400, 600, 800, 1000, 1000, 1000, 1000])
    assert found[:, 1] == pytest.approx([-100, -200, -300, -400, -500, -500, -500, -500])
    assert found[:, 2] == pytest.approx([4, 8, 10, 10, 10, 10, 10, 10])
    assert target.follow((-1000.0, 0.0, -10.0)) == pytest.approx([800, -400, 6])


COMMANDS = {
    "safe": (SAFE, 1),
    "hold zero, its number": (HOLD_ZERO, 1),
    "hold zero, next number": (HOLD_ZERO, 2),
    "hold zero, number after next": (HOLD_ZERO, 3),
    "hold zero, no number": (HOLD_ZERO, 0),
    "follow, its number": (FOLLOW, 1),
    "follow, next number": (FOLLOW, 2),
    "follow, no number": (FOLLOW, 0),
    "a wanted state that there is not": (3, 1),
}
BECOMES = {
    # wanted, while: disarmed, armed, stopping: the state after it, what has become of it, cause bits that are new
    "safe": ((DISARMED, OBEYED, 0), (STOPPING, OBEYED, ASKED), (STOPPING, OBEYED, ASKED)),
    "hold zero, its number": ((DISARMED, REFUSED, 0), (ARMED, OBEYED, 0), (STOPPING, REFUSED, 0)),
    "hold zero, next number": ((ARMED, OBEYED, 0), (STOPPING, REFUSED, OTHER_ARM), (STOPPING, REFUSED, 0)),
    "hold zero, number after next": ((DISARMED, REFUSED, 0), (STOPPING, REFUSED, OTHER_ARM), (STOPPING, REFUSED, 0)),
    "hold zero, no number": ((DISARMED, REFUSED, 0), (STOPPING, REFUSED, OTHER_ARM), (STOPPING, REFUSED, 0)),
    "follow, its number": ((DISARMED, REFUSED, 0), (ARMED, OBEYED, 0), (STOPPING, REFUSED, 0)),
    "follow, next number": ((DISARMED, REFUSED, 0), (STOPPING, REFUSED, OTHER_ARM), (STOPPING, REFUSED, 0)),
    "follow, no number": ((DISARMED, REFUSED, 0), (STOPPING, REFUSED, OTHER_ARM), (STOPPING, REFUSED, 0)),
    "a wanted state that there is not": (
        (DISARMED, NOT_FINITE, 0),
        (STOPPING, NOT_FINITE, BAD_COMMAND),
        (STOPPING, NOT_FINITE, BAD_COMMAND),
    ),
}


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("state", [DISARMED, ARMED, STOPPING])
def test_every_command_in_every_state(library: ctypes.CDLL, state: int, name: str):
    target = (disarmed, following, stopping)[state](library)
    assert target.state == state
    before = target.c.causes
    wanted, arm = COMMANDS[name]
    after, result, causes = BECOMES[name][state]
    assert target.command(wanted, arm, (900.0, 0.0, 0.0)) == result
    assert target.state == after
    if (state, after) == (DISARMED, ARMED):
        assert (target.c.last_arm, target.c.causes) == (2, 0)
    else:
        assert (target.c.last_arm, target.c.causes) == (1, before | causes)


@pytest.mark.parametrize(
    "outputs", [(math.nan, 0.0, 0.0), (0.0, math.inf, 0.0), (0.0, 0.0, -math.inf), (0.0, 0.0, math.nan)]
)
@pytest.mark.parametrize("wanted", [SAFE, HOLD_ZERO, FOLLOW])
def test_a_value_that_is_not_finite_stops(library: ctypes.CDLL, outputs: tuple[float, ...], wanted: int):
    target = following(library)
    assert target.command(wanted, 1, outputs) == NOT_FINITE
    assert (target.state, target.c.causes) == (STOPPING, BAD_COMMAND)
    assert ticks_to_rest(target) == RAMP + 1
    assert target.command(HOLD_ZERO, 2, outputs) == NOT_FINITE
    assert target.state == DISARMED


def test_no_new_command_for_the_life_time_stops(library: ctypes.CDLL):
    target = following(library)
    for _ in range(LIFE - 1):  # one has gone by since the last new one
        assert target.command(FOLLOW, 1, (0.0, 0.0, 0.0), counter=target.counter) == REPEATED
        assert target.tick() == [800, -300, 0]
    assert target.state == ARMED
    target.tick()
    assert (target.state, target.c.causes, target.c.power) == (STOPPING, NO_COMMANDS, 1)


def test_a_stop_is_half_a_cosine_then_power_goes(library: ctypes.CDLL):
    target = following(library)
    for _ in range(2):
        target.stop(OWN_LIMIT)
        for tick in range(1, RAMP + 1):
            share = (1 + math.cos(math.pi * tick / RAMP)) / 2
            assert target.tick()[:2] == pytest.approx([800 * share, -300 * share], abs=1e-9)
            assert (target.state, target.c.power) == (STOPPING, 1)
        assert target.applied == [0, 0, 0]
        target.tick()
        assert (target.state, target.c.power, target.c.causes) == (DISARMED, 0, OWN_LIMIT)
        target.arm()
        target.follow((800.0, -300.0, 0.0), 20)


def test_a_ramp_takes_as_long_as_the_rate_limit_needs(library: ctypes.CDLL):
    target = following(library, (800.0, 0.0, 0.0), rate_limit=(2500.0, 2500.0), ramp_time=0.02)
    before = target.applied[0]
    assert before == pytest.approx(100)
    target.stop(OWN_LIMIT)
    forces = [before, *(target.tick()[0] for _ in range(25))]
    assert np.abs(np.diff(forces)).max() <= 5 * (1 + 1e-12)
    assert forces[20] > 0
    assert forces[21] == 0
    assert target.state == DISARMED


def test_what_has_stopped_follows_no_value_again(library: ctypes.CDLL):
    """F1 of the review: a target that has stopped by itself followed the next command that crossed zero."""
    target = following(library)
    target.stop(OWN_LIMIT)
    ticks = 0
    while ticks < 3000:
        ticks += 1
        target.command(FOLLOW, 1, (1000 * math.sin(0.0147 * ticks), 0.0, 0.0) if ticks % 7 else (0.0, 0.0, 0.0))
        target.command(HOLD_ZERO, 1)
        target.tick()
        assert target.state != ARMED
    assert target.applied == [0, 0, 0]
    assert (target.c.power, target.c.causes) == (0, OWN_LIMIT)
    target.arm()
    assert target.follow((150.0, 0.0, 0.0))[0] == 150


def test_nothing_arms_while_a_cause_of_the_targets_own_is_there(library: ctypes.CDLL):
    target = disarmed(library)
    for _ in range(3):
        target.stop(EMERGENCY_STOP)
        assert target.command(HOLD_ZERO, 2) == REFUSED
        target.tick()
        assert (target.state, target.c.power) == (DISARMED, 0)
    assert target.c.causes == ASKED | EMERGENCY_STOP
    assert target.command(HOLD_ZERO, 2) == OBEYED
    assert target.c.causes == 0


def test_a_stop_right_after_arming_gives_no_power(target: CTarget):
    target.command(HOLD_ZERO, 1)
    target.stop(EMERGENCY_STOP)
    target.tick()
    assert (target.state, target.c.power, target.c.last_arm) == (DISARMED, 0, 1)


def test_commands_are_new_modulo_the_counter(library: ctypes.CDLL):
    target = CTarget(library)
    target.counter = 2**32 - 3
    target.arm()
    assert target.command(FOLLOW, 1, (100.0, 0.0, 0.0), counter=2**32 - 1) == OBEYED
    assert target.command(FOLLOW, 1, (50.0, 0.0, 0.0), counter=3) == OBEYED
    for late in (2, 0, 2**32 - 1, 3 - 2**31):
        for wanted, arm in ((FOLLOW, 1), (SAFE, 1), (FOLLOW, 7)):
            assert target.command(wanted, arm, (0.0, 0.0, 0.0), counter=late) == OLD
    assert target.command(SAFE, 1, counter=3) == REPEATED
    assert target.tick()[0] == 50
    assert (target.state, target.c.applied_counter) == (ARMED, 3)


def test_a_disarmed_target_takes_any_counter_as_abrace_may_have_been_restarted(library: ctypes.CDLL):
    target = disarmed(library)
    assert target.command(HOLD_ZERO, 2, counter=1) == OBEYED
    assert target.state == ARMED


def test_late_copies_of_an_arming_arm_nothing(library: ctypes.CDLL):
    target = disarmed(library)
    for counter in (1, 2, 5000):
        assert target.command(HOLD_ZERO, 1, counter=counter) == REFUSED
    assert target.state == DISARMED


@pytest.mark.parametrize(("last", "following_one", "wrong"), [(41, 42, 1), (2**32 - 1, 1, 0)])
def test_arming_begins_with_the_number_of_this_start_and_one_comes_after_the_greatest(
    library: ctypes.CDLL, last: int, following_one: int, wrong: int
):
    target = CTarget(library, Rig(last_arm=last))
    assert target.command(HOLD_ZERO, wrong) == REFUSED
    assert target.command(HOLD_ZERO, following_one) == OBEYED
    assert target.c.last_arm == following_one


def test_of_several_commands_in_a_tick_the_last_counter_acts_within_one_step(library: ctypes.CDLL):
    target = following(library)
    first, second, third = target.counter + 1, target.counter + 2, target.counter + 3
    target.command(FOLLOW, 1, (-1000.0, 0.0, 0.0), counter=first)
    target.command(FOLLOW, 1, (900.0, -250.0, 0.0), counter=third)
    assert target.command(FOLLOW, 1, (0.0, 0.0, 0.0), counter=second) == OLD
    assert target.tick() == [900, -250, 0]
    assert target.c.applied_counter == third


def test_hold_zero_goes_to_zero_within_the_rate_limit_and_stays_armed(library: ctypes.CDLL):
    target = following(library, (800.0, -300.0, 2.0))
    forces = [target.applied]
    for _ in range(400):
        target.command(HOLD_ZERO, 1, (700.0, 0.0, 5.0))
        forces.append(target.tick())
    assert np.array(forces)[:5, 0] == pytest.approx([800, 600, 400, 200, 0])
    assert np.abs(np.diff(np.array(forces)[:, 1])).max() <= STEP[1] * (1 + 1e-12)
    assert target.applied == [0, 0, 0]
    assert (target.state, target.c.velocity, target.c.power) == (ARMED, 0, 1)
    assert target.follow((100.0, 0.0, 0.0))[0] == 100


def test_ticks_that_were_missed_count_and_make_no_greater_step(library: ctypes.CDLL):
    target = following(library)
    ticks = target.c.ticks
    target.command(FOLLOW, 1, (0.0, 0.0, 0.0))
    assert target.tick(10) == [600, -200, 0]
    assert (target.c.ticks, target.state) == (ticks + 10, ARMED)
    for _ in range(15):
        target.tick()
    assert target.state == ARMED
    assert target.applied == [0, 0, 0]
    target.tick()
    assert (target.state, target.c.causes) == (STOPPING, NO_COMMANDS)


def test_a_ramp_goes_on_through_ticks_that_were_missed(library: ctypes.CDLL):
    target = following(library)
    target.stop(OWN_LIMIT)
    assert target.tick(25)[0] == 600  # half of the ramp, in one step of the rate limit
    assert target.tick()[0] == 400
    assert target.tick()[0] == pytest.approx(400 * (1 + math.cos(math.pi * 27 / RAMP)))
    assert ticks_to_rest(target) == RAMP - 27 + 1


def test_no_ticks_count_as_one(library: ctypes.CDLL):
    target = following(library)
    for _ in range(LIFE):
        target.tick(0)
    assert (target.state, target.c.causes) == (STOPPING, NO_COMMANDS)


def test_a_target_that_was_away_for_the_life_time_stops(library: ctypes.CDLL):
    target = following(library)
    target.command(FOLLOW, 1, (800.0, -300.0, 0.0))
    force = target.tick(LIFE + 1)[0]
    assert (target.state, target.c.causes) == (STOPPING, MISSED_TICKS)
    assert 800 - STEP[0] <= force < 800


def moved(accelerations: list[float], period: float) -> tuple[float, float]:
    """Velocity and displacement after accelerations that are linear between ticks."""
    velocity = displacement = before = 0.0
    for after in accelerations:
        displacement += period * velocity + period**2 * (before / 3 + after / 6)
        velocity += period * (before + after) / 2
        before = after
    return velocity, displacement


def test_the_tables_set_values_are_integrated_from_where_it_stands(library: ctypes.CDLL):
    target = CTarget(library)
    target.tick()
    target.sample(table=0.03)
    target.arm()
    target.sample(table=0.05)
    found = [target.follow((0.0, 0.0, 2 * math.sin(0.05 * k)))[-1] for k in range(100)]
    velocity, displacement = moved(found, 0.002)
    assert target.c.velocity == pytest.approx(velocity)
    assert target.c.displacement == pytest.approx(0.03 + displacement)


def test_a_table_moves_on_in_ticks_that_were_missed(library: ctypes.CDLL):
    target = following(library, (0.0, 0.0, 2.0))
    velocity, displacement = target.c.velocity, target.c.displacement
    target.follow((0.0, 0.0, 2.0), 10)
    expected = target.c.velocity - velocity, target.c.displacement - displacement
    again = following(library, (0.0, 0.0, 2.0))
    again.command(FOLLOW, 1, (0.0, 0.0, 2.0))
    again.tick(10)
    assert again.c.velocity - velocity == pytest.approx(expected[0])
    assert again.c.displacement - displacement == pytest.approx(expected[1])


@pytest.mark.parametrize("jerk", [20.0, 200.0, 2000.0, 1e5])
@pytest.mark.parametrize("period", [0.0005, 0.002, 0.01, 0.02])
def test_a_table_brakes_to_rest_within_its_limits(library: ctypes.CDLL, jerk: float, period: float):
    chance = random.Random(3)
    for _ in range(6):
        target = CTarget(library, Rig(period=period, table_jerk=jerk))
        target.arm()
        for _ in range(round(0.5 / period)):
            target.follow((0.0, 0.0, chance.uniform(-5, 5)))
        start, before = target.c.velocity, target.applied[-1]
        # what the jerk needs to turn the acceleration that there is, by whole ticks
        most = abs(start) + before**2 / jerk + 5 * period
        target.stop(OWN_LIMIT)
        for _ in range(round(30 / period)):
            after = target.tick()[-1]
            assert abs(after - before) <= jerk * period * (1 + 1e-9)
            assert abs(after) <= 10
            assert abs(target.c.velocity) <= most
            before = after
            if target.state == DISARMED:
                break
        assert (target.state, target.c.velocity, after) == (DISARMED, 0, 0)


@pytest.mark.parametrize("jerk", [5.0, 20.0, 2000.0])
def test_a_fast_table_does_not_swing_back(library: ctypes.CDLL, jerk: float):
    target = CTarget(library, Rig(table_jerk=jerk))
    target.arm()
    while target.c.velocity < 0.5:
        target.follow((0.0, 0.0, 1.0))
    while target.applied[-1] != 0:
        target.follow((0.0, 0.0, 0.0))
    fastest = target.c.velocity
    target.stop(OWN_LIMIT)
    velocities = []
    while target.state != DISARMED:
        target.tick()
        velocities.append(target.c.velocity)
    assert min(velocities) > -0.02 * fastest
    assert max(velocities) <= fastest


def test_the_force_is_gone_in_time_whatever_the_table_does_and_power_stays_until_the_table_is_at_rest(
    library: ctypes.CDLL,
):
    target = following(library, (800.0, 0.0, 5.0))
    target.stop(OWN_LIMIT)
    found = [(target.tick()[0], target.c.power, target.c.velocity) for _ in range(600)]
    assert [force for force, *_ in found[RAMP - 1 :]] == [0] * (601 - RAMP)
    assert all(velocity == 0 for _, power, velocity in found if not power)
    assert found[RAMP + 20][1] == 1
    assert found[-1][1] == 0


def test_a_table_at_constant_velocity_is_not_at_rest(library: ctypes.CDLL):
    target = following(library, (0.0, 0.0, 5.0))
    target.follow((0.0, 0.0, 0.0), 20)
    assert target.applied == [0, 0, 0]
    target.stop(OWN_LIMIT)
    target.tick()
    assert (target.state, target.c.power) == (STOPPING, 1)
    ticks_to_rest(target)
    assert target.c.velocity == 0


def test_a_velocity_left_by_rounding_ends_after_a_second_of_zero_commands(library: ctypes.CDLL):
    target = following(library, (0.0, 0.0, 0.1))
    target.follow((0.0, 0.0, 0.0), 400)
    assert 0.003 < target.c.velocity < 0.01
    target.follow((0.0, 0.0, 0.0), 102)
    assert target.c.velocity == 0


def test_a_slow_motion_is_not_taken_for_one_left_by_rounding(library: ctypes.CDLL):
    target = following(library, (0.0, 0.0, 0.1))
    target.follow((0.0, 0.0, -0.001), 800)
    target.follow((0.0, 0.0, 0.0))
    assert 0.001 < target.c.velocity < 0.01


def test_a_target_that_was_away_for_long_takes_no_account_of_it_in_the_tables_set_values(library: ctypes.CDLL):
    target = following(library, (0.0, 0.0, 2.0))
    velocity = target.c.velocity
    target.tick(2**32 - 1)
    assert target.c.velocity - velocity < 2 * (LIFE + 1) * 0.002
    assert 0 < target.c.displacement < 0.05


def test_a_table_that_abrace_does_not_drive_is_left_alone(library: ctypes.CDLL):
    for limits in ({}, {"table_acceleration": 0.0, "table_jerk": 0.0}):
        target = following(library, (100.0, 0.0, 5.0), table_driven=0, **limits)
        assert target.applied == [100, 0, 0]
        assert target.c.velocity == 0
        target.stop(OWN_LIMIT)
        assert ticks_to_rest(target) == RAMP + 1


@pytest.mark.parametrize("seed", range(10))
def test_trips_at_random_instants_are_never_followed_again_and_make_no_step(library: ctypes.CDLL, seed: int):
    chance = random.Random(seed)
    target, forces = following(library), []
    for _ in range(50):
        arm, last = target.c.last_arm, target.counter
        trip = chance.choice(["stop", "silence", "safe", "nan", "other", "away"])
        for _ in range(chance.randrange(1, 60)):
            forces.append(target.follow((chance.uniform(-2e3, 2e3), chance.uniform(-2e3, 2e3), chance.uniform(-9, 9))))
        assert target.state == ARMED
        if trip == "stop":
            target.stop(OWN_LIMIT)
        elif trip == "safe":
            target.command(SAFE, arm)
        elif trip == "nan":
            target.command(FOLLOW, arm, (math.nan, 0.0, 0.0))
        elif trip == "other":
            target.command(FOLLOW, arm + 1)
        else:
            ticks = [1] * (LIFE + 1) if trip == "silence" else [LIFE + 1]
            forces.extend(target.tick(each) for each in ticks)
        assert target.state == STOPPING
        while target.state != DISARMED:
            ticks = chance.choice([1, 1, 1, 2, 5])
            values = chance.uniform(-2e3, 2e3), 0.0, chance.uniform(-9, 9)
            target.command(chance.choice([HOLD_ZERO, FOLLOW]), chance.choice([0, arm, arm + 1, arm + 2]), values)
            before = target.applied
            forces.append(target.tick(ticks))
            assert target.state != ARMED
            assert all(abs(now) <= abs(then) for now, then in zip(target.applied[:2], before[:2], strict=True))
        for _ in range(30):
            target.command(FOLLOW, chance.choice([arm, arm + 1]), (chance.uniform(-1, 1), 0.0, 0.0))
            target.command(HOLD_ZERO, chance.choice([0, arm, arm + 2]))
            target.command(HOLD_ZERO, arm, counter=chance.randrange(last))
            assert target.tick() == [0, 0, 0]
            assert (target.state, target.c.power) == (DISARMED, 0)
        target.arm()
    steps = np.abs(np.diff(np.array(forces), axis=0)).max(axis=0)
    assert steps[0] <= STEP[0] * (1 + 1e-12)
    assert steps[1] <= STEP[1] * (1 + 1e-12)
    assert steps[2] <= 4 * (1 + 1e-12)


def test_a_law_on_the_target_acts_within_a_margin_of_what_abrace_commands(library: ctypes.CDLL):
    target = following(library)
    target.command(FOLLOW, 1, (800.0, -300.0, 0.0))
    assert target.force((830.0, -310.0), 0.05) == OBEYED
    assert target.tick() == [830, -310, 0]
    # the margin is from abrace's command, however often the law was followed since
    for _ in range(3):
        target.force((1e300, -1e300), 0.05)
        assert target.tick()[:2] == pytest.approx([850, -325])
    assert target.tick() == [800, -300, 0]
    target.follow((990.0, 0.0, 0.0), 10)
    target.force((1100.0, 0.0), 0.05)
    assert target.tick()[0] == 1000


def test_a_law_on_the_target_acts_only_while_commands_are_followed(library: ctypes.CDLL):
    assert CTarget(library).force((0.0, 0.0), 1.0) == REFUSED
    target = following(library)
    target.command(HOLD_ZERO, 1)
    assert target.force((800.0, 0.0), 1.0) == REFUSED
    assert target.tick()[0] == 600
    target = following(library)
    target.force((900.0, 0.0), 1.0)
    target.command(SAFE, 1)
    assert target.tick()[0] < 800
    assert target.force((900.0, 0.0), 1.0) == REFUSED
    target = following(library)
    assert target.force((math.nan, 0.0), 1.0) == NOT_FINITE
    assert (target.state, target.c.causes) == (STOPPING, BAD_COMMAND)


@pytest.mark.parametrize(
    "wrong",
    [
        {"capacity": ()},
        {"capacity": (0.0, 1.0)},
        {"capacity": (1.0, math.nan)},
        {"rate_limit": (1.0, -1.0)},
        {"rate_limit": (math.inf, 1.0)},
        {"channels": 65},
        {"period": 0.0},
        {"period": math.nan},
        {"period": 0.03},
        {"life_time": 0.003},
        {"life_time": 2.0},
        {"ramp_time": 0.001},
        {"ramp_time": math.inf},
        {"table_jerk": 0.0},
        {"table_acceleration": math.nan},
        {"table_driven": 2},
        {"table_measured": 7},
    ],
    ids=str,
)
def test_settings_that_make_no_sense_are_refused(library: ctypes.CDLL, wrong: dict[str, object]):
    target = CTarget(library)
    target.rig = Rig(**wrong)
    assert target.initial() != 0


@pytest.mark.parametrize("table_measured", [0, 1])
def test_a_sample_is_the_bytes_that_the_page_lists(library: ctypes.CDLL, table_measured: int):
    target = following(library, (100.0, -60.0, 1.5), table_measured=table_measured)
    target.stop(1 << 31)
    found = target.sample(7_000_000_001, 0.0125, (1.0, -2.5, 3e-9))
    values = [100.0, -60.0, 1.5, *([0.0125] if table_measured else []), 1.0, -2.5, 3e-9]
    body = struct.pack(f"<IIIQIIII{len(values)}d", 0x41425231, 2, 21, 7_000_000_001, STOPPING, 1 << 31, 1, 21, *values)
    assert found == body + struct.pack("<I", zlib.crc32(body))


def test_a_command_is_the_bytes_that_the_page_lists(target: CTarget):
    assert target.receive(command_packet(1, 1, HOLD_ZERO, [0.0, 0.0, 0.0])) == OBEYED
    good = command_packet(2, 1, FOLLOW, [100.0, -50.0, 1.5])
    for place in range(len(good)):
        assert target.receive(good[:place] + bytes([good[place] ^ 4]) + good[place + 1 :]) == WRONG_CRC
    assert target.receive(good[:-1]) == WRONG_LENGTH
    assert target.receive(good + b"\0") == WRONG_LENGTH
    assert target.receive(b"") == WRONG_LENGTH
    for place in (0, 4):
        body = good[:place] + b"\1" + good[place + 1 : -4]
        assert target.receive(body + struct.pack("<I", zlib.crc32(body))) == WRONG_CONSTANT
    assert (target.state, target.tick()) == (ARMED, [0, 0, 0])
    assert target.receive(good) == OBEYED
    assert target.tick() == [100, -50, 1.5]
    assert target.receive(good) == REPEATED
    assert target.receive(command_packet(3, 1, FOLLOW, [math.nan, 0.0, 0.0])) == NOT_FINITE


PAGE = (ROOT / "docs/target.md").read_text()


def on_the_page(kind: str) -> str:
    """The bytes of a packet as the page's table lists them, for `struct`; they follow each other without gaps."""
    table = PAGE.split(f"| {kind}: byte | type | field |")[1].split("\n\n")[0]
    codes, form = {"uint32": "I", "uint64": "Q", "float64": "d"}, "<"
    for byte, name, count in re.findall(r"^\| (\d+) \| (\w+)(?: x (\d+))? \|", table, re.MULTILINE):
        assert struct.calcsize(form) == int(byte)
        form += count + codes[name]
    return form


def test_the_pages_tables_are_the_packets(library: ctypes.CDLL):
    target = CTarget(library, Rig(capacity=(1000.0,), rate_limit=(1e5,), channels=10))
    body = struct.pack(on_the_page("command")[:-1], 0x41425232, 2, 1, 1, HOLD_ZERO, 0.0, 0.0)
    assert target.receive(body + struct.pack("<I", zlib.crc32(body))) == OBEYED
    target.tick()
    body = struct.pack(on_the_page("command")[:-1], 0x41425232, 2, 2, 1, FOLLOW, 50.0, -1.0)
    target.receive(body + struct.pack("<I", zlib.crc32(body)))
    target.tick()
    values = tuple(map(float, range(10)))
    *found, _ = struct.unpack(on_the_page("sample"), target.sample(77, 0.5, values))
    assert found == [0x41425231, 2, 2, 77, ARMED, 0, 1, 2, 50.0, -1.0, 0.5, *values]


def test_the_pages_cause_bits_are_the_headers():
    header = (SOURCES / "abrace_target.h").read_text()
    table = PAGE.split("| bit | name |")[1]
    for bit, name in re.findall(r"^\| (\d+) \| ([A-Z_]+) \|", table, re.MULTILINE):
        assert f"ABRACE_{name} = {bit}" in header
    assert len(re.findall(r"^\| (\d+) \| ([A-Z_]+) \|", table, re.MULTILINE)) == 8


def test_the_pages_loop_with_an_exported_controller_compiles(tmp_path: Path):
    constants = "\n".join(f"#define ABRACE_{name} 2" for name in ("STATES", "MEASURED", "COMMANDS"))
    (tmp_path / "constants.h").write_text(constants)
    exported = ROOT / "src/abrace_lqg/abrace_lqg/export/c99"
    (snippet,) = re.findall(r"```c\n(.*?)```", PAGE, re.DOTALL)
    (tmp_path / "loop.c").write_text(
        '#include "abrace_target.h"\n#include "controller.h"\nvoid loop(const double measured[]);\n'
        "void loop(const double measured[])\n{\n    static abrace_target target;\n"
        f"    static abrace_controller controller;\n    static int running;\n{snippet}}}\n"
    )
    compiled(tmp_path / "loop.o", tmp_path / "loop.c", flags=("-c", f"-I{tmp_path}", f"-I{exported}"))


def test_a_sample_says_what_acts(target: CTarget):
    target.tick()
    first = Sample(target.sample(), 2, table_measured=True)
    assert (first.state, first.causes, first.arm, first.applied_counter) == (DISARMED, RESTARTED, 0, 0)
    target.command(HOLD_ZERO, 1)
    # a command that has come acts from the next tick on
    assert Sample(target.sample(), 2, table_measured=True).applied_counter == 0
    target.tick()
    armed = Sample(target.sample(), 2, table_measured=True)
    assert (armed.state, armed.causes, armed.arm, armed.applied_counter) == (ARMED, 0, 1, 1)


def test_packets_by_chance_with_sanitizers(tmp_path: Path):
    flags = ("-g", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all")
    sources = ROOT / "tests/support/fuzz_target.c", SOURCES / "abrace_target.c"
    fuzz = compiled(tmp_path / "fuzz", *sources, flags=flags)
    ran = subprocess.run([fuzz, "100000"], capture_output=True, text=True)
    assert (ran.returncode, ran.stderr) == (0, "")
    *became, armed = map(int, ran.stdout.split())
    assert sum(became) == 100_000
    assert min(became) > 0
    assert armed > 5_000


@pytest.mark.parametrize("name", ["port_empty.c", "port_linux_udp.c"])
def test_the_ports_compile_with_every_warning_an_error(tmp_path: Path, name: str):
    compiled(tmp_path / "port", SOURCES / name, SOURCES / "abrace_target.c")


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return target_program(tmp_path_factory.mktemp("program"))


@pytest.mark.parametrize(
    "arguments",
    [[], ["capacity=x"], ["capacity=1,"], ["mass=3"], ["period"], ["period=0.002,1"], ["period=5"]],
    ids=str,
)
def test_arguments_that_make_no_sense_end_the_program(program: Path, arguments: list[str]):
    command = [program, "0", "127.0.0.1", "9", "channels=-", *(["capacity=1", "rate_limit=1"] if arguments else [])]
    ran = subprocess.run([*command, *arguments], capture_output=True, text=True, timeout=10)
    assert ran.returncode == 2
    assert len(ran.stderr.splitlines()) == 1
