# SPDX-License-Identifier: Apache-2.0
"""The rig sample by sample: timing of inputs, faults, determinism."""

import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from interpreter import yields

from abrace_core import AbraceError
from abrace_core.model.simulation import simulate
from abrace_core.safety.rig_safety import RAMP_TIME, RigSafety, State
from abrace_core.safety.wire import LAST, LATE, LOCKSTEP, SATURATED
from abrace_plant.devices.device import Reading, TargetStatus, Wanted
from abrace_plant.devices.simulated import SimulatedRig
from abrace_plant.live.loop import COMMAND, GROUND, LONGEST_WITHOUT_STOPS, RigLoop, rig_outputs
from abrace_plant.live.real_time import RealTimeRun
from abrace_plant.rig.file import load_rig

TIMEOUT = 0.02
RUN = 5
LATE_LIMIT = 10
STATUS = TargetStatus(1, 1, "", [])


@pytest.fixture(scope="module")
def rig():
    return load_rig(Path(__file__).parents[2] / "src/abrace_plant/config/ncree_three_storey.yaml")


class Bench:
    """A loop with its safety and all of its samples."""

    def __init__(self, rig, lockstep=True, acts=True) -> None:
        self.safety = RigSafety()
        self.safety.configure(rig_outputs(rig), 1 / rig.sample_rate)
        self.safety.activate()
        self.device = SimulatedRig(rig, 1, by_the_clock=False)
        self.loop = RigLoop(rig, self.device, self.safety, TIMEOUT, LATE_LIMIT, RUN, lockstep)
        if acts:
            self.loop.until_it_acts()
        self.loop.note_stops_polled()
        self.samples = []

    def step(self):
        self.samples.append(self.loop.step())
        return self.samples[-1]

    def answer(self, force=None, ground=None, fault="") -> None:
        """Answer the last sample."""
        if force is not None:
            self.loop.receive_command(RUN, self.loop.sequence, np.atleast_1d(force).tolist(), fault)
        if ground is not None:
            self.loop.receive_ground_acceleration(self.samples[-1].stamp, ground)

    def drive(self, forces, ground=None) -> np.ndarray:
        """Answer sample after sample with these forces; returns the commands in force until each sample."""
        commands = []
        for k, force in enumerate(forces):
            commands.append(self.step().command[0])
            self.answer(force, None if ground is None else ground[k])
        return np.array(commands)


@pytest.fixture
def bench(rig) -> Bench:
    return Bench(rig)


def test_a_command_from_sample_k_is_in_force_until_sample_k_plus_2(bench):
    commands = bench.drive([100.0 * k for k in range(20)])
    np.testing.assert_array_equal(commands[2:], [100.0 * k for k in range(18)])
    np.testing.assert_array_equal(commands[:2], 0)


def test_readings_are_the_rigs_exact_motion_within_the_sensors_noise(rig, bench):
    random = np.random.default_rng(3)
    forces, ground = random.normal(0, 500, 800), random.normal(0, 0.03, 800)
    bench.drive(forces, ground)
    inputs = np.column_stack([[0, *ground[:-1]], [0, *forces[:-1]]])
    exact = np.column_stack([simulate(rig.discrete_model(), inputs), inputs[:, 0]])
    exact = exact[:, [*rig.measured_outputs, -1]]
    noise = np.array([channel.noise + channel.range / 2**channel.bits for channel in rig.channel_sensors])
    assert (np.abs(np.array([sample.reading for sample in bench.samples]) - exact) < 6 * noise).all()


def test_an_answer_says_which_sample_it_answers(bench):
    bench.step()
    assert not bench.loop.has_answer(COMMAND)
    bench.answer(1.0)
    assert bench.loop.has_answer(COMMAND)
    assert not bench.loop.has_answer(GROUND)
    bench.step()
    assert not bench.loop.has_answer(COMMAND)


def test_old_and_future_answers_and_those_of_another_run_are_counted_and_do_not_act(bench):
    bench.drive([0.0] * 5)
    for run, sequence in ((RUN, 99), (RUN, 2), (RUN - 1, bench.loop.sequence)):
        bench.loop.receive_command(run, sequence, [1000.0], "")
    bench.loop.receive_ground_acceleration(123, 1.0)
    assert not bench.drive([None] * 4).any()
    assert bench.loop.counters()["late_commands"] >= 2
    assert bench.loop.counters()["answers_to_unknown_samples"] == 2
    assert not bench.safety.cause


