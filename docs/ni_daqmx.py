# SPDX-License-Identifier: Apache-2.0
"""A device of one's own: a National Instruments card by NI-DAQmx, as bridge.md describes it."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from abrace_core.config_file import read_config
from abrace_plant.devices.device import DeviceError, Reading
from abrace_plant.devices.file import DeviceFile, load_calibration

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from abrace_plant.devices.device import Device
    from abrace_plant.rig.model import Rig


class NiDaqmxFile(DeviceFile):
    """Inputs in the order of a reading, outputs for U of each group and w, and the inputs that read these outputs."""

    kind: Literal["ni_daqmx"]
    inputs: str
    outputs: str
    read_back: str


class NiDaqmx:
    """The card; the sample clock of its inputs is the tick."""

    def __init__(self, path: Path, rig: Rig) -> None:
        self.file = read_config(path, NiDaqmxFile, "device")
        self.calibration = load_calibration(path, self.file, rig)
        self.rate, self.tasks, self.last = rig.sample_rate, list[Any](), [0.0] * self.calibration.commands

    def open(self) -> None:
        """Zero at the outputs, by a ramp from where another program has left them, then start the clock."""
        from nidaqmx import Task, constants

        try:
            with Task() as standing:
                standing.ai_channels.add_ai_voltage_chan(self.file.read_back)
                self.last = self.calibration.commanded(np.reshape(standing.read(), len(self.last)).tolist()).tolist()
            self.tasks = [Task(), Task()]
            self.tasks[0].ao_channels.add_ao_voltage_chan(self.file.outputs)
            self.tasks[1].ai_channels.add_ai_voltage_chan(self.file.inputs)
            self.tasks[1].timing.cfg_samp_clk_timing(self.rate, sample_mode=constants.AcquisitionType.CONTINUOUS)
            self.make_safe()
            self.tasks[1].start()
        except Exception as error:  # nidaqmx.DaqError
            self.close()
            raise DeviceError(f"NI-DAQmx {self.file.outputs}, read by {self.file.read_back}: {error}") from error

    def exchange(self, command: Sequence[float], table: float) -> Reading:
        """Write, then wait for the next scan; of several that have come the last one is used."""
        try:
            self.write([*command, table])
            scans = max(1, self.tasks[1].in_stream.avail_samp_per_chan)
            raw = np.array(self.tasks[1].read(scans, timeout=0.02)).reshape(-1, scans)[:, -1]
        except Exception as error:
            raise DeviceError(f"NI-DAQmx {self.file.inputs}: {error}") from error
        values, clipped = self.calibration.measured(raw)
        return Reading(values, time.time_ns() - round(1e9 * self.calibration.delay), clipped, scans - 1)

    def make_safe(self) -> None:
        """Zero at the outputs; by a ramp of half a second, as a step of the force would shake the building."""
        try:
            for values in np.outer(np.linspace(1, 0, 251 if any(self.last) else 1), self.last).tolist():
                self.write(values)
                time.sleep(0.002)
        except Exception as error:
            raise DeviceError(f"not made safe, the outputs keep their voltage: {error}") from error

    def write(self, values: Sequence[float]) -> None:
        """Write force [N] and table acceleration [m/s^2], in volts."""
        self.tasks[0].write(self.calibration.outputs(values))
        self.last = list(values)

    def close(self) -> None:
        """Stop the clock; the outputs stay as they are."""
        while self.tasks:
            self.tasks.pop().close()


load: Callable[[Path, Rig], Device] = NiDaqmx
"""The entry point: gives the card of a device file."""
