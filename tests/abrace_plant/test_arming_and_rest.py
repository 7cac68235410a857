# SPDX-License-Identifier: Apache-2.0
"""What a rig wants of its target, what it makes of the target's word, and rest that is measured."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.safety.rig_safety import RAMP_TIME, REST_TIME, RigSafety, State
from abrace_plant.devices.device import Reading, TargetStatus, Wanted
from abrace_plant.devices.simulated import SimulatedRig
from abrace_plant.live.loop import ARMING_TIME, RigLoop, rig_outputs
from abrace_plant.live.rest import RestCheck
from abrace_plant.rig.file import load_rig

CONFIG = Path(__file__).parents[2] / "src/abrace_plant/config"
RATE = 500
RAMP, REST, ARMING = (round(time * RATE) for time in (RAMP_TIME, REST_TIME, ARMING_TIME))


@pytest.fixture(scope="module")
def rig():
    return load_rig(CONFIG / "ncree_three_storey.yaml")


class Target(SimulatedRig):
    """A simulated rig with what can go wrong at a target; it keeps what was wanted of it."""

    refuses = False
    cause = ""
    stuck = None
    drift = 0.0
    moved = 0.0
    measures = True

    def __init__(self, rig, seed=1) -> None:
        super().__init__(rig, seed, by_the_clock=False)
        self.asked = []

    def trip(self, cause) -> None:
        self._armed, self.cause = 0, cause

    def exchange(self, command, table, wanted, arm):
        self.asked.append((wanted, arm))
        reading = super().exchange(command, table, Wanted.SAFE if self.refuses else wanted, arm)
        if self.stuck is not None:
            reading.values[-3:-1] = self.stuck
        status = reading.target
        place = status.table + self.moved + self.drift * len(self.asked) / RATE
        return reading._replace(target=status._replace(cause=self.cause, table=place if self.measures else None))


class Bench:
    """A rig's loop in lockstep, its target, and a sender of commands."""

    def __init__(self, rig, **faults) -> None:
        self.safety = RigSafety()
        self.safety.configure(rig_outputs(rig), 1 / rig.sample_rate)
        self.safety.activate()
        self.target = Target(rig)
        for name, value in faults.items():
            setattr(self.target, name, value)
        self.loop = RigLoop(rig, self.target, self.safety, 0.02, 10, 1, lockstep=True)
        self.samples = []

    def run(self, samples, force=lambda _: 0.0) -> None:
        """Take so many samples; each is answered with the force(sample) [N]."""
        for _ in range(samples):
            self.samples.append(self.loop.step())
            self.loop.receive_command(1, self.loop.sequence, [force(self.loop.sequence)], "")

    def until(self, state, force=lambda _: 0.0, most=2000) -> int:
        """The number of samples until a state."""
        for count in range(most):
            if self.safety.state is state:
                return count
            self.run(1, force)
        raise AssertionError(f"{self.safety.state.words}: {self.safety.cause}")

    def clear(self) -> None:
        """Clear as a person does who waits until rest has been measured."""
        while "not yet known" in self.loop.moving():
            self.run(1)
        self.safety.clear(self.loop.moving())

    @property
    def forces(self) -> np.ndarray:
        return np.array([sample.command[0] for sample in self.samples])


def wanted(bench) -> list:
    """What was wanted of the target with which number, without repetitions."""
    asked = bench.target.asked
    return [one for one, before in zip(asked, [None, *asked], strict=False) if one != before]


def test_a_target_is_armed_with_a_new_number_follows_and_is_made_safe_by_every_stop(rig):
    bench = Bench(rig)
    bench.until(State.RUNNING)
    bench.run(50, lambda _: 5000.0)
    assert bench.forces[-1] == 5000.0
    assert wanted(bench) == [(Wanted.SAFE, 0), (Wanted.HOLD_ZERO, 1), (Wanted.FOLLOW, 1)]
    bench.safety.press("pressed by panel")
    bench.until(State.PROTECTIVE_STOP, lambda _: 5000.0)
    assert bench.target.asked[-2:] == [(Wanted.FOLLOW, 1), (Wanted.SAFE, 0)], "after our ramp"
    bench.run(2)
    assert bench.target.asked[-1] == (Wanted.SAFE, 0), "its brake or valve acts"
    bench.safety.release()
    bench.clear()
    bench.until(State.RUNNING)
    assert wanted(bench)[3:] == [(Wanted.SAFE, 0), (Wanted.HOLD_ZERO, 2), (Wanted.FOLLOW, 2)]