@pytest.mark.parametrize(
    ("bad", "cause"),
    [
        ([float("nan")], "command [nan], expected finite numbers"),
        ([float("inf")], "command [inf], expected finite numbers"),
        ([1.0, 2.0], "command of shape (2,), expected (1,)"),
        ([], "command of shape (0,), expected (1,)"),
    ],
)
def test_a_bad_command_stops_braces_and_table_and_every_sample_says_so(bench, bad, cause):
    bench.drive([2000.0] * 20, [0.3] * 20)
    bench.step()
    bench.loop.receive_command(RUN, bench.loop.sequence, bad, "")
    bench.drive([2000.0] * 1600, [0.3] * 1600)
    states = [sample.head.state for sample in bench.samples]
    assert states[:21] == [State.RUNNING] * 21
    assert states[21:] == sorted(states[21:])
    assert set(states[21:]) == {State.RAMPING_DOWN, State.LATCHED}
    assert {sample.cause for sample in bench.samples[21:]} == {cause}
    last = bench.samples[-1]
    assert not any(last.command)
    assert abs(last.reading[-1]) < 0.01
    assert abs(bench.safety.outputs[1].state.velocity) < 1e-9


def test_two_answers_to_a_sample_are_a_fault(bench):
    bench.step()
    bench.answer(1.0)
    bench.answer(1.0)
    assert "expected one sender" in bench.safety.cause


@pytest.mark.parametrize("late", [False, True])
def test_a_sample_that_was_said_again_may_be_answered_again_with_the_same(bench, late):
    bench.step()
    bench.loop.say_again()
    first = bench.loop.sequence
    for _ in range(3):
        bench.answer(1.0, 0.01)
    if late:  # the answer to what was said before has come after all, and the next one, too
        bench.drive([2.0] * 3, [0.0] * 3)
        bench.loop.receive_command(RUN, first, [1.0], "")
        bench.loop.receive_ground_acceleration(bench.samples[0].stamp, 0.01)
    assert not bench.safety.cause
    assert bench.loop.missed_deadlines == 0
    if late:
        assert bench.loop.moving() == "brace_command still requests 2, expected every input at rest first"
    bench.answer(3.0)
    assert f"two messages on brace_command answer sample {bench.loop.sequence}" in bench.safety.cause


def test_another_answer_to_a_sample_that_was_said_again_is_a_second_sender(bench):
    bench.step()
    bench.loop.say_again()
    bench.answer(ground=0.01)
    bench.answer(ground=0.02)
    assert "two messages on ground_motion answer sample" in bench.safety.cause


def test_equal_answers_to_the_sample_after_the_one_said_again_are_two_senders(bench):
    bench.step()
    bench.loop.say_again()
    bench.drive([1.0])
    bench.answer(1.0)
    assert "two messages on brace_command answer sample" in bench.safety.cause


def test_a_fault_of_the_sender_is_one_of_the_rig(bench):
    bench.drive([2000.0] * 20)
    bench.step()
    bench.answer(2000.0, fault="7 samples lost")
    bench.step()
    assert bench.samples[-1].cause == "brace_command: its sender reports: 7 samples lost"
    assert bench.samples[-1].head.state == State.RAMPING_DOWN


def test_a_command_that_stays_away_is_a_fault_and_the_force_ends_smoothly(bench):
    bench.drive([8000.0] * 30)
    commands = bench.drive([None] * round((TIMEOUT + RAMP_TIME) * 500 + 5))
    assert "no brace_command" in bench.safety.cause
    assert commands[-1] == 0
    assert np.abs(np.diff(commands)).max() < 8000.0 * np.pi / 2 / (RAMP_TIME * 500) * 1.02


def test_a_zero_command_may_stay_away(bench):
    bench.drive([500.0] * 10 + [0.0] * 5 + [None] * 200)
    assert bench.safety.state is State.RUNNING


