# SPDX-License-Identifier: Apache-2.0
"""A device's own ticks: wrong rates, stamps that stand still, go back or have another unit, and what is none of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.safety.rig_safety import RigSafety, State
from abrace_plant.devices.simulated import SimulatedRig
from abrace_plant.live.loop import RigLoop, rig_outputs
from abrace_plant.live.real_time import FASTEST, LONGEST_BURST
from abrace_plant.live.ticks import DRIFT, EARLY, LEAD, WINDOW, Ticks
from abrace_plant.rig.file import load_rig

RATE = 500
PERIOD = 2_000_000
BEGIN = 1_700_000_000 * 10**9
SECOND = 10**9
FILE = "(sample_rate of the rig file)"


class Samples:
    """Samples that come as they are told, with the clocks of the computer that takes them."""

    def __init__(self, rate: float = RATE) -> None:
        self.ticks = Ticks(rate)
        self.sequence, self.wall = -1, BEGIN
        self.found: dict[str, int] = {}
        """By problem, the sample with which it was found."""

    def take(self, stamp: float, now: float | None, missed: int = 0) -> None:
        """One with its stamp after BEGIN and the monotonic time at which it comes [ns]."""
        self.sequence += 1 + missed
        clocks = None if now is None else (round(now), self.wall + round(now))
        self.ticks.take(self.sequence, BEGIN + round(stamp), clocks)
        if self.ticks.problem:
            self.found.setdefault(self.ticks.problem, self.sequence)

    def give(self, seconds: float, by_stamps: float = 1.0, by_clock: float | None = 1.0, begin: int = 0) -> None:
        """Give samples whose stamps and whose instants are so many periods apart."""
        for k in range(begin, begin + round(seconds * RATE)):
            self.take(by_stamps * k * PERIOD, None if by_clock is None else by_clock * k * PERIOD)


@pytest.fixture
def samples() -> Samples:
    return Samples()


@pytest.mark.parametrize(
    ("samples_per_second", "seconds"), [(494.0, 1.02), (506.0, 1.02), (250.0, 0.21), (1000.0, 0.11)]
)
@pytest.mark.parametrize("by_clock", [1.0, None])
def test_a_wrong_rate_by_the_stamps_is_named_within_two_windows(samples, samples_per_second, seconds, by_clock):
    samples.give(seconds + (WINDOW / 2 if by_clock else 0), by_stamps=RATE / samples_per_second, by_clock=by_clock)
    assert list(samples.found) == [f"device: {samples_per_second:g} samples/s by its stamps, expected 500 {FILE}"]


@pytest.mark.parametrize("samples_per_second", [494.0, 400.0, 250.0])
def test_samples_that_come_too_slowly_are_named_whatever_their_stamps_say(samples, samples_per_second):
    samples.give(2.03 * WINDOW, by_clock=RATE / samples_per_second)
    expected = f"device: {samples_per_second:g} samples/s by this computer's clock, expected 500 {FILE}"
    assert list(samples.found) == [expected]


@pytest.mark.parametrize("excess", [FASTEST - 1, 0.1, 10.0])
def test_samples_that_come_too_quickly_are_named_whatever_their_stamps_say(samples, excess):
    """The least excess is that to which a run by the clock holds up a device: it takes the longest."""
    seconds = WINDOW + 1.1 * LEAD / (excess - DRIFT)
    samples.give((1 + excess) * seconds + 0.01, by_clock=1 / (1 + excess))
    assert list(samples.found) == [f"device: more than 500 samples/s {FILE} by this computer's clock"]


def test_a_device_with_a_cheap_clock_that_is_late_and_early_at_random_is_right():
    random = np.random.default_rng(5)
    for drift in (-1e-4, 1e-4):
        samples = Samples()
        late = random.uniform(0, 0.9 * PERIOD, 150_000)
        for k, delay in enumerate(late.tolist()):
            samples.take((1 + drift) * k * PERIOD + delay, (1 + drift) * k * PERIOD + delay)
        assert samples.found == {}


@pytest.mark.parametrize("stall", [0.005, 0.1, 1.5])
@pytest.mark.parametrize("begin", [20, 700, 3000])
def test_after_a_stall_of_this_computer_a_device_may_catch_up_what_was_missed(stall, begin):
    """Samples that waited are used as fast as a run does, with right stamps or those of their arrival, or missed."""
    for stamped in ("at its tick", "as it comes"):
        samples, now, accounted = Samples(), 0.0, -1e12
        for k in range(20_000):
            held = begin * PERIOD + stall * SECOND if begin <= k else 0
            now = max(k * PERIOD, held, now + 20_000, accounted - LONGEST_BURST * SECOND)
            accounted = max(accounted + PERIOD / FASTEST, now)
            samples.take(k * PERIOD if stamped == "at its tick" else now, now)
        assert samples.found == {}
    samples = Samples()
    lost = round(stall * RATE)
    for k in (*range(begin), *range(begin + lost, 5000)):
        samples.take(k * PERIOD, k * PERIOD, missed=lost if k == begin + lost else 0)
    assert samples.found == {}


def test_stalls_again_and_again_are_no_slow_device(samples):
    random, free = np.random.default_rng(2), 0.0
    for k in range(30_000):
        free = max(k * PERIOD + (0.02 * SECOND if random.random() < 0.01 else 0.0), free + 20_000)
        samples.take(k * PERIOD, free)
    assert samples.found == {}


@pytest.mark.parametrize("rate", [500.0, 600.0, 1e5])
def test_a_device_that_is_too_quick_is_named_before_anything_is_armed_and_one_of_which_samples_waited_is_not(rate):
    """As a run takes them: none is held up before. All are stamped when they come."""
    samples, now = Samples(), 0.15 * SECOND  # the first publication took so long
    samples.take(0, 0)
    while now < (0.15 + 0.9 * WINDOW) * SECOND:
        samples.take(now, now)
        now = max(now + 20_000, (samples.sequence + 1) * SECOND / rate)
    assert samples.ticks.begins
    assert bool(samples.found) is (rate > RATE)
    samples.take(now + 0.2 * SECOND, now + 0.2 * SECOND)
    assert not samples.ticks.begins


def test_a_computer_that_falls_behind_a_device_that_says_so_is_no_slow_device(samples):
    """By 100 samples in 2 s; then it makes up for them ten times as fast."""
    for k in range(2000):
        age = 0.0002 * k if k < 1000 else max(0.0, 0.2 - 0.0018 * (k - 1000))
        now = k * PERIOD + round(age * SECOND)
        samples.sequence += 1
        samples.ticks.take(samples.sequence, BEGIN + k * PERIOD, (now, BEGIN + now), age)
        assert not samples.ticks.problem


def test_samples_missed_without_a_word_are_a_slow_device(samples):
    samples.give(1.2, by_clock=1.02)
    assert list(samples.found) == [f"device: 490.2 samples/s by this computer's clock, expected 500 {FILE}"]


@pytest.mark.parametrize(
    ("step", "given", "unit"), [(2000.0, "2e+03", "us"), (2.0, "2", "ms"), (2e9, "2e+09", "ns"), (2e12, "2e+12", "ns")]
)
def test_stamps_of_another_unit_are_named_before_anything_is_armed(samples, step, given, unit):
    samples.give(WINDOW / 2 + (2 * EARLY[0] + 4) / RATE, by_stamps=step / PERIOD)
    assert samples.ticks.begins
    assert list(samples.found) == [f"device: steps of 2e+06 ns expected, {given} given: are the stamps in {unit}?"]


def test_stamps_that_stand_still_are_named_at_once(samples):
    samples.give(1.0)
    samples.take(499 * PERIOD, 500 * PERIOD)
    assert samples.found == {f"device: stamp of sample 500 stands still at {BEGIN + 499 * PERIOD} ns": 500}


def test_stamps_in_seconds_stand_still(samples):
    for k in range(3):
        samples.take(k * PERIOD // SECOND, k * PERIOD)
    assert samples.found == {f"device: stamp of sample 1 stands still at {BEGIN} ns": 1}


def test_a_stamp_that_goes_back_is_named_and_holds_until_the_ticks_have_been_right_for_two_windows(samples):
    samples.give(2.0)
    for k in range(1000, 4000):
        samples.take(k * PERIOD - 0.2 * SECOND - PERIOD, k * PERIOD)
        assert bool(samples.ticks.problem) is (k <= 1000 + 2 * WINDOW * RATE + 1)
    assert samples.found == {"device: stamp of sample 1000 goes back by 0.2 s": 1000}


@pytest.mark.parametrize("set_by", [-7200.0, -1.0, -0.01, 0.01, 3600.0])
@pytest.mark.parametrize("behind", [0, 4])
def test_when_this_computers_clock_is_set_its_stamps_are_no_fault_of_the_device(samples, set_by, behind):
    """`behind`: samples with the old time still wait; and a udp device's stamps never go back by a little."""
    newest = -(10**18)
    for k in range(5000):
        if k == 2000:
            samples.wall += round(set_by * SECOND)
        stamp = k * PERIOD + (set_by * SECOND if k >= 2000 + behind else 0)
        newest = stamp if stamp < newest - 0.02 * SECOND else max(stamp, newest + 1)
        samples.take(newest, k * PERIOD)
    assert samples.found == {}


