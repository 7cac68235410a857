# SPDX-License-Identifier: Apache-2.0
"""A run by the clock, with a device that fails, delays and ends as it is told."""

import random
import subprocess
import threading
import time
from collections import defaultdict
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
from emulated_target import TICKING, EmulatedTarget
from udp_target import device_file

from abrace_core.safety.rig_safety import RigSafety, State
from abrace_core.safety.wire import LAST
from abrace_plant.devices.device import DeviceError, Reading
from abrace_plant.devices.simulated import SimulatedRig
from abrace_plant.devices.udp import load
from abrace_plant.live import real_time
from abrace_plant.live.loop import RigLoop, rig_outputs
from abrace_plant.live.real_time import RealTimeRun
from abrace_plant.rig.file import load_rig

PERIOD = 0.002


@pytest.fixture(scope="module")
def rig():
    return load_rig(Path(__file__).parents[2] / "src/abrace_plant/config/ncree_three_storey.yaml")


class Bench:
    """A run in its thread, with all of its samples."""

    def __init__(self, rig, device, period=PERIOD) -> None:
        self.lock = threading.RLock()
        self.safety = RigSafety()
        self.safety.configure(rig_outputs(rig), period)
        self.safety.activate()
        self.loop = RigLoop(rig, device, self.safety, 10.0, 10_000, 1, lockstep=False)
        self.samples = []
        self.over = threading.Event()
        device.open()
        self.run = RealTimeRun(self.loop, device, period, self.lock, self.publish, self.over.set, prepare=lambda: None)
        self.run.start()

    def publish(self, sample) -> None:
        if sample is not None:
            self.samples.append(sample)
        self.loop.note_stops_polled()  # as a node's second thread does

    def until(self, holds) -> None:
        deadline = time.monotonic() + 20
        while not holds():
            assert time.monotonic() < deadline
            time.sleep(0.001)

    def until_it_acts(self) -> None:
        self.until(lambda: self.loop.began >= 0)

    def end(self) -> None:
        with self.lock:
            self.safety.deactivate()
            self.loop.ending = self.loop.give_up = True
        assert self.over.wait(20)


def test_samples_are_stamped_with_their_real_instants_and_the_run_ends_at_rest(rig):
    begin = time.time_ns()
    bench = Bench(rig, SimulatedRig(rig, 1, by_the_clock=True))
    bench.until_it_acts()
    with bench.lock:
        bench.loop.receive_command(1, bench.loop.sequence, [5000.0], "")
        bench.run.on_input()
    bench.until(lambda: bench.samples[-1].command[0] == 5000.0)
    bench.end()
    stamps = np.array([sample.stamp for sample in bench.samples])
    sequences = np.array([sample.head.sequence for sample in bench.samples])
    assert begin <= stamps[0]
    assert stamps[-1] <= time.time_ns()
    assert (np.diff(stamps) > 0).all()
    due = begin + sequences * 2_000_000
    assert (stamps - due > -1_000_000).all(), "no sample is taken before it is due"
    last = bench.samples[-1]
    assert last.head.flags & LAST
    assert last.head.state == State.STANDBY
    assert bench.run.errors == []
    commands = np.array([sample.command[0] for sample in bench.samples])
    assert np.abs(np.diff(commands)).max() <= 2.5e6 * PERIOD


def test_a_rig_that_stood_still_has_missed_samples_and_goes_on_in_real_time(rig):
    class Held(SimulatedRig):
        held = False

        def exchange(self, command, table, *target):
            if self._samples >= 50 and not self.held:
                self.held = True
                time.sleep(0.1)
            return super().exchange(command, table, *target)

    bench = Bench(rig, Held(rig, 1, by_the_clock=True))
    bench.until(lambda: bench.loop.sequence >= 150)
    bench.end()
    sequences = np.array([sample.head.sequence for sample in bench.samples])
    gaps = np.diff(sequences) - 1
    assert gaps.max() >= 40, "100 ms are 50 samples"
    assert bench.loop.missed == gaps.sum()