def test_a_ground_motion_that_stays_away_brings_table_and_braces_to_rest(bench):
    bench.drive([1000.0] * 30, [1.0] * 30)
    bench.drive([1000.0] * 1600)
    assert "no ground_motion" in bench.safety.cause
    assert not any(bench.samples[-1].command)
    assert abs(bench.samples[-1].reading[-1]) < 0.01


def test_a_ground_motion_that_stays_away_while_the_table_moves_at_a_steady_velocity_is_a_fault(bench):
    """The last acceleration of a sender that has ended may be exactly zero."""
    bench.drive([None] * 270, [1.2] * 250 + [1.2 * (1 - k / 10) for k in range(1, 11)] + [0.0] * 10)
    table = bench.safety.outputs[1]
    assert table.value == [0.0]
    assert table.state.velocity > 0.5
    bench.drive([None] * round(TIMEOUT * 500 + 2))
    assert "no ground_motion" in bench.safety.cause
    bench.drive([None] * 1500)
    assert abs(table.state.velocity) < 1e-9
    assert abs(table.state.displacement) < 0.25


def test_a_table_that_is_steered_out_of_its_stroke_is_stopped_within_it(bench):
    """At 0.77 m/s it needs 3 cm to stop: more than there is between the interlock's limit and the end."""
    bench.drive([None] * 1500, [1.4] * 275 + [0.0] * 1225)
    table = bench.safety.outputs[1]
    assert "interlocks.table_displacement" in bench.safety.cause
    assert abs(table.state.velocity) < 1e-9
    assert 0.24 < table.state.displacement < 0.25


def test_a_motion_of_the_table_right_after_a_clear_is_played_whole(bench):
    bench.safety.fault("test")
    bench.drive([0.0] * 500, [0.0] * 500)
    bench.safety.clear(bench.loop.moving())
    motion = np.sin(2 * np.pi * np.arange(250) / 250) - np.sin(4 * np.pi * np.arange(250) / 250) / 2
    bench.drive([0.0] * 260, [*motion, *[0.0] * 10])
    assert bench.safety.state is State.RUNNING
    assert abs(bench.safety.outputs[1].state.velocity) < 1e-9


def test_it_is_cleared_at_rest_alone_and_then_the_force_fades_in(bench):
    bench.drive([8000.0] * 10)
    bench.safety.fault("test")
    bench.drive([8000.0] * 100)
    with pytest.raises(AbraceError, match="still ramping down"):
        bench.safety.clear(bench.loop.moving())
    bench.drive([8000.0] * 300)
    with pytest.raises(AbraceError, match="brace_command still requests 8000, expected every input at rest first"):
        bench.safety.clear(bench.loop.moving())
    bench.answer(0.0, fault="latched")
    bench.drive([0.0] * 2)
    bench.step()
    bench.loop.receive_command(RUN, bench.loop.sequence, [0.0], "latched")
    with pytest.raises(AbraceError, match="its sender reports a fault: latched"):
        bench.safety.clear(bench.loop.moving())
    bench.drive([0.0] * 500)
    assert bench.safety.clear(bench.loop.moving()) == "test"
    force = bench.drive([8000.0] * 300)
    assert force[-1] == 8000.0
    assert np.abs(np.diff(force)).max() < 8000.0 * np.pi / 2 / (RAMP_TIME * 500) * 1.02


def test_a_sender_that_is_too_late_to_act_has_to_be_at_rest_all_the_same(bench):
    bench.drive([8000.0] * 10)
    bench.safety.fault("test")
    bench.drive([0.0] * 800)

    def answer_too_late(force: float, fault: str = "") -> None:
        for _ in range(3 * round(TIMEOUT * 500)):
            bench.step()
            bench.loop.receive_command(RUN, bench.loop.sequence - 12, [force], fault)

    answer_too_late(8000.0)
    assert bench.loop.moving() == "brace_command still requests 8000, expected every input at rest first"
    answer_too_late(0.0, "latched")
    assert bench.loop.moving().startswith("brace_command: its sender reports a fault: latched, expected")
    answer_too_late(0.0)
    assert not bench.loop.moving()
    bench.loop.receive_command(RUN - 1, 0, [500.0], "")
    bench.loop.receive_ground_acceleration(-1, 0.5)
    assert bench.loop.moving().startswith(
        "brace_command still requests 500; ground_motion still requests 0.5, expected"
    )


