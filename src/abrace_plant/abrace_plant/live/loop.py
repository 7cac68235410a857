"""The rig sample by sample: inputs checked, motion stepped, sensors read. What the `plant` node runs, without ROS.

At sample k the rig takes what answered sample k-1: the command acts from t_k on and the ground has that acceleration at
t_k. Then it reads its sensors. A command that stays away while force is on, two commands for one sample, a value that
is not finite or an emergency stop are faults: the guard takes the force smoothly to zero and keeps it there until a
person clears the fault.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import signals
from abrace_core.safety.command_guard import CommandGuard
from abrace_plant.rig.motion import RigMotion
from abrace_plant.rig.sensors import Measurement, parse_fault

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_plant.rig.model import Rig

RAMP_TIME = 0.5
"""Seconds within which a fault brings force and ground motion to zero."""

COMMAND, GROUND = "brace_command", "ground_motion"


@dataclass(frozen=True)
class Sample:
    """What one Response carries.

    Parameters
    ----------
    sequence
        Sample number.
    reading
        (channels,) [displacements, strokes, accelerations, forces, ground acceleration], as measured.
    command
        (groups,) [N], in force until this sample.
    """

    sequence: int
    reading: NDArray[np.float64]
    command: NDArray[np.float64]


class _Input:
    """One guarded input: its latest value and the sample that it answers."""

    def __init__(self, name: str, guard: CommandGuard, timeout_samples: int) -> None:
        self.name = name
        self.guard = guard
        self._timeout = timeout_samples
        self._pending: Sequence[float] | None = None
        self.value = guard.check(None)
        self.answered = -1
        self.late = 0

    def take(self, sequence: int, value: Sequence[float], now: int) -> None:
        """An answer to sample `sequence` while `now` is the last one taken; one that is overdue does not act."""
        if sequence > now or sequence < max(self.answered, now - self._timeout):
            self.late += 1
            return
        if sequence == self.answered:
            self.guard.fault(f"two messages on {self.name} answer sample {sequence}; one sender was expected")
            return
        if sequence < now:
            self.late += 1
        self.answered = sequence
        self._pending = value

    def advance(self, last: int) -> NDArray[np.float64]:
        """The value from the next sample on; `last` is the number of the sample before."""
        if last - self.answered > self._timeout and self.value.any():
            self.guard.fault(f"no {self.name} for {last - self.answered} samples")
        self.value = self.guard.check(self._pending)
        self._pending = None
        return self.value


class RigLoop:
    """A simulated rig between messages.

    Parameters
    ----------
    rig
        The rig.
    seed
        Of the sensor noise.
    command_timeout
        Seconds that a command or a ground acceleration may stay away while it is not zero.
    """

    def __init__(self, rig: Rig, seed: int, command_timeout: float) -> None:
        period = 1 / rig.sample_rate
        timeout = max(1, round(command_timeout * rig.sample_rate))
        limits = [rig.table.peak_acceleration], [rig.table.peak_jerk]
        self._motion = RigMotion(rig)
        self._channels = (*signals.response_names(rig.floors, rig.groups), signals.GROUND)
        self._period = period
        self._measurement = Measurement(rig.sensors.channels(rig.floors, rig.groups), seed, period)
        self._command = _Input(COMMAND, CommandGuard(rig.capacity, rig.rate_limit, period, RAMP_TIME), timeout)
        self._ground = _Input(GROUND, CommandGuard(*limits, period, RAMP_TIME), timeout)
        self._true = np.zeros(2 * rig.floors + 2 * rig.groups + 1)
        self.sequence = -1

    def take_command(self, sequence: int, force: Sequence[float]) -> None:
        """A BraceCommand has come: `force` (groups,) [N] answers sample `sequence`."""
        self._command.take(sequence, force, self.sequence)

    def take_ground_acceleration(self, sequence: int, acceleration: float) -> None:
        """A ground acceleration [m/s^2] has come, for the sample after `sequence`."""
        self._ground.take(sequence, [acceleration], self.sequence)

    def kill_sensors(self, faults: Sequence[str]) -> None:
        """These channels are dead and no others, each described as for `parse_fault`; a time counts from sample 0.

        Parameters
        ----------
        faults
            Such as `["a2=stuck", "x3=noise@20.0"]`.

        Raises
        ------
        AbraceError
            If one of them is none.
        """
        self._measurement.faults = tuple(parse_fault(text, self._channels, self._period) for text in faults)

    def answered(self, name: str) -> bool:
        """Whether the last sample has been answered on the topic `name`: `brace_command` or `ground_motion`."""
        return (self._command if name == COMMAND else self._ground).answered == self.sequence

    def fault(self, reason: str) -> None:
        """Force and ground motion to zero, latched with its `reason`."""
        self._command.guard.fault(reason)
        self._ground.guard.fault(reason)

    def clear_faults(self) -> None:
        """A person says that it is safe to go on."""
        self._command.guard.clear()
        self._ground.guard.clear()

    @property
    def fault_reason(self) -> str | None:
        """The latched fault, if any."""
        return self._command.guard.fault_reason or self._ground.guard.fault_reason

    def sample(self) -> Sample:
        """Take the inputs, step to the next sample and read the sensors."""
        until_now = self._command.value
        command = self._command.advance(self.sequence)
        ground = float(self._ground.advance(self.sequence)[0])
        self._true[:-1] = self._motion.outputs(ground, command)
        self._true[-1] = ground
        self.sequence += 1
        return Sample(self.sequence, self._measurement.read(self._true), until_now)

    def counters(self) -> dict[str, int]:
        """What has been cut or came late so far."""
        guard = self._command.guard
        return {
            "saturations": guard.saturations,
            "rate_limits": guard.rate_limits,
            "late_commands": self._command.late,
            "late_ground_motion": self._ground.late,
        }
