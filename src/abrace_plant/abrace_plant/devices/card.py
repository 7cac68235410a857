# SPDX-License-Identifier: Apache-2.0
"""A card of inputs and outputs as a device: what a laboratory writes for it is four methods that can do no harm.

The C99 target of `targets/c99` stands between rig and card: it follows only while armed, limits every output, and
brings force and table to rest along its own ramps. It runs in this computer: when that fails, only a watchdog of the
card or of the amplifier is left.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_plant.devices.c_target import ARMED, DISARMED, CTarget, causes_in_words
from abrace_plant.devices.device import DeviceError, Reading, TargetStatus, Wanted, shape_problem
from abrace_plant.devices.file import load_calibration

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from abrace_plant.devices.file import DeviceFile
    from abrace_plant.rig.model import Rig

LIFE_TIME = 0.05
"""Seconds without an exchange after which the outputs go to zero with the next one."""
RAMP_TIME = 0.1
"""Seconds in which they do."""
LONGEST_REST = 3.0
"""Seconds after which outputs that are not at rest count as a failure: a table brakes as long as its limits ask for."""


class Card(ABC):
    """A device with an output U of each brace group, then w if abrace drives the table, and an input for each channel.

    Parameters
    ----------
    path
        Of the device file.
    file
        Its content.
    rig
        The rig.

    Attributes
    ----------
    calibration
        Volts or counts of the channels and of the outputs.
    name
        How errors name the card.
    """

    def __init__(self, path: Path, file: DeviceFile, rig: Rig) -> None:
        self.calibration = load_calibration(path, file, rig)
        self.name = f"{file.kind} device {path}"
        self._period = 1 / rig.sample_rate
        self._target = CTarget(rig, LIFE_TIME, RAMP_TIME)
        self._counter, self._missed, self._due = 0, 0, 0.0

    @abstractmethod
    def connect(self) -> Sequence[float] | None:
        """Connect; nothing moves. Returns the outputs that stand there [volts or counts]; None: they are at zero."""

    @abstractmethod
    def write(self, outputs: list[float]) -> None:
        """Write all outputs [volts or counts]."""

    @abstractmethod
    def read(self) -> tuple[Sequence[float], int]:
        """Wait for the next tick; its readings [volts or counts], and the ticks since the last call that were missed.

        It raises any error if there is none within some periods.
        """

    @abstractmethod
    def disconnect(self) -> None:
        """Disconnect, also after half of `connect`; the outputs stay as they are."""

    def wait_for_tick(self) -> int:
        """Wait for the next tick of this computer's clock, for a card without one; returns how many were missed."""
        self._due += self._period
        time.sleep(max(0.0, self._due - time.monotonic()))
        missed = int((time.monotonic() - self._due) / self._period)
        self._due += missed * self._period
        return missed

    def open(self) -> None:
        """Connect, and bring outputs that stand there to zero; as in `Device`."""
        self.close()
        try:
            standing = self.connect()
            if standing is not None:
                raw = np.reshape(standing, self.calibration.commands).tolist()
                self._target.bring_to_rest(self.calibration.commanded(raw).tolist())
            self.make_safe()
        except Exception as error:
            self.close()
            raise DeviceError(f"{self.name}: {error}") from error
        self._missed, self._due = 0, time.monotonic()
        self.calibration.reset()

    def exchange(self, command: Sequence[float], table: float, wanted: Wanted, arm: int) -> Reading:
        """Write what the target makes of the command, then wait for the next tick.

        `command`, `table`, `wanted` and `arm` are as in `Device`.
        """
        self._take([*command, table], wanted, arm)
        try:
            self._put(1 + self._missed)
            read, self._missed = self.read()
            stamp = time.time_ns() - round(1e9 * self.calibration.delay)
            raw = np.asarray(read, dtype=np.float64)
        except Exception as error:
            raise DeviceError(f"{self.name}: {error}") from error
        if problem := shape_problem(raw, self.calibration.channels):
            raise AbraceError(f"{self.name}: read gave {problem}")
        values, clipped = self.calibration.measured(raw)
        target, armed = self._target, self._target.state == ARMED
        status = TargetStatus(
            target.last_arm if armed else 0,
            target.last_arm,
            "" if armed else causes_in_words(target.causes),
            target.applied.tolist(),
        )
        return Reading(values, stamp, clipped, self._missed, status)

    def make_safe(self) -> None:
        """Bring the outputs to rest along the target's ramp, by this computer's clock; as in `Device`."""
        self._take([0.0] * self.calibration.commands, Wanted.SAFE, 0)
        try:
            self._put(1)
            end = time.monotonic() + LONGEST_REST
            while self._target.state != DISARMED:
                if time.monotonic() > end:
                    raise DeviceError(f"not at rest after {LONGEST_REST:g} s")
                time.sleep(self._period)
                self._put(1)
        except Exception as error:
            raise DeviceError(f"not made safe, the outputs keep their values: {error}") from error

    def close(self) -> None:
        """Disconnect."""
        self.disconnect()

    def _take(self, outputs: Sequence[float], wanted: Wanted, arm: int) -> None:
        self._counter += 1
        self._target.command(self._counter, outputs, arm, wanted)

    def _put(self, ticks: int) -> None:
        """Write the outputs of the next tick."""
        self._target.tick(ticks)
        self.write(self.calibration.outputs(self._target.applied.tolist()[: self.calibration.commands]))