def reading(bench, missed=0, late=False) -> Reading:
    """The device's next one, that many samples late."""
    return bench.device.exchange([0.0], 0.0, Wanted.FOLLOW, 1)._replace(missed=missed, age=0.002 if late else 0.0019)


def test_a_rig_that_was_held_up_is_a_fault_and_its_samples_are_missing(bench):
    bench.drive([0.0] * 5)
    bench.loop.take(reading(bench, 1000, True))
    assert not bench.safety.cause, "while nothing acts it harms nobody"
    bench.drive([500.0] * 2)
    last = bench.loop.sequence
    assert bench.loop.take(reading(bench, LATE_LIMIT, True)).head.sequence == last + LATE_LIMIT + 1
    assert not bench.safety.cause
    assert bench.loop.take(reading(bench, LATE_LIMIT + 1, True)).head.flags == LATE | LOCKSTEP
    assert f"delayed: 11 samples missed before sample {last + 23}" in bench.safety.cause
    assert bench.loop.missed == 1021


def test_a_run_begins_with_its_first_sample_whatever_was_missed_before(rig):
    bench = Bench(rig, acts=False)
    assert bench.loop.take(reading(bench, 7)).head.sequence == 0
    assert bench.loop.take(reading(bench, 7)).head.sequence == 8
    assert bench.loop.missed == 7


def test_samples_that_a_device_did_not_give_are_missing(bench):
    last = bench.loop.sequence
    bench.loop.fail("no packet for 20 ms", 10)
    assert bench.safety.cause == "no packet for 20 ms"
    assert bench.loop.take(reading(bench)).head.sequence == last + 11
    assert bench.loop.missed == 10


def test_samples_that_are_late_in_a_row_are_a_fault(bench):
    bench.drive([500.0] * 3)
    for _ in range(3):
        for _ in range(LATE_LIMIT):
            bench.loop.take(reading(bench, 0, True))
        assert not bench.safety.cause
        bench.loop.take(reading(bench))
    for _ in range(LATE_LIMIT + 1):
        bench.loop.take(reading(bench, 0, True))
    assert "11 samples in a row were taken late" in bench.safety.cause


def test_the_last_sample_of_a_run_is_the_first_at_rest(bench):
    bench.drive([8000.0] * 30)
    bench.safety.deactivate()
    bench.loop.ending = True
    while not bench.loop.ended:
        bench.step()
        bench.answer(8000.0)
    heads = [sample.head for sample in bench.samples]
    assert [bool(head.flags & LAST) for head in heads] == [False] * (len(heads) - 1) + [True]
    assert heads[-1].state == State.STANDBY
    assert not any(bench.samples[-1].command)
    assert len(heads) - 30 == RAMP_TIME * 500 + 1


def test_what_was_limited_is_told(bench):
    bench.drive([1e5] * 10)
    assert bench.samples[-1].head.flags & SATURATED
    assert not bench.samples[0].head.flags & SATURATED


@settings(max_examples=20)
@given(
    forces=st.lists(st.one_of(st.none(), st.floats()), min_size=1, max_size=60),
    stop=st.integers(0, 60),
)
def test_the_force_is_finite_within_capacity_and_rate_whatever_comes(rig, forces, stop):
    bench = Bench(rig)
    for k, force in enumerate(forces):
        bench.drive([force])
        if k == stop:
            bench.safety.press("pressed by panel")
    commands = [sample.command[0] for sample in bench.samples]
    capacity, step = rig.capacity[0], rig.rate_limit[0] / rig.sample_rate
    assert np.isfinite([sample.reading for sample in bench.samples]).all()
    assert np.isfinite(commands).all()
    assert np.abs(commands).max() <= capacity
    assert np.abs(np.diff(commands, prepend=0.0)).max() <= step * (1 + 1e-12)