def test_a_device_that_makes_up_for_a_delay_without_saying_so_ramps_no_faster_than_the_clock(rig):
    class CatchingUp(SimulatedRig):
        """Gives 1000 samples at once, as a card that ticked on while this computer was delayed for two seconds."""

        given = 0

        def exchange(self, command, table, *target):
            self.given += 1
            if self.given == 1:
                self.ticker = Ticker()
            missed = 0 if 600 < self.given < 1600 else self.ticker.wait()
            for _ in range(missed):
                super().exchange(command, table, *target)
            return super().exchange(command, table, *target)._replace(missed=missed)

    class Answered(Bench):
        """All answer at once; the stop is pressed in the midst of the samples."""

        def publish(self, sample):
            super().publish(sample)
            self.loop.receive_command(1, sample.head.sequence, [5000.0 if self.loop.began >= 0 else 0.0], "")
            self.loop.receive_ground_acceleration(sample.stamp, 0.0)
            if self.begin is None and device.given > 610:
                self.begin = time.monotonic()
                self.safety.press("panel")
            if self.safety.state == State.PROTECTIVE_STOP and self.end_of_ramp is None:
                self.end_of_ramp = time.monotonic()

        begin = end_of_ramp = None

    warned = {name: replace(interlock, action="warn") for name, interlock in rig.interlocks.items()}
    device = CatchingUp(rig, 1, by_the_clock=False)
    bench = Answered(replace(rig, interlocks=warned), device)
    bench.until(lambda: bench.end_of_ramp is not None)
    assert bench.end_of_ramp - bench.begin > 0.48, "the ramp takes 0.5 s"
    bench.end()


class Ticker:
    """Ticks of this computer's clock."""

    def __init__(self) -> None:
        self.due = time.monotonic()

    def wait(self) -> int:
        """Wait for the next; returns how many were missed."""
        self.due += PERIOD
        time.sleep(max(0.0, self.due - time.monotonic()))
        missed = int((time.monotonic() - self.due) / PERIOD)
        self.due += missed * PERIOD
        return missed


class Scripted:
    """A device that does what its script says of each exchange, and keeps what it was sent."""

    def __init__(self, rig, fails) -> None:
        self.rig = SimulatedRig(rig, 1, by_the_clock=False)
        self.fails, self.sent, self.safe, self.closed = fails, [], False, False

    def open(self) -> None:
        self.ticker = Ticker()

    def exchange(self, command, table, *target) -> Reading:
        self.sent.append((list(command), table))
        missed = self.ticker.wait()
        error = self.fails(len(self.sent))
        if error is not None:
            raise error
        return self.rig.exchange(command, table, *target)._replace(stamp=time.time_ns(), missed=missed)

    def make_safe(self) -> None:
        self.safe = True

    def close(self) -> None:
        self.closed = True


def test_a_device_that_fails_is_a_fault_and_is_still_sent_the_way_to_rest(rig):
    device = Scripted(rig, lambda count: DeviceError("no packet for 10 ms") if 600 <= count < 950 else None)
    bench = Bench(rig, device)
    bench.until_it_acts()
    with bench.lock:
        bench.loop.receive_command(1, bench.loop.sequence, [5000.0], "")
    bench.until(lambda: len(device.sent) > 970 and bench.safety.state is State.LATCHED)
    assert bench.safety.cause.startswith("no packet for 10 ms")
    force = np.array([command[0] for command, _ in device.sent])
    assert force.max() == 5000.0
    assert force[-1] == 0.0
    assert (np.diff(force[np.argmax(force == 5000.0) :]) <= 0).all()
    assert not device.safe, "the way to rest is ours"
    bench.end()
    assert device.safe
    assert device.closed


def test_the_way_to_rest_is_no_faster_on_a_device_that_fails_at_once(rig):
    class Broken(Scripted):
        def exchange(self, command, table, *target) -> Reading:
            if len(self.sent) < 600:
                return super().exchange(command, table, *target)
            self.sent.append((list(command), table))
            self.times.append(time.monotonic())
            raise DeviceError("the card does not answer")

    device = Broken(rig, lambda _: None)
    device.times = []
    bench = Bench(rig, device)
    bench.until_it_acts()
    with bench.lock:
        bench.loop.receive_command(1, bench.loop.sequence, [5000.0], "")
    bench.until(lambda: bench.safety.state is State.NOT_AT_REST)
    bench.end()
    # One call may be late and the next on time: what counts is how many there were in the whole time.
    calls = len(device.times) - 1
    assert calls > 10
    assert device.times[-1] - device.times[0] >= 0.5 * calls * PERIOD
    force = np.array([command[0] for command, _ in device.sent])
    assert force.max() == 5000.0
    assert force[-1] == 0.0