def test_a_number_that_is_not_the_next_one_arms_nothing_and_neither_does_a_value_or_follow(rig):
    target = SimulatedRig(rig, 1, by_the_clock=False)

    def armed(wanted, arm, force=0.0) -> int:
        return target.exchange([force], 0.0, wanted, arm).target.armed

    assert [armed(Wanted.FOLLOW, 1), armed(Wanted.HOLD_ZERO, 2), armed(Wanted.HOLD_ZERO, 0)] == [0, 0, 0]
    assert armed(Wanted.HOLD_ZERO, 1) == 1
    assert armed(Wanted.FOLLOW, 1, 100.0) == 1
    assert armed(Wanted.FOLLOW, 2) == 0, "another number is a stop"
    assert [armed(Wanted.HOLD_ZERO, 1), armed(Wanted.FOLLOW, 1)] == [0, 0], "an old packet"
    assert armed(Wanted.HOLD_ZERO, 2) == 2
    assert armed(Wanted.SAFE, 2) == 0
    reading = target.exchange([5000.0], 1.0, Wanted.FOLLOW, 2)
    assert (reading.target.armed, reading.target.last_arm, reading.target.applied) == (0, 2, [0.0, 0.0])


@pytest.mark.parametrize("greatest", [1000.0, 3000.0, 5000.0])
def test_a_target_that_stops_by_itself_is_a_fault_at_the_next_sample_and_never_followed_again(rig, greatest):
    bench = Bench(rig)
    bench.until(State.RUNNING)

    def sine(k):
        return greatest * math.sin(2 * math.pi * 1.17 * k / RATE)

    bench.run(300, sine)
    bench.target.trip("its own limit of stroke")
    bench.run(1, sine)
    assert bench.samples[-1].cause == "target not following: its own limit of stroke"
    assert bench.samples[-1].head.state == State.RAMPING_DOWN
    bench.until(State.LATCHED, sine)
    bench.run(1000, sine)
    assert bench.target._armed == 0
    assert all(asked == (Wanted.SAFE, 0) for asked in bench.target.asked[-1000:])
    assert not bench.forces[-1000:].any()


def test_a_target_that_does_not_arm_in_time_is_a_fault_with_its_cause(rig):
    bench = Bench(rig, refuses=True, cause="emergency stop")
    count = bench.until(State.LATCHED)
    assert bench.safety.cause == "target not armed within 0.2 s: emergency stop"
    assert count == ARMING + 2
    assert not bench.forces.any()


def test_a_sender_that_requests_a_force_before_anything_acts_is_a_fault_and_later_its_force_fades_in(rig):
    bench = Bench(rig)
    bench.until(State.LATCHED, lambda _: 24_000.0)
    assert bench.safety.cause == "brace_command still requests 24000, expected every input at rest first"
    assert not bench.forces.any()
    bench.run(2)
    bench.clear()
    bench.until(State.FADING_IN)
    bench.run(RAMP + 5, lambda _: 24_000.0)
    assert np.abs(np.diff(bench.forces)).max() < 24_000 * math.pi / 2 / RAMP * 1.01
    assert bench.forces[-1] == 24_000.0


