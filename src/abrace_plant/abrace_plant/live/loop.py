"""The rig sample by sample: inputs checked, motion stepped, sensors read. What the `plant` node runs, without ROS.

Sample k uses the answers to sample k-1: the command acts from t_k on, and the ground has the commanded acceleration at
t_k. Then the sensors are read. A command that is missing while the force is not zero, two commands for one sample, a
value that is not finite and an emergency stop are faults: the guard ramps the force to zero and holds it there until a
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
    from abrace_plant.rig.sensors import SensorFault

RAMP_TIME = 0.5
"""Seconds within which a fault brings force and ground motion to zero."""

COMMAND, GROUND = "brace_command", "ground_motion"


@dataclass(frozen=True)
class Sample:
    """The content of one Response.

    Parameters
    ----------
    sequence
        Sample number.
    reading
        (channels,) [displacements, strokes, accelerations, forces, ground acceleration], as measured.
    command
        (groups,) [N], in effect until this sample.
    """

    sequence: int
    reading: NDArray[np.float64]
    command: NDArray[np.float64]


class _Input:
    """A guarded input: its present value and the sample that it answers."""

    def __init__(self, name: str, guard: CommandGuard, timeout_samples: int) -> None:
        self.name = name
        self.guard = guard
        self._timeout = timeout_samples
        self._pending: Sequence[float] | None = None
        self.value = guard.check(None)
        self.answered = -1
        self.late = 0

    def receive(self, sequence: int, value: Sequence[float], now: int) -> None:
        """Accept an answer to sample `sequence` after sample `now`; one later than the timeout does not act."""
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
        """The value from the sample after `last` on."""
        if last - self.answered > self._timeout and self.value.any():
            self.guard.fault(f"no {self.name} for {last - self.answered} samples")
        self.value = self.guard.check(self._pending)
        self._pending = None
        return self.value


class RigLoop:
    """A simulated rig with its inputs, sensors and guards.

    Parameters
    ----------
    rig
        The rig.
    seed
        Of the sensor noise.
    command_timeout
        Seconds without a command or ground acceleration, while it is not zero, that are no fault yet.
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

    def receive_command(self, sequence: int, force: Sequence[float]) -> None:
        """Accept a BraceCommand: `force` (groups,) [N] answers sample `sequence`."""
        self._command.receive(sequence, force, self.sequence)

    def receive_ground_acceleration(self, sequence: int, acceleration: float) -> None:
        """Accept a ground `acceleration` [m/s^2] for the sample after `sequence`."""
        self._ground.receive(sequence, [acceleration], self.sequence)

    def sensor_faults(self, texts: Sequence[str]) -> tuple[SensorFault, ...]:
        """Sensor faults for `set_sensor_faults`; their times count from sample 0.

        Parameters
        ----------
        texts
            Each as for `parse_fault`, such as `["a2=stuck", "x3=noise@20.0"]`.

        Raises
        ------
        AbraceError
            As in `parse_fault`.
        """
        return tuple(parse_fault(text, self._channels, self._period) for text in texts)

    def set_sensor_faults(self, faults: tuple[SensorFault, ...]) -> None:
        """Replace the sensor faults; none: every channel is well."""
        self._measurement.faults = faults

    def answered(self, name: str) -> bool:
        """Whether the last sample has been answered on the topic `name`: `brace_command` or `ground_motion`."""
        return (self._command if name == COMMAND else self._ground).answered == self.sequence

    def fault(self, reason: str) -> None:
        """Latch a fault with its `reason`: force and ground motion ramp to zero."""
        self._command.guard.fault(reason)
        self._ground.guard.fault(reason)

    def clear_faults(self) -> None:
        """Clear the latched fault."""
        self._command.guard.clear()
        self._ground.guard.clear()

    @property
    def fault_reason(self) -> str | None:
        """The latched fault, if any."""
        return self._command.guard.fault_reason or self._ground.guard.fault_reason

    def sample(self) -> Sample:
        """Apply the inputs, step to the next sample and read the sensors."""
        until_now = self._command.value
        command = self._command.advance(self.sequence)
        ground = float(self._ground.advance(self.sequence)[0])
        self._true[:-1] = self._motion.outputs(ground, command)
        self._true[-1] = ground
        self.sequence += 1
        return Sample(self.sequence, self._measurement.read(self._true), until_now)

    def counters(self) -> dict[str, int]:
        """Counts of limited and of late inputs so far."""
        guard = self._command.guard
        return {
            "saturations": guard.saturations,
            "rate_limits": guard.rate_limits,
            "late_commands": self._command.late,
            "late_ground_motion": self._ground.late,
        }
