# SPDX-License-Identifier: Apache-2.0
"""The loop of a rig, sample by sample and without ROS: checks inputs, exchanges samples with the device, finds faults.

Sample k uses the answers to sample k-1: the command acts from t_k on, and the ground has the commanded acceleration at
t_k. These are faults, after which table and braces come to rest together: an input that is missing while its force or
table acts, two commands for one sample, a value that is not finite, a sender's own fault, samples that are late or
missed, stops that nobody looks for, a device that fails, and a tripped interlock.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, NamedTuple

from abrace_core.safety.command_guard import CommandGuard
from abrace_core.safety.rig_safety import RAMP_TIME, RigSafety
from abrace_core.safety.table_guard import TableGuard
from abrace_core.wire import LAST, LATE, LOCKSTEP, RATE_LIMITED, SATURATED, STOP_PRESSED, TABLE_LIMITED, Head
from abrace_plant.rig.interlocks import Interlocks
from abrace_plant.rig.over_range import OverRange

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_core.safety.rig_safety import Output
    from abrace_plant.devices.device import Device, Reading
    from abrace_plant.rig.model import Rig

COMMAND, GROUND = "brace_command", "ground_motion"
SLOW = 10
"""Late answers in a row after which a sender is slow."""
LONGEST_WITHOUT_STOPS = 0.5
"""Seconds by the clock in which somebody has to look for stops while something acts."""
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
        (channels,) [displacements, strokes, accelerations, forces, ground acceleration], as measured.
    command
        (groups,) [N], in effect until this sample.
    """

    stamp: int
    head: Head
    cause: str
    reading: list[float]
    command: list[float]