def test_a_stamp_goes_back_also_after_this_computers_clock_was_set(samples):
    samples.give(2.0)
    samples.wall += SECOND
    samples.give(2.0, begin=1000)
    samples.take(100 * PERIOD, 2000 * PERIOD)
    assert list(samples.found) == ["device: stamp of sample 2000 goes back by 3.8 s"]


def test_a_failure_of_the_device_begins_the_judgement_anew(samples):
    samples.give(2.0)
    samples.ticks.restart()
    samples.sequence += 500
    for k in range(2000):
        samples.take(k * PERIOD, 10 * SECOND + k * PERIOD)
    assert samples.found == {}


@pytest.fixture(scope="module")
def rig():
    return load_rig(Path(__file__).parents[2] / "src/abrace_plant/config/ncree_three_storey.yaml")


class Ticking(SimulatedRig):
    """A rig whose stamps are so many periods apart."""

    step, now = 1.0, BEGIN

    def exchange(self, *given):
        self.now += round(self.step * PERIOD)
        return super().exchange(*given)._replace(stamp=self.now)


class Bench:
    """A loop of a rig whose device ticks as it is told."""

    def __init__(self, rig, step: float = 1.0) -> None:
        self.safety = RigSafety()
        self.safety.configure(rig_outputs(rig), 1 / rig.sample_rate)
        self.safety.activate()
        self.device = Ticking(rig, 1, by_the_clock=False)
        self.device.step = step
        self.loop = RigLoop(rig, self.device, self.safety, 0.02, 10, 1, lockstep=True)

    def run(self, seconds: float, force: float = 0.0) -> np.ndarray:
        """Answer each sample; returns the commands that acted [N]."""
        acted = []
        for _ in range(round(seconds * RATE)):
            acted.append(self.loop.step().command[0])
            self.loop.receive_command(1, self.loop.sequence, [force], "")
        return np.array(acted)


