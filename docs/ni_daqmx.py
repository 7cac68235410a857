# SPDX-License-Identifier: Apache-2.0
"""A device of one's own: a National Instruments card by NI-DAQmx, as the page bridge.md describes it."""

from __future__ import annotations

import contextlib
import time
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from abrace_core.config_file import read_config
from abrace_plant.devices.device import DeviceError, Reading
from abrace_plant.devices.file import DeviceFile, load_calibration

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from abrace_plant.devices.device import Device
    from abrace_plant.rig.model import Rig


class NiDaqmxFile(DeviceFile):
    """Inputs such as Dev1/ai0:8 in the order of a reading, outputs such as Dev1/ao0:1: U of each group, then w."""

    kind: Literal["ni_daqmx"]
    inputs: str
    outputs: str


class NiDaqmx:
    """The card; the sample clock of its inputs is the tick."""

    def __init__(self, path: Path, rig: Rig) -> None:
        self.file = read_config(path, NiDaqmxFile, "device")
        self.calibration = load_calibration(path, self.file, rig)
        self.rate, self.tasks = rig.sample_rate, list[Any]()
        self.last = [0.0] * self.calibration.commands

    def open(self) -> None:
        """Zero at the outputs, then start the clock."""
        from nidaqmx import Task
        from nidaqmx.constants import AcquisitionType

        self.tasks = [Task(), Task()]
        self.tasks[0].ao_channels.add_ao_voltage_chan(self.file.outputs)
        self.tasks[1].ai_channels.add_ai_voltage_chan(self.file.inputs)
        self.tasks[1].timing.cfg_samp_clk_timing(self.rate, sample_mode=AcquisitionType.CONTINUOUS)
        self.write(self.last)
        self.tasks[1].start()

    def exchange(self, command: Sequence[float], table: float) -> Reading:
        """Write, then wait for the next scan; of several that have come the last one is used."""
        try:
            self.write([*command, table])
            scans = max(1, self.tasks[1].in_stream.avail_samp_per_chan)
            raw = np.array(self.tasks[1].read(scans, timeout=0.02)).reshape(-1, scans)[:, -1]
        except Exception as error:  # nidaqmx.DaqError
            raise DeviceError(f"NI-DAQmx {self.file.inputs}: {error}") from error
        values, clipped = self.calibration.measured(raw)
        return Reading(values, time.time_ns() - round(1e9 * self.calibration.delay), clipped, scans - 1)

    def make_safe(self) -> None:
        """Zero at the outputs; by a ramp of half a second, as a step of the force would shake the building."""
        start = self.last
        steps = round(0.5 * self.rate) if any(start) else 1
        with contextlib.suppress(Exception):  # the card itself has failed
            for step in reversed(range(steps)):
                self.write([value * step / steps for value in start])
                time.sleep(1 / self.rate)

    def write(self, values: Sequence[float]) -> None:
        """Write force [N] and table acceleration [m/s^2], in volts."""
        self.tasks[0].write(self.calibration.outputs(values))
        self.last = list(values)

    def close(self) -> None:
        """Stop the clock; the outputs stay as they are."""
        while self.tasks:
            self.tasks.pop().close()


def load(path: Path, rig: Rig) -> Device:
    """The card of a device file."""
    return NiDaqmx(path, rig)