class _Input:
    """State of one input: the last answered sample, the answer that has not acted yet, and the last message."""

    def __init__(self, name: str, timeout: int) -> None:
        self.name = name
        self.timeout = timeout
        self.pending: Sequence[float] | None = None
        self.last: Sequence[float] = ()
        self.fault = ""
        self.answered = self.heard = -1
        self.late = self.late_in_a_row = 0

    def receive(self, sequence: int, value: Sequence[float], now: int) -> str:
        """Accept an answer to sample `sequence` after sample `now`; returns why it is a fault, or nothing.

        One that is later than the time-out does not act.
        """
        self.hear(value, now)
        late = sequence != now
        self.late_in_a_row = self.late_in_a_row + 1 if late else 0
        if sequence > now or sequence < max(self.answered, now - self.timeout):
            self.late += 1
            return ""
        if sequence == self.answered:
            return f"two messages on {self.name} answer sample {sequence}, expected one sender"
        self.late += late
        self.answered = sequence
        self.pending = value
        return ""

    def hear(self, value: Sequence[float], now: int) -> None:
        """Note a message, even if it answers no sample, after sample `now`."""
        self.heard, self.last = now, value

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
        return now - self.answered > self.timeout

    def moving(self, now: int) -> str:
        """Why the input is not at rest, even if its answers are too late to act; empty: it is at rest."""
        if now - self.heard > self.timeout:
            return ""
        if self.fault:
            return f"{self.name}: its sender reports a fault: {self.fault}"
        if any(self.last):
            return f"{self.name} still requests {', '.join(f'{value:g}' for value in self.last)}"
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
    clipped
        By channel, readings so far at an end of its range.
    ending
        Set to end the run, with the first sample at which all is at rest.
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
        self.interlocks = Interlocks(rig)
        self._over_range = OverRange(rig.channel_sensors)
        self._names = rig.channel_names
        self.clipped = dict.fromkeys(self._names, 0)
        self._watched = safety.acting
        self._inputs = {COMMAND: _Input(COMMAND, timeout), GROUND: _Input(GROUND, timeout)}
        self._stamps: deque[tuple[int, int]] = deque(maxlen=timeout + 1)
        self._late_limit = late_limit
        self._late_in_a_row = 0
        self._unwatched_limit = math.inf if lockstep else round(LONGEST_WITHOUT_STOPS * rig.sample_rate)
        self._stops_at = 0
        self._until_now = self._braces.value
        self._flags = LOCKSTEP if lockstep else 0
        self.run = run
        self.sequence = -1
        self.late = self.missed = self.old = 0
        self.ending = self.ended = False

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
        sequence = next((number for known, number in reversed(self._stamps) if known == stamp), -1)
        if sequence < 0:
            self.old += 1
            self._inputs[GROUND].hear([acceleration], self.sequence)
        elif problem := self._inputs[GROUND].receive(sequence, [acceleration], self.sequence):
            self._safety.fault(problem)

    def answered(self, name: str) -> bool:
        """Whether the last sample has been answered on the topic `name`: `brace_command` or `ground_motion`."""
        return self._inputs[name].answered == self.sequence

    def all_answered(self) -> bool:
        """Whether everyone who answers has answered the last sample."""
        now = self.sequence
        return all(one.answered == now for one in self._inputs.values() if not one.silent(now))

    def slow_sender(self) -> bool:
        """Whether there is someone whose last answers were all late."""
        return any(one.slow for one in self._inputs.values())

    def quick_answered(self) -> bool:
        """Whether everyone has answered the last sample but those whose last answers were all late."""
        now = self.sequence
        return all(one.answered == now for one in self._inputs.values() if not (one.slow or one.silent(now)))

    def moving(self) -> str:
        """Which input is not at rest, and why; empty: all are."""
        return "; ".join(filter(None, (one.moving(self.sequence) for one in self._inputs.values())))

    def act(self, samples: int = 1) -> tuple[list[float], float]:
        """Force (groups,) [N] and table acceleration [m/s^2] that act from the next sample on.

        `samples`: sample periods since the last call.
        """
        self._until_now = self._braces.value
        if self._safety.acting:
            for given, output in zip(self._inputs.values(), self._safety.outputs, strict=True):
                if output.moving and given.silent(self.sequence):
                    self._safety.fault(f"no {given.name} for {self.sequence - given.answered} samples")
        self._safety.act([given.take() for given in self._inputs.values()], samples)
        return self._braces.value, self._table.value[0]

    def repeat(self) -> None:
        """Note that the last commands are sent once more."""
        self._braces.repeat()

    def take(self, reading: Reading) -> Sample:
        """The sample that the device has given as a `reading`."""
        missed = reading.missed if self.sequence >= 0 else 0  # what was before the first sample is not of this run
        self.sequence += 1 + missed
        self._stamps.append((reading.stamp, self.sequence))
        self.missed += missed
        self._braces.on_the_way = reading.on_the_way
        late = reading.age >= self._period
        self.late += late
        self._late_in_a_row = self._late_in_a_row + 1 if late else 0
        clipped = reading.clipped | self._over_range.check(reading.values)
        if clipped:
            for i, name in enumerate(self._names):
                self.clipped[name] += clipped >> i & 1
        self._look_at(reading, clipped)
        if any(output.moving for output in self._safety.outputs):
            self._look_for_delays(missed)
        return self._sample(reading, clipped)

    def _look_at(self, reading: Reading, clipped: int) -> None:
        """Check the interlocks; a trip stops the rig, and can occur again after a person has cleared it."""
        safety, table = self._safety, self._table
        if safety.acting and not self._watched:
            self.interlocks.reset()
        self._watched = safety.acting
        velocity = table.state.velocity
        trip = self.interlocks.check(reading.values, self._until_now, velocity, table.turning_point, clipped)
        if trip is not None and safety.acting:
            safety.fault(str(trip))

    def stops_looked_for(self) -> None:
        """Note that somebody has looked for stops: where nobody does, they would not be heard."""
        self._stops_at = self.sequence

    def _look_for_delays(self, missed: int) -> None:
        """A delayed loop is a fault while something acts; so is a thread that should have looked for stops."""
        if missed > self._late_limit:
            self._safety.fault(f"the rig's loop was delayed: {missed} samples missed before sample {self.sequence}")
        elif self._late_in_a_row > self._late_limit:
            self._safety.fault(f"{self._late_in_a_row} samples in a row were taken late, up to sample {self.sequence}")
        elif self._safety.acting and self.sequence - self._stops_at > self._unwatched_limit:
            self._safety.fault(
                f"no look at the stop buttons for {LONGEST_WITHOUT_STOPS:g} s: other programs keep this node's second "
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
        if self.ending and safety.at_rest and not any(self._until_now):
            flags |= LAST
            self.ended = True
        head = Head(self.sequence, self.run, clipped & MESSAGE_BITS, flags, safety.state)
        return Sample(reading.stamp, head, safety.cause, reading.values.tolist(), self._until_now)

    def step(self) -> Sample:
        """Take the next sample at once."""
        return self.take(self._device.exchange(*self.act()))

    def fail(self, problem: str, samples: int) -> None:
        """The device has given none of so many `samples`, because of a `problem`."""
        self.sequence += samples
        self.missed += samples
        self._braces.on_the_way = 0
        self._safety.fault(problem)
        self.ended = self.ending and self._safety.at_rest

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