def test_while_commands_act_it_is_a_fault_and_the_force_is_ramped(rig):
    bench = Bench(rig)
    bench.run(0.7)
    assert bench.run(1.0, 1000.0)[-1] == 1000.0
    bench.device.step = 1.5
    forces = bench.run(1.5, 1000.0)
    assert bench.safety.cause == f"device: 333.3 samples/s by its stamps, expected 500 {FILE}"
    assert bench.safety.state is State.LATCHED
    assert forces[-1] == 0.0
    assert np.diff(forces).min() > -10.0, "no step"


def test_while_it_holds_nothing_is_armed_and_nothing_cleared(rig):
    bench = Bench(rig, step=2.0)
    bench.run(2.0)
    for _ in range(2):
        assert bench.safety.state is State.LATCHED
        assert bench.safety.cause == f"device: 250 samples/s by its stamps, expected 500 {FILE}"
        with pytest.raises(AbraceError, match="250 samples/s by its stamps, expected 500"):
            bench.safety.clear(bench.loop.moving())
        bench.run(1.0)
    bench.device.step = 1.0
    bench.run(2.5 * WINDOW)
    bench.safety.clear(bench.loop.moving())
    bench.run(1.0)
    assert bench.safety.state is State.RUNNING


def test_by_the_clock_nothing_is_armed_before_the_ticks_have_been_judged_for_a_window(rig):
    bench, states = Bench(rig), []
    for k in range(400):
        clocks = k * PERIOD, BEGIN + k * PERIOD
        states.append(bench.loop.take(bench.loop.exchange(*bench.loop.act()), clocks).head.state)
    assert states.count(State.ARMING) == 1 + WINDOW * RATE + 1
    assert states[-1] == State.FADING_IN


def test_a_device_whose_clock_begins_anew_after_it_has_failed_is_right(rig):
    bench = Bench(rig)
    bench.run(1.0)
    bench.loop.fail("no sample for 20 ms", 10)
    bench.device.now = BEGIN
    bench.run(0.1)
    assert not bench.loop.ticks.problem