def test_a_force_that_stays_after_a_stop_is_a_state_of_its_own_and_is_not_cleared(rig):
    bench = Bench(rig)
    bench.until(State.RUNNING)
    bench.run(50, lambda _: 20_000.0)
    bench.target.stuck = 20_000.0
    bench.safety.press("pressed by panel")
    count = bench.until(State.NOT_AT_REST)
    assert count <= RAMP + REST + 2
    bench.run(2)
    assert bench.target.asked[-1] == (Wanted.SAFE, 0)
    assert bench.samples[-1].cause == (
        "protective stop: pressed by panel; not at rest after the ramp: fa 20000 N, fb 20000 N"
    )
    bench.safety.release()
    for request in (bench.safety.clear, bench.safety.activate):
        with pytest.raises(AbraceError, match=r"^not at rest"):
            request()
    bench.target.stuck = None
    bench.until(State.LATCHED)
    bench.run(1)
    bench.target.stuck = -20_000.0
    bench.run(1)
    with pytest.raises(AbraceError, match="measured fa -20000 N, fb -20000 N, expected the rig at rest first"):
        bench.safety.clear(bench.loop.moving())


def test_a_sender_with_a_fault_lets_no_target_be_armed(rig):
    bench = Bench(rig)
    bench.samples.append(bench.loop.step())
    bench.loop.receive_command(1, 0, [0.0], "no response for 0.1 s")
    bench.until(State.LATCHED)
    assert bench.safety.cause.startswith("brace_command: its sender reports a fault: no response for 0.1 s")
    assert {asked for asked, _ in bench.target.asked} == {Wanted.SAFE}


def test_a_small_force_that_stays_after_a_stop_is_not_at_rest_either(rig):
    """8 % of the capacity: less than a brace at zero reads while the building vibrates, but it does not change."""
    bench = Bench(rig)
    bench.until(State.RUNNING)
    bench.run(50, lambda _: 2000.0)
    bench.target.stuck = 2000.0
    bench.safety.press("pressed by panel")
    slowest = math.ceil(RATE / 1.17)
    assert bench.until(State.NOT_AT_REST) <= RAMP + slowest + REST + 2
    assert bench.safety.cause.endswith("not at rest after the ramp: fa 2000 N on average, fb 2000 N on average")
    bench.safety.release()
    with pytest.raises(AbraceError, match=r"^not at rest"):
        bench.safety.clear(bench.loop.moving())
    bench.target.stuck = 500.0  # friction, and a load cell's zero
    bench.until(State.LATCHED)
    bench.clear()


def test_within_the_first_period_after_a_stop_rest_is_not_known_and_nothing_is_cleared(rig):
    """What holds 8 % of the capacity shows in the mean of a period only: until then a clear would let it go on."""
    bench = Bench(rig)
    bench.until(State.RUNNING)
    bench.run(1000)
    bench.target.stuck = 2000.0
    bench.safety.press("pressed by panel")
    bench.until(State.PROTECTIVE_STOP)
    bench.safety.release()
    refused = {}
    for _ in range(2 * RATE):
        bench.run(1)
        with pytest.raises(AbraceError) as refusal:
            bench.safety.clear(bench.loop.moving())
        refused.setdefault(str(refusal.value).partition(":")[0], len(bench.samples))
    unknown, measured, state = refused
    assert unknown == "not yet known to be at rest"
    assert measured.startswith("measured fa 2000 N on average"), "as soon as the mean is known"
    assert state.startswith("not at rest (")
    assert refused[measured] - refused[unknown] == pytest.approx(RATE / 1.17, abs=RAMP)