@pytest.mark.parametrize("ramped", [0, 80])
def test_after_a_delay_the_force_makes_no_step_beyond_the_rate_limit(rig, bench, ramped):
    bench.drive([20e3] * 20)
    if ramped:
        bench.safety.fault("planted")
        bench.drive([20e3] * ramped)
    before = bench.safety.outputs[0].value[0]
    bench.samples.append(bench.loop.take(reading(bench, missed=300)))
    (after,), *_ = bench.loop.act(301)
    step = rig.rate_limit[0] / rig.sample_rate
    assert before > 10e3
    assert before - after <= step * (1 + 1e-12)
    if not ramped:
        assert before - after < 20.0, "the ramp begins when the delay is noticed, not before"


@pytest.mark.parametrize("event", [RigSafety.deactivate, lambda safety: safety.press("pressed by x")])
def test_a_second_event_at_a_delay_does_not_shorten_the_ramp(bench, event):
    bench.drive([20e3] * 20)
    before = bench.safety.outputs[0].value[0]
    bench.loop.take(reading(bench, missed=300))
    event(bench.safety)
    (after,), *_ = bench.loop.act(301)
    assert bench.safety.state is State.RAMPING_DOWN
    assert 0.0 < before - after < 20.0, "the ramp begins when the delay is noticed, not before"


def test_a_channel_beyond_the_bits_of_a_message_stops_the_rig_at_the_end_of_its_range():
    rig = load_rig(Path(__file__).parents[2] / "src/abrace_plant/config/sac_la_20.yaml")
    safety = RigSafety()
    safety.configure(rig_outputs(rig), 1 / rig.sample_rate)
    safety.activate()
    safety.begin()
    loop = RigLoop(rig, None, safety, TIMEOUT, LATE_LIMIT, RUN, lockstep=True)
    values = np.zeros(len(rig.channel_names))
    values[85] = rig.channel_sensors[85].highest
    samples = [loop.take(Reading(values, 10_000_000 * k, 1 << 70, 0, STATUS)) for k in range(3)]
    assert "f6: at the end of its range" in samples[-1].cause
    assert loop.clipped["w"] == loop.clipped["f6"] == 3
    assert [sample.head.clipped for sample in samples] == [0, 0, 0]


def test_a_rig_by_the_clock_for_which_nobody_looks_for_stops_is_stopped(rig):
    bench, limit = Bench(rig, lockstep=False), round(LONGEST_WITHOUT_STOPS * rig.sample_rate)
    for _ in range(3):
        bench.drive(np.full(limit, 1000.0))
        bench.loop.note_stops_polled()
    assert bench.samples[-1].head.state == State.RUNNING, bench.samples[-1].cause
    bench.drive(np.full(limit, 1000.0))
    assert not bench.samples[-1].cause
    bench.drive([1000.0, 1000.0])
    assert bench.samples[-1].cause.startswith("stop buttons not polled for 0.5 s")
    assert bench.samples[-1].head.state == State.RAMPING_DOWN


def test_in_lockstep_nobody_needs_to_poll_the_stops_by_the_clock(rig, bench):
    bench.drive(np.full(5 * round(LONGEST_WITHOUT_STOPS * rig.sample_rate), 1000.0))
    assert not bench.samples[-1].cause


def test_the_interlocks_keep_the_interpreter(rig, bench):
    """Each time that they let it go, a second thread that is busy would delay the sample; np.dot does it."""
    bench.step()
    values = np.zeros(len(rig.channel_names))
    assert yields(lambda: bench.loop.interlocks.check(values, (0.0,), 0.0, 0.0, 0), 5000) == 0


def test_a_device_that_gives_another_number_of_values_is_named_and_ends_the_run(bench, monkeypatch):
    """In lockstep by its error; by the clock the device is made safe and closed, and the error is the run's."""
    given, closed = bench.device.exchange, []
    monkeypatch.setattr(bench.device, "exchange", lambda *_: given(*_)._replace(values=np.zeros(3)), raising=False)
    monkeypatch.setattr(bench.device, "close", lambda: closed.append(True), raising=False)
    message = "simulatedrig: 3 values, expected 10: x1, x2, x3, xf, a1, a2, a3, fa, fb, w"
    with pytest.raises(AbraceError, match=message):
        bench.step()
    run = RealTimeRun(
        bench.loop, bench.device, 0.002, threading.RLock(), bench.samples.append, lambda: None, lambda: None
    )
    run.run()
    assert [str(error) for error in run.errors] == [message]
    assert (closed, bench.samples) == ([True], [])