def test_a_tick_is_never_ahead_of_the_clock(rig):
    class SetBack(SimulatedRig):
        def exchange(self, command, table, *target):
            return super().exchange(command, table, *target)._replace(age=-3600.0)

    bench = Bench(rig, SetBack(rig, 1, by_the_clock=False))
    with bench.lock:
        bench.loop.receive_command(1, bench.loop.sequence, [1.0], "")  # from now on an answer is waited for
    bench.until(lambda: len(bench.samples) >= 100)
    bench.end()


def test_the_answers_to_a_sample_have_until_a_share_of_the_period_after_its_tick(rig):
    period, age, asked = 0.2, 0.17, []

    class Late(SimulatedRig):
        """Its samples arrive after the share of the period."""

        given = 0.0

        def exchange(self, command, table, *target):
            asked.append(time.monotonic() - self.given)
            time.sleep(max(0.0, self.given + period - time.monotonic()))
            self.given = time.monotonic()
            return super().exchange(command, table, *target)._replace(age=age)

    slow = Bench(rig, Late(rig, 1, by_the_clock=False), period=period)
    slow.until(lambda: len(slow.samples) >= 10)
    slow.end()
    assert np.median(asked[1:]) < 0.05, "nobody has answered, and no answer is waited for"


def test_a_rig_that_is_held_up_sends_no_step_beyond_the_rate_limit_from_tick_to_tick(rig, monkeypatch):
    """The clock is ours: else whatever else holds this thread up would count."""

    class Clock:
        now = 0.0

        def monotonic(self) -> float:
            self.now += 1e-6
            return self.now

        def monotonic_ns(self) -> int:
            return round(1e9 * self.now)

        time_ns = monotonic_ns

    class Target(Scripted):
        """Has ticks of its own, and uses at each the last command that was sent before it."""

        def exchange(self, command, table, *target) -> Reading:
            self.sent.append((clock.monotonic(), command[0]))
            self.ticks.append(self.ticks[-1] + PERIOD if self.ticks else clock.now)
            clock.now = max(clock.now, self.ticks[-1])
            return self.rig.exchange(command, table, *target)._replace(age=clock.monotonic() - self.ticks[-1])

    clock = Clock()
    monkeypatch.setattr(real_time, "time", clock)
    warned = {name: replace(one, action="warn") for name, one in rig.interlocks.items()}
    rig = replace(rig, interlocks=warned)
    device = Target(rig, lambda _: None)
    device.ticks = []
    chance = random.Random(1)

    class HeldUp(Bench):
        """Answers with the greatest forces, to and fro; now and then the loop is held up, for up to three ticks."""

        def publish(self, sample) -> None:
            super().publish(sample)
            number = sample.head.sequence
            if self.loop.began >= 0:
                self.loop.receive_command(1, number, [24e3 if number // 16 % 2 else -24e3], "")
            clock.now += PERIOD * (chance.uniform(1.0, 3.0) if chance.random() < 0.1 else chance.uniform(0.0, 0.7))

    bench = HeldUp(rig, device)
    bench.until(lambda: len(bench.samples) > 2300)
    bench.end()
    sent, forces = np.array(device.sent).T
    used = np.searchsorted(sent, device.ticks)
    at_ticks = forces[used[used > 0] - 1]
    assert np.abs(at_ticks).max() == 24e3
    assert np.abs(np.diff(at_ticks)).max() <= 2.5e6 * PERIOD * (1 + 1e-12)


@pytest.mark.parametrize(
    "phases",
    [
        [["command.loss=0.05", "command.jitter=0.0005"]],
        # slower by a tick, by two, and as quick as before again
        [["command.delay=0.002", "command.loss=0.02"], ["command.delay=0.004"], ["clear", "command.loss=0.05"]],
    ],
)
def test_commands_that_are_lost_or_late_make_no_step_beyond_the_rate_limit_at_the_target(phases, rig, tmp_path):
    path = device_file(tmp_path, timeout=0.9)
    target = EmulatedTarget(path)
    process = subprocess.Popen([str(part) for part in target.command], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout.readline() == f"{TICKING}\n"
        warned = {name: replace(one, action="warn") for name, one in rig.interlocks.items()}
        rig = replace(rig, interlocks=warned)
        device = load(path, rig)

        class Following(Bench):
            """Answers with the greatest forces, to and fro, and at once."""

            def publish(self, sample) -> None:
                super().publish(sample)
                number = sample.head.sequence
                if self.loop.began >= 0:
                    self.loop.receive_command(1, number, [24e3 if number // 100 % 2 else -24e3], "")
                    self.loop.receive_ground_acceleration(sample.stamp, 0.0)

        bench = Following(rig, device)
        bench.until_it_acts()
        begin = len(bench.samples)
        for number, faults in enumerate(phases, 1):
            for fault in faults:
                assert target.ask(fault) == "ok"
            bench.until(lambda number=number: len(bench.samples) > begin + 1000 * number / len(phases))
        bench.end()
        found = target.report()
    finally:
        process.terminate()
        process.communicate(timeout=20)
    assert found["worst_force"] == 24e3, bench.safety.cause
    assert found["worst_step_over_rate_limit"] <= 1 + 1e-9


def test_a_sender_that_is_always_late_does_not_hold_up_the_others_commands(rig):
    waited = defaultdict(list)

    class Slow(Bench):
        """Answers for the braces late from sample 100 to 200, for the table not at all from 150 to 160."""

        def publish(self, sample) -> None:
            super().publish(sample)
            number = sample.head.sequence
            if not 150 <= number < 160:
                self.loop.receive_ground_acceleration(sample.stamp, 0.0)
            self.loop.receive_command(1, number - 5 if 100 <= number < 200 else number, [1.0], "")

    rig = replace(rig, sample_rate=100.0)  # a stall of the machine is a few of these samples at most
    bench = Slow(rig, SimulatedRig(rig, 1, by_the_clock=True), 0.01)
    with bench.lock:
        wait_for = bench.run._input_arrived.wait_for

        def noted(holds, timeout):
            waited[bench.loop.sequence] += [] if holds() else [holds.__name__]
            return wait_for(holds, timeout)

        bench.run._input_arrived.wait_for = noted
    bench.until(lambda: bench.loop.sequence > 300)
    bench.end()

    def waits(first: int, end: int) -> list[list[str]]:
        """What was waited for after these samples, each once; a stalled machine misses some."""
        return [what for what, _ in groupby(sorted(waited[number] for number in range(first, end) if number in waited))]

    assert waits(20, 100) == [[]]
    assert waits(100, 105) == [["has_quick_answers"]], "nobody is slow yet"
    assert waits(135, 150) == [["has_all_answers"]], "for a shorter time"
    assert waits(150, 160) == [["has_all_answers", "has_quick_answers"]]
    assert waits(160, 200) == [["has_all_answers"]]
    assert waits(205, 300) == [[]]


def test_a_device_that_cannot_be_made_safe_is_closed_and_the_run_ends_with_that_error(rig):
    class Broken(Scripted):
        def make_safe(self) -> None:
            raise OSError("no card")

    device = Broken(rig, {}.get)
    bench = Bench(rig, device)
    bench.until(lambda: len(bench.samples) > 5)
    bench.end()
    assert [str(error) for error in bench.run.errors] == ["no card"]
    assert device.closed


def test_an_error_in_the_run_makes_the_device_safe_and_is_told(rig):
    device = Scripted(rig, lambda count: ValueError("a mistake") if count == 20 else None)
    bench = Bench(rig, device)
    assert bench.over.wait(20)
    assert [str(error) for error in bench.run.errors] == ["a mistake"]
    assert device.safe
    assert device.closed