def test_on_a_computer_that_misses_samples_rest_is_measured_within_the_same_time(rig):
    bench = Bench(rig)
    bench.until(State.RUNNING)
    bench.safety.press("pressed by panel")
    bench.until(State.PROTECTIVE_STOP)
    bench.safety.release()
    bench.run(1)
    reading = bench.target.exchange([0.0], 0.0, Wanted.SAFE, 0)
    for k in range(1, 10):
        assert bench.loop.moving().startswith("not yet known")
        bench.loop.take(reading._replace(missed=49, stamp=reading.stamp + k * 50 * 10**9 // RATE))
    assert not bench.loop.moving()


def test_samples_missed_before_a_stop_measure_no_rest(rig):
    bench = Bench(rig)
    bench.until(State.RUNNING)
    for _ in range(50):
        bench.run(1)
        bench.loop.receive_ground_acceleration(bench.samples[-1].stamp, 0.1)
    reading = bench.target.exchange([0.0], 0.1, Wanted.FOLLOW, 1)
    bench.loop.take(reading._replace(missed=RATE))
    assert f"{RATE} samples missed" in bench.safety.cause
    assert bench.until(State.LATCHED) < RATE / 1.17, "less than a period"
    assert bench.loop.moving().startswith("not yet known")
    bench.clear()


def test_a_run_that_ends_after_a_fault_measures_rest_first_so_that_the_next_one_begins_at_rest(rig):
    bench = Bench(rig)
    bench.until(State.RUNNING)
    bench.run(50, lambda _: 2000.0)
    bench.target.stuck = 2000.0
    bench.safety.fault("test")
    bench.until(State.LATCHED)
    bench.safety.deactivate()
    bench.loop.ending = True
    bench.until(State.NOT_AT_REST)
    assert not bench.loop.ended
    bench.target.stuck = None
    bench.until(State.LATCHED)
    bench.run(1)
    assert bench.loop.ended


@pytest.mark.parametrize(
    ("fault", "value", "cause"), [("stuck", math.nan, "fa nan N, fb nan N"), ("drift", 0.03, "table at 0.03 m/s")]
)
def test_what_gives_no_number_or_is_measured_to_move_is_not_at_rest(rig, fault, value, cause):
    bench = Bench(rig)
    bench.until(State.RUNNING)
    setattr(bench.target, fault, value)
    bench.safety.press("pressed by panel")
    bench.until(State.NOT_AT_REST)
    assert bench.safety.cause.endswith(f"not at rest after the ramp: {cause}")


def test_a_device_that_gives_nothing_is_not_at_rest_until_it_does_again(rig):
    bench = Bench(rig)
    bench.until(State.RUNNING)
    for _ in range(RAMP + REST + 2):
        bench.loop.act()
        bench.loop.fail("no packet for 20 ms", 1)
    assert bench.safety.state is State.NOT_AT_REST
    assert bench.safety.cause.endswith("not at rest after the ramp: no samples of the device")
    bench.until(State.LATCHED)


@pytest.mark.parametrize("measured", [False, True])
def test_after_a_failure_with_a_moving_table_its_position_is_measured_or_unknown_until_it_is_configured_again(
    rig, measured
):
    bench = Bench(rig, measures=measured)
    bench.until(State.RUNNING)
    for _ in range(100):
        sample = bench.loop.step()
        bench.loop.receive_ground_acceleration(sample.stamp, 0.5)
    for _ in range(20):
        bench.loop.act()
        bench.loop.fail("no packet for 20 ms", 1)
    bench.until(State.LATCHED, most=4000)
    bench.run(2)
    place = bench.samples[-1].table
    if not measured:
        assert math.isnan(place)
        with pytest.raises(
            AbraceError, match="position of the table unknown, the device or its target stopped while it moved: move"
        ):
            bench.safety.clear(bench.loop.moving())
        bench.safety.deactivate()
        bench.safety.clean_up()
        bench.safety.configure(rig_outputs(rig), 1 / rig.sample_rate)
        bench.safety.clear()
        return
    _, table = bench.safety.outputs
    assert place == bench.target._table.displacement
    assert abs(table.state.displacement - bench.target._table.displacement) > 1e-3, "the target braked in its own way"
    bench.clear()
    bench.until(State.FADING_IN)
    assert table.state.displacement == bench.target._table.displacement


def test_a_table_that_was_stopped_beyond_its_interlock_has_to_be_brought_back_before_a_fault_is_cleared(rig):
    bench = Bench(rig)
    bench.until(State.RUNNING)
    while bench.safety.state is State.RUNNING:
        sample = bench.loop.step()
        bench.loop.receive_ground_acceleration(sample.stamp, 0.5)
    assert "place where the table would stop" in bench.safety.cause
    for _ in range(2 * RATE):
        sample = bench.loop.step()
        bench.loop.receive_ground_acceleration(sample.stamp, 0.0)
    assert bench.safety.state is State.LATCHED
    expected = r"table 0\.2\d* m from its middle, limit 0\.24 \(interlocks\.table_displacement\): move it to the middle"
    with pytest.raises(AbraceError, match=expected):
        bench.safety.clear(bench.loop.moving())
    bench.safety.deactivate()
    bench.safety.clean_up()
    bench.safety.configure(rig_outputs(rig), 1 / rig.sample_rate)
    bench.safety.clear()


def test_a_fault_is_cleared_by_where_the_table_is_measured_to_stand_whatever_was_commanded(rig):
    bench = Bench(rig)
    bench.until(State.RUNNING)
    _, table = bench.safety.outputs
    bench.target.trip("a limit of its own")
    bench.run(1)
    table.state.displacement = -1.2  # integrated over samples that this computer missed
    bench.until(State.LATCHED)
    for place in (0.25, -0.25):
        bench.target.moved = place
        bench.run(500)
        with pytest.raises(AbraceError, match=rf"table {place:.3g} m from its middle, limit 0\.24"):
            bench.clear()
    bench.target.moved = 0.1  # by hand
    bench.run(500)
    bench.clear()
    bench.until(State.RUNNING)
    assert table.state.displacement == 0.1
    assert bench.samples[-1].table == 0.1


def test_samples_that_were_missed_count_in_the_velocity_that_the_table_is_measured_to_have(rig):
    rest = RestCheck(rig, None)
    status = TargetStatus(1, 1, "", [0.0, 0.0], 0.0)
    reading = Reading(np.zeros(11), 0, 0, 0, status)
    assert not rest.problem(reading, commanded=False)
    places = 0.01 / RATE * np.arange(4, 801, 4) + 0.04 / RATE * np.maximum(np.arange(4, 801, 4) - 400, 0)
    found = [
        rest.problem(reading._replace(missed=3, target=status._replace(table=place)), commanded=False)
        for place in places.tolist()
    ]
    assert not any(found[:100]), "0.01 m/s"
    assert set(found[120:]) == {"table at 0.05 m/s"}


def test_a_table_with_a_controller_of_its_own_is_not_driven_and_does_not_count_as_ours(rig):
    bench = Bench(replace(rig, table_driven=False), drift=0.03)
    bench.until(State.RUNNING)
    bench.run(100)
    assert bench.samples[-1].table == bench.target.drift * len(bench.target.asked) / RATE, "as measured"
    bench.safety.press("pressed by panel")
    bench.until(State.PROTECTIVE_STOP)
    bench.safety.release()
    bench.clear()
    bench.until(State.RUNNING)
    bench.loop.receive_ground_acceleration(bench.samples[-1].stamp, 0.5)
    bench.until(State.LATCHED)
    assert bench.safety.cause == (
        "ground_motion: the table is driven by its own controller (table.driven: false in the rig file): "
        "start the motion there, abrace triggers nothing"
    )
    bench.target.measures = False
    bench.run(1)
    assert math.isnan(bench.samples[-1].table), "nobody knows where it is"


@pytest.mark.parametrize("name", sorted(path.stem for path in CONFIG.glob("*.yaml")))
def test_a_stop_in_strong_motion_comes_to_rest_in_every_shipped_rig(name):
    """Braces that hold zero in a building that still vibrates read a force, within the limit."""
    rig = load_rig(CONFIG / f"{name}.yaml")
    rate, random = rig.sample_rate, np.random.default_rng(3)
    noise = np.convolve(random.normal(0.0, 1.0, round(12 * rate)), np.hanning(round(0.2 * rate)), "same")
    noise -= np.convolve(noise, np.full(round(rate), 1 / rate), "same")
    ground = 2.0 * noise / np.abs(noise).max()
    bench = Bench(rig)
    bench.loop.interlocks.check = lambda *_: None  # the building goes further than it may
    bench.loop.until_it_acts()
    for acceleration in ground.tolist():
        sample = bench.loop.step()
        bench.loop.receive_ground_acceleration(sample.stamp, acceleration)
    bench.safety.press("pressed by panel")
    states = [bench.loop.step().head.state for _ in range(round(5 * rate))]
    assert set(states) == {State.RAMPING_DOWN, State.PROTECTIVE_STOP}
