# SPDX-License-Identifier: Apache-2.0
"""A device of one's own: a National Instruments card by NI-DAQmx, as bridge.md describes it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from abrace_core.files.config_file import read_config
from abrace_plant.devices.card import Card
from abrace_plant.devices.file import DeviceFile

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


class NiDaqmx(Card):
    """The card; the sample clock of its inputs is the tick."""

    def __init__(self, path: Path, rig: Rig) -> None:
        self.file = read_config(path, NiDaqmxFile, "device")
        super().__init__(path, self.file, rig)
        self.rate, self.tasks = rig.sample_rate, list[Any]()

    def connect(self) -> Sequence[float]:
        """Volts at the outputs, where another program has left them; the sample clock runs."""
        from nidaqmx import Task, constants

        with Task() as standing:
            standing.ai_channels.add_ai_voltage_chan(self.file.read_back)
            volts: list[float] = np.ravel(standing.read()).tolist()
        self.tasks = [Task(), Task()]
        self.tasks[0].ao_channels.add_ao_voltage_chan(self.file.outputs)
        self.tasks[1].ai_channels.add_ai_voltage_chan(self.file.inputs)
        self.tasks[1].timing.cfg_samp_clk_timing(self.rate, sample_mode=constants.AcquisitionType.CONTINUOUS)
        self.tasks[1].start()
        return volts

    def write(self, outputs: list[float]) -> None:
        """Volts at the outputs."""
        self.tasks[0].write(outputs)

    def read(self) -> tuple[list[float], int]:
        """The next scan; of several that have come the last one."""
        scans = max(1, self.tasks[1].in_stream.avail_samp_per_chan)
        volts = np.array(self.tasks[1].read(scans, timeout=0.02)).reshape(-1, scans)[:, -1]
        return volts.tolist(), scans - 1

    def disconnect(self) -> None:
        """Stop the clock; the outputs stay as they are."""
        while self.tasks:
            self.tasks.pop().close()


load: Callable[[Path, Rig], Device] = NiDaqmx
"""The entry point: gives the card of a device file."""
