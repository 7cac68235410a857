# SPDX-License-Identifier: Apache-2.0
"""The loop of a rig, sample by sample and without ROS: checks inputs, exchanges samples with the device, finds faults.

Sample k uses the answers to sample k-1: the command acts from t_k on, and the ground has the commanded acceleration at
t_k. Commands act when the target has taken a new arm number, and as long as it says that it follows with this number.

These are faults, after which table and braces come to rest together: an input that is missing while its force or table
acts, two commands for one sample, a value that is not finite, a sender's own fault, samples that are late or missed,
stop buttons that are not polled, a device that fails or whose ticks are not those of the rig file, a target that does
not follow, and a tripped interlock. Rest is what load cells and table show, not what is commanded.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from abrace_core.safety.command_guard import CommandGuard
from abrace_core.safety.rig_safety import NOT_MEASURED, RAMP_TIME, RigSafety, State
from abrace_core.safety.table_guard import TableGuard
from abrace_core.safety.wire import LAST, LATE, LOCKSTEP, RATE_LIMITED, SATURATED, STOP_PRESSED, TABLE_LIMITED, Head
from abrace_plant.devices.device import Wanted, exchange
from abrace_plant.live.rest import RestCheck
from abrace_plant.live.ticks import Ticks
from abrace_plant.rig.interlocks import Interlocks
from abrace_plant.rig.sensors import OverRange
from abrace_plant.rig.table_file import NOT_DRIVEN

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_core.safety.rig_safety import Output
    from abrace_plant.devices.device import Device, Reading, TargetStatus
    from abrace_plant.rig.model import Rig

COMMAND, GROUND = "brace_command", "ground_motion"
SLOW = 10
"""Late answers in a row after which a sender is slow."""
LONGEST_WITHOUT_STOPS = 0.5
"""Seconds by the clock within which the stop buttons have to be polled while something acts."""
TO_THE_MIDDLE = "move it to the middle, deactivate, cleanup, configure"
ARMING_TIME = 0.2
"""Seconds within which a target has to take a new arm number."""
MESSAGE_BITS = 2**64 - 1
"""Channels of which a message says whether they are at the end of their range: the first 64. Interlocks watch all."""


class Sample(NamedTuple):
    """The content of one Response.

    Parameters
    ----------
    stamp
        Sampling instant [ns].
    head
        What it says of the rig.
    cause
        Of the fault or stop; empty: none.
    reading
        (channels,) as measured, in the order of `Rig.channel_names`.
    command
        (groups,) [N], in effect until this sample.
    table
        Displacement of the table [m]: measured, or as commanded; NaN: unknown.
    """

    stamp: int
    head: Head
    cause: str
    reading: list[float]
    command: list[float]
    table: float


class _Input:
    """State of one input: the last answered sample, the answer that has not acted yet, and the last message."""

    def __init__(self, name: str, timeout: int) -> None:
        self.name = name
        self.timeout = timeout
        self.pending: Sequence[float] | None = None
        self.last_value: Sequence[float] = ()
        self.fault = ""
        self.last_answered = self.last_heard = self.said_again = -1
        self.late = self.late_in_a_row = 0

    def receive(self, sequence: int, value: Sequence[float], now: int) -> str:
        """Accept an answer to sample `sequence` after sample `now`; returns why it is a fault, or nothing.

        One that is later than the time-out does not act. A sample that was said again may be answered again.
        """
        if sequence == self.said_again and (
            sequence < self.last_answered or (sequence == self.last_answered and value == self.last_value)
        ):
            return ""
        self.hear(value, now)
        late = sequence != now
        self.late_in_a_row = self.late_in_a_row + 1 if late else 0
        if sequence > now or sequence < max(self.last_answered, now - self.timeout):
            self.late += 1
            return ""
        if sequence == self.last_answered:
            return f"two messages on {self.name} answer sample {sequence}, expected one sender"
        self.late += late
        self.last_answered = sequence
        self.pending = value
        return ""

    def hear(self, value: Sequence[float], now: int) -> None:
        """Note a message, even if it answers no sample, after sample `now`."""
        self.last_heard, self.last_value = now, value

    def take(self) -> Sequence[float] | None:
        """The answer that has not acted yet."""
        pending, self.pending = self.pending, None
        return pending

    @property
    def slow(self) -> bool:
        """Whether the last answers were all late."""
        return self.late_in_a_row >= SLOW

    def silent(self, now: int) -> bool:
        """Whether the last answer is older than the time-out."""
        return now - self.last_answered > self.timeout

    def moving(self, now: int) -> str:
        """Why the input is not at rest, even if its answers are too late to act; empty: it is at rest."""
        if now - self.last_heard > self.timeout:
            return ""
        if self.fault:
            return f"{self.name}: its sender reports a fault: {self.fault}"
        if any(self.last_value):
            return f"{self.name} still requests {', '.join(f'{value:g}' for value in self.last_value)}"
        return ""


def rig_outputs(rig: Rig) -> list[Output]:
    """What acts on a rig: the forces of its braces, and its table."""
    period = 1 / rig.sample_rate
    return [CommandGuard(rig.capacity, rig.rate_limit, period, RAMP_TIME), TableGuard(rig.table, period)]


class RigLoop:
    """One run of a rig.

    Parameters
    ----------
    rig
        The rig.
    device
        Its hardware.
    safety
        Of the rig, with its outputs.
    command_timeout
        Seconds without a command while the force is not zero, or without a ground acceleration while the table moves,
        that are no fault yet.
    late_limit
        Samples in a row that may be late or missed while something acts.
    run
        Number of the run.
    lockstep
        Whether samples are taken as soon as all have answered.

    Attributes
    ----------
    sequence
        Number of the last sample; -1: none yet.
    late, missed
        Samples so far that were taken late, and that were missed.
    interlocks
        Of the rig.
    ticks
        Of the device, as they are judged.
    clipped
        By channel, readings so far at an end of its range.
    ending
        Set to end the run, with the first sample at which all is at rest, after a fault or stop as measured.
    give_up
        Set to end it after the ramp even if a force is still measured, or not yet.
    began
        Number of the first sample after the arming and the fade, or after a fault meanwhile; -1: none yet.
    ended
        Whether that sample has been taken.
    """

    def __init__(
        self,
        rig: Rig,
        device: Device,
        safety: RigSafety,
        command_timeout: float,
        late_limit: int,
        run: int,
        lockstep: bool,
    ) -> None:
        timeout = max(1, round(command_timeout * rig.sample_rate))
        self._period = 1 / rig.sample_rate
        self._device, self._safety = device, safety
        braces, table = safety.outputs
        assert isinstance(braces, CommandGuard)
        assert isinstance(table, TableGuard)
        self._braces, self._table = braces, table
        self._table_driven = rig.table_driven
        self.interlocks = Interlocks(rig)
        self.ticks = Ticks(rig.sample_rate)
        self._rest = RestCheck(rig, self.interlocks.table.get("force_error"))
        self._over_range = OverRange(rig.channel_sensors)
        self._names, self._bits = rig.channel_names, rig.bits_in_message
        self.clipped = dict.fromkeys(self._names, 0)
        self._watched = safety.acting
        self._inputs = {COMMAND: _Input(COMMAND, timeout), GROUND: _Input(GROUND, timeout)}
        self._stamps: deque[tuple[int, int]] = deque(maxlen=timeout + 1)
        self._target: TargetStatus | None = None
        self._arm = 0
        self._asked_since: int | None = None
        self._longest_arming = round(ARMING_TIME * rig.sample_rate)
        self._late_limit = late_limit
        self._late_in_a_row = 0
        self._unwatched_limit = math.inf if lockstep else round(LONGEST_WITHOUT_STOPS * rig.sample_rate)
        self._stops_polled_at = 0
        self._until_now = self._braces.value
        self._flags = LOCKSTEP if lockstep else 0
        self.run = run
        self.sequence = self.began = -1
        self.late = self.missed = self.old = 0
        self.ending = self.give_up = self.ended = False

    def receive_command(self, run: int, sequence: int, force: Sequence[float], fault: str) -> None:
        """Accept a BraceCommand: `force` (groups,) [N] answers sample `sequence` of a `run`; `fault`: its sender's."""
        given = self._inputs[COMMAND]
        if run != self.run:
            self.old += 1
            given.hear(force, self.sequence)
            return
        if problem := given.receive(sequence, force, self.sequence):
            self._safety.fault(problem)
        given.fault = fault
        if fault and self._safety.acting:
            self._safety.fault(f"{COMMAND}: its sender reports: {fault}")

    def receive_ground_acceleration(self, stamp: int, acceleration: float) -> None:
        """Accept a ground `acceleration` [m/s^2] in answer to the sample with this stamp [ns]."""
        if not self._table_driven:
            self._safety.fault(f"{GROUND}: {NOT_DRIVEN}")
        sequence = next((number for known, number in reversed(self._stamps) if known == stamp), -1)
        if sequence < 0:
            self.old += 1
            self._inputs[GROUND].hear([acceleration], self.sequence)
        elif problem := self._inputs[GROUND].receive(sequence, [acceleration], self.sequence):
            self._safety.fault(problem)

    def say_again(self) -> None:
        """Note that the last sample is published once more: an equal answer is then none of a second sender."""
        for given in self._inputs.values():
            given.said_again = self.sequence

    def has_answer(self, name: str) -> bool:
        """Whether the last sample has been answered on the topic `name`: `brace_command` or `ground_motion`."""
        return self._inputs[name].last_answered == self.sequence

    def has_all_answers(self) -> bool:
        """Whether everyone who answers has answered the last sample."""
        now = self.sequence
        return all(one.last_answered == now for one in self._inputs.values() if not one.silent(now))

    def slow_sender(self) -> bool:
        """Whether there is someone whose last answers were all late."""
        return any(one.slow for one in self._inputs.values())

    def has_quick_answers(self) -> bool:
        """Whether everyone has answered the last sample but those whose last answers were all late."""
        now = self.sequence
        return all(one.last_answered == now for one in self._inputs.values() if not (one.slow or one.silent(now)))

    @property
    def settles(self) -> bool:
        """Whether nothing is armed yet, because the device's ticks have not been judged for long enough."""
        return self.ticks.begins and self._safety.state is State.ARMING

    def moving(self) -> str:
        """Why commands may not act; empty: they may.

        The device's ticks are wrong, an input is not at rest, the table may be anywhere or stands where its interlock
        would trip at once, or rest has not been measured since the last fault or stop.
        """
        if self.ticks.problem:
            return self.ticks.problem
        if moving := "; ".join(filter(None, (one.moving(self.sequence) for one in self._inputs.values()))):
            return f"{moving}, expected every input at rest first"
        if self._table.lost and (self._target is None or self._target.table is None):
            return f"position of the table unknown, the device or its target stopped while it moved: {TO_THE_MIDDLE}"
        place, limit = self._table_place, self.interlocks.table.get("table_displacement")
        if self._table_driven and limit and limit.action == "stop" and not abs(place) <= limit.value:
            return (
                f"table {place:.3g} m from its middle, limit {limit.value:g} (interlocks.table_displacement): "
                f"{TO_THE_MIDDLE}"
            )
        if not (self._rest_known or self._safety.measured):
            seconds = self._rest.remaining * self._period
            return f"{NOT_MEASURED}{seconds:.2f} s of force still to be measured"
        return ""

    def act(self, samples: int = 1) -> tuple[list[float], float, Wanted, int]:
        """Force (groups,) [N] and table acceleration [m/s^2] from the next sample on, what is wanted, the arm number.

        `samples`: sample periods since the last call.
        """
        self._until_now = self._braces.value
        if self._safety.acting:
            for given, output in zip(self._inputs.values(), self._safety.outputs, strict=True):
                if output.moving and given.silent(self.sequence):
                    self._safety.fault(f"no {given.name} for {self.sequence - given.last_answered} samples")
        self._safety.act([given.take() for given in self._inputs.values()], samples)
        return self._braces.value, self._table.value[0], *self._wanted()

    def _wanted(self) -> tuple[Wanted, int]:
        """What is wanted of the target, and the arm number; 0: it is void."""
        if self._safety.state is State.ARMING and self._target is not None:
            if problem := self.moving():
                self._safety.fault(problem)  # before the target has power
            elif not self.settles:
                if self._asked_since is None:
                    self._asked_since = self.sequence
                self._arm = self._target.last_arm % (2**32 - 1) + 1  # 0 is none
                return Wanted.HOLD_ZERO, self._arm
        self._asked_since = None
        if self._safety.at_rest or self._safety.state is State.NOT_AT_REST:
            self._arm = 0
        return (Wanted.FOLLOW if self._arm else Wanted.SAFE), self._arm

    def _check_target(self, target: TargetStatus) -> None:
        """Begin to act when the target is armed; one that is armed no longer is a fault, and the arm number is void."""
        self._target = target
        if self._asked_since is not None:
            if target.armed == self._arm:
                self._asked_since = None
                if target.table is not None and self._table_driven:
                    self._table.place(target.table)
                self._safety.begin(self.moving())
            elif self.sequence - self._asked_since > self._longest_arming:
                self._safety.fault(f"target not armed within {ARMING_TIME:g} s: {target.cause or 'no cause given'}")
        elif self._arm and target.armed != self._arm:
            self._arm = 0
            self._table.lost |= self._table.moving  # it comes to rest in the target's own way
            if self._safety.acting:
                self._safety.fault(f"target not following: {target.cause or 'no cause given'}")

    def repeat(self) -> None:
        """Note that the last commands are sent once more."""
        self._braces.repeat()

    def take(self, reading: Reading, clocks: tuple[int, int] | None = None) -> Sample:
        """The sample that the device has given as a `reading`.

        `clocks`: this computer's monotonic and wall clock [ns] in a run by the clock.
        """
        missed = reading.missed if self.sequence >= 0 else 0  # what was before the first sample is not of this run
        self.sequence += 1 + missed
        self._stamps.append((reading.stamp, self.sequence))
        self.missed += missed
        self.ticks.take(self.sequence, int(reading.stamp), clocks, reading.age)
        if self.ticks.problem and self._safety.acting:
            self._safety.fault(self.ticks.problem)
        self._check_target(reading.target)
        self._braces.commands_in_flight = reading.commands_in_flight
        late = reading.age >= self._period
        self.late += late
        self._late_in_a_row = self._late_in_a_row + 1 if late else 0
        clipped = reading.clipped | self._over_range.check(reading.values)
        if clipped:
            for i, name in enumerate(self._names):
                self.clipped[name] += clipped >> i & 1
        acted = self._safety.acting
        # before the interlocks: readings jump where samples are missed
        if any(output.moving for output in self._safety.outputs):
            self._check_delays(missed)
        self._check_interlocks(reading, clipped)
        if acted or self._safety.acting:
            self._rest.begin()  # nor do samples that were missed before a stop measure rest
        else:
            self._safety.look(self._rest.problem(reading, any(self._until_now)), 1 + missed)
        return self._sample(reading, clipped)

    def _check_interlocks(self, reading: Reading, clipped: int) -> None:
        """Check the interlocks; a trip stops the rig, and can occur again after a person has cleared it."""
        safety, table = self._safety, self._table
        if safety.acting and not self._watched:
            self.interlocks.reset()
        self._watched = safety.acting
        velocity = table.state.velocity
        trip = self.interlocks.check(reading.values, self._until_now, velocity, table.turning_point, clipped)
        if trip is not None and safety.acting:
            safety.fault(str(trip))

    def note_stops_polled(self) -> None:
        """Note that the stop buttons have been polled: without that no stop would be heard."""
        self._stops_polled_at = self.sequence

    def _check_delays(self, missed: int) -> None:
        """A delayed loop is a fault while something acts; so is a thread that should have looked for stops."""
        if missed > self._late_limit:
            self._safety.fault(f"the rig's loop was delayed: {missed} samples missed before sample {self.sequence}")
        elif self._late_in_a_row > self._late_limit:
            self._safety.fault(f"{self._late_in_a_row} samples in a row were taken late, up to sample {self.sequence}")
        elif self._safety.acting and self.sequence - self._stops_polled_at > self._unwatched_limit:
            self._safety.fault(
                f"stop buttons not polled for {LONGEST_WITHOUT_STOPS:g} s: other programs keep this node's second "
                "thread from running"
            )

    def _sample(self, reading: Reading, clipped: int) -> Sample:
        safety, flags = self._safety, self._flags
        if self._braces.saturated:
            flags |= SATURATED
        if self._braces.rate_limited:
            flags |= RATE_LIMITED
        if self._table.limited:
            flags |= TABLE_LIMITED
        if safety.pressed:
            flags |= STOP_PRESSED
        if self._late_in_a_row:
            flags |= LATE
        if self.began < 0 and safety.state not in (State.ARMING, State.FADING_IN):
            self.began = self.sequence
        if self._is_over and not any(self._until_now):
            flags |= LAST
            self.ended = True
        bits = self._bits(clipped) & MESSAGE_BITS if clipped else 0
        head = Head(self.sequence, self.run, bits, flags, safety.state)
        return Sample(reading.stamp, head, safety.cause, reading.values.tolist(), self._until_now, self._table_place)

    @property
    def _table_place(self) -> float:
        if self._target is not None and self._target.table is not None:
            return self._target.table
        return math.nan if self._table.lost or not self._table_driven else self._table.state.displacement

    @property
    def _rest_known(self) -> bool:
        """Whether rest has been measured since the last fault or stop."""
        return not self._safety.cause or not (self._rest.remaining or self._safety.measured)

    @property
    def _is_over(self) -> bool:
        if self.give_up:
            return self.ending and (self._safety.at_rest or self._safety.state is State.NOT_AT_REST)
        return self.ending and self._safety.at_rest and self._rest_known

    def exchange(self, force: list[float], table: float, wanted: Wanted, arm: int) -> Reading:
        """Send what `act` gave, `force`, `table`, `wanted` and `arm`, and wait for the reading, which is checked."""
        return exchange(self._device, self._names, force, table, wanted, arm)

    def step(self) -> Sample:
        """Take the next sample at once."""
        return self.take(self.exchange(*self.act()))

    def until_it_acts(self) -> Sample:
        """Take samples without an input until commands act in full; returns the first one at which they do."""
        while True:
            sample = self.step()
            if self.began >= 0:
                return sample

    def fail(self, problem: str, samples: int) -> None:
        """The device has given none of so many `samples`, because of a `problem`."""
        self.sequence += samples
        self.missed += samples
        self.ticks.restart()
        self._braces.commands_in_flight = 0
        self._table.lost |= self._table.moving
        self._safety.fault(problem)
        self._safety.look("no samples of the device", samples)
        self.ended = self._is_over

    @property
    def missed_deadlines(self) -> int:
        """Answers so far that came too late to act from the next sample on."""
        return sum(one.late for one in self._inputs.values())

    def counters(self) -> dict[str, int]:
        """Counts of limited, late and missed samples and inputs so far."""
        return {
            "saturations": self._braces.saturations,
            "rate_limits": self._braces.rate_limits,
            "table_limits": self._table.limits,
            "late": self.late,
            "missed": self.missed,
            "late_commands": self._inputs[COMMAND].late,
            "late_ground_motion": self._inputs[GROUND].late,
            "answers_to_unknown_samples": self.old,
        }
