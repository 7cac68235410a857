# SPDX-License-Identifier: Apache-2.0
"""A rig by the clock behind the emulated target, as a program of its own: real packets, and no ROS."""

from __future__ import annotations

import subprocess
import threading
import time
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from emulated_target import TICKING, EmulatedTarget
from udp_target import RIG, device_file

from abrace_core import AbraceError
from abrace_core.safety.rig_safety import RigSafety, State
from abrace_plant.devices.file import load_device
from abrace_plant.live.loop import RigLoop, rig_outputs
from abrace_plant.live.real_time import RealTimeRun

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from abrace_plant.devices.device import Reading, TargetStatus
    from abrace_plant.live.loop import Sample

    Law = Callable[[int, list[float]], tuple[float, float]]

PATIENCE = 60.0


class Seen(NamedTuple):
    """One sample, and the target at it."""

    sample: Sample
    target: TargetStatus


class LiveRig:
    """The paper's rig, its loop, and somebody who commands it.

    Parameters
    ----------
    folder
        For the device file.
    law
        Force [N] and acceleration of the table [m/s^2] that answer a sample: its number since the start, and what was
        measured.

    Attributes
    ----------
    seen
        All samples so far.
    asks
        Whether the law commands; otherwise zero is commanded.
    """

    def __init__(self, folder: Path, law: Law) -> None:
        path = device_file(folder, timeout=0.1)
        self.target = EmulatedTarget(path)
        self._process = subprocess.Popen(list(map(str, self.target.command)), stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == f"{TICKING}\n"
        self.device = load_device(path, RIG)
        self.safety = RigSafety()
        self.safety.configure(rig_outputs(RIG), 1 / RIG.sample_rate)
        self.lock = threading.RLock()
        self.seen: list[Seen] = []
        self.causes: list[str] = []
        self.asks, self._law = True, law
        self.safety.activate()
        self.loop = RigLoop(RIG, self.device, self.safety, 0.1, 100, 1, lockstep=False)
        self._take = self.loop.take
        self.loop.take = self._noted  # type: ignore[method-assign]
        self._over = threading.Event()
        self.run = RealTimeRun(
            self.loop, self.device, 1 / RIG.sample_rate, self.lock, self._answer, self._over.set, lambda: None
        )
        self.device.open()
        self.run.start()

    def _noted(self, reading: Reading, clocks: tuple[int, int] | None = None) -> Sample:
        sample = self._take(reading, clocks)
        self.seen.append(Seen(sample, reading.target))
        return sample

    def _answer(self, sample: Sample | None) -> None:
        """Answer a sample, if the device has given one, at once and with the lock."""
        self.loop.note_stops_polled()
        if sample is None:
            return
        force, table = self._law(sample.head.sequence, sample.reading) if self.asks else (0.0, 0.0)
        self.loop.receive_command(1, sample.head.sequence, [force], "")
        self.loop.receive_ground_acceleration(sample.stamp, table)

    def until(self, holds: Callable[[], bool], what: str, seconds: float = PATIENCE) -> None:
        """Wait."""
        end = time.monotonic() + seconds
        while not holds():
            assert time.monotonic() < end, (
                f"waited {seconds:g} s for {what}: {self.state.words}, {self.safety.cause}, cleared: {self.causes[-3:]}"
            )
            assert not self.run.errors, self.run.errors
            time.sleep(0.002)

    @property
    def state(self) -> State:
        """Of the rig."""
        return self.safety.state

    def start(self, asks: bool = True) -> None:
        """Let the rig run; clear it before, as a person does. A fault meanwhile is a busy machine's: try again."""
        self.asks = False
        self.until(lambda: self.state is State.RUNNING or (self.cleared() and False), "the rig to run")
        self.asks = asks

    def cleared(self) -> bool:
        """Clear the rig, if that is not refused."""
        with self.lock:
            try:
                self.causes.append(self.safety.clear(self.loop.moving()))
            except AbraceError:
                return False
        return True

    def since(self, count: int) -> list[Seen]:
        """The samples after the first `count`."""
        return self.seen[count:]

    def close(self) -> None:
        """End the run and the target."""
        with self.lock:
            self.asks = False
            self.safety.deactivate()
            self.loop.ending = self.loop.give_up = True
        self._over.wait(10)
        self._process.terminate()
        self._process.communicate(timeout=60)


def forces(seen: list[Seen]) -> np.ndarray:
    """(samples, braces) measured [N]."""
    braces = sum(RIG.braces_in_group)
    return np.array([one.sample.reading[-1 - braces : -1] for one in seen])
