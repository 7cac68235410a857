# SPDX-License-Identifier: Apache-2.0
"""The node `sensor_bridge`: the real rig behind a device file, with exactly the topics of the simulated one.

abrace run abrace_plant sensor_bridge --ros-args -p rig:=my_rig.yaml -p device:=my_device.yaml -p stop_heartbeat:=1.0
"""

from __future__ import annotations

import time
from collections.abc import Callable

from std_srvs.srv import Trigger

from abrace_core import AbraceError
from abrace_core.files.installed import find_file
from abrace_node.parameters import Parameter
from abrace_node.process import run
from abrace_plant.devices.calibration import Calibration, read_calibration, write_calibration
from abrace_plant.devices.device import Device
from abrace_plant.devices.file import load_device
from abrace_plant.devices.zeroing import Zeroing, check_names
from abrace_plant.live.loop import Sample
from abrace_plant.nodes.rig_node import STOP_PERIOD, RigNode, time_limits
from abrace_plant.rig.detectors import cells_missing
from abrace_plant.rig.model import Rig

PARAMETERS = [
    Parameter("device", "", "device: a name in the package's configuration or a file", required=True),
    *time_limits(0.1, 100),  # at real hardware the last force is held so long
    Parameter(
        "stop_heartbeat",
        0.0,
        "seconds within which every stop button must repeat; there has to be one",
        minimum=0.02,
        required=True,
    ),
    Parameter("zero_channels", [], "channels that ~/zero_sensors zeroes; empty: all", element=str, live=True),
]
ZEROING_TIME = 1.0
"""Seconds of readings whose mean is zeroed."""
PATIENCE = 2.0
"""The wait for these readings ends after this multiple of their duration."""


class SensorBridge(RigNode):
    """Samples the hardware at its own ticks."""

    zeroing: Zeroing | None = None
    next_calibration: Calibration | None = None
    zeroed = "not since the start"

    def __init__(self) -> None:
        super().__init__("sensor_bridge", PARAMETERS)
        self.create_service(Trigger, "~/zero_sensors", self.on_zero_sensors)
        self.keep_endpoints()

    def load(self) -> Rig:
        """The rig, and the device file checked against it."""
        rig = super().load()
        if cells := cells_missing(rig):
            raise AbraceError(
                f"rig {rig.name}: no load cell {', '.join(cells)}: rest cannot be measured, expected one in each brace "
                "of real hardware (sensors.force)"
            )
        self.path = find_file(self.parameters.device, "abrace_plant", "config/devices", ".yaml", "device")
        self.device = load_device(self.path, rig)
        check_names(rig.channel_names, self.parameters.zero_channels)
        return rig

    @property
    def calibration(self) -> Calibration | None:
        """Of the device, if it has one."""
        found = getattr(self.device, "calibration", None)
        return found if isinstance(found, Calibration) else None

    def make_device(self) -> Device:
        """The device, from the present content of its files."""
        self.next_calibration = None
        return load_device(self.path, self.rig)

    def publish_sample(self, sample: Sample) -> None:
        """Publish a sample, and keep it where sensors are being zeroed; after that their calibration is changed."""
        super().publish_sample(sample)
        if self.next_calibration is not None:
            # here the device waits for no sample; readings jump by what was zeroed, which is no motion
            assert self.loop is not None
            self.device.calibration = self.next_calibration  # type: ignore[attr-defined]
            self.next_calibration = None
            self.loop.interlocks.reset()
        if self.zeroing is not None:
            acting = [value for output in self.safety.outputs for value in output.value]
            self.zeroing.take(sample.reading, acting)

    def on_zero_sensors(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Zero channels by the mean of the next second."""
        try:
            response.message = self.zero()
            response.success = True
            self.get_logger().info(response.message)
        except AbraceError as error:
            response.message = str(error)
        return response

    def zero(self) -> str:
        """Collect, write the calibration file, use it from the next sample on; returns what has changed."""
        with self.lock:
            if not self.active or self.loop is None:
                raise AbraceError("zeroing: the node is not active")
            if moving := self.loop.moving():
                raise AbraceError(f"zeroing: {moving}")
            calibration = self.calibration
            if calibration is None or calibration.path is None:
                raise AbraceError(f"zeroing: device file {self.path} names no calibration")
            samples = round(ZEROING_TIME * self.rig.sample_rate)
            self.zeroing = zeroing = Zeroing(calibration, self.parameters.zero_channels, samples)
        end = time.monotonic() + PATIENCE * ZEROING_TIME
        while not zeroing.over.wait(STOP_PERIOD) and time.monotonic() < end:
            self.poll_stops()  # whose timer waits for this thread
        with self.lock:
            self.zeroing = None
        used, changes = zeroing.result()
        path = calibration.path
        if read_calibration(path) != calibration.file or used.file is None:
            raise AbraceError(f"zeroing: {path} was changed after the activation: deactivate, activate, zero again")
        write_calibration(path, used.file)
        with self.lock:
            self.next_calibration = used
        self.zeroed = time.strftime("%Y-%m-%d %H:%M:%S")
        return f"{path}: {changes}"

    def prepare_change(self, name: str, value: list[str]) -> Callable[[], None]:
        """Channels that are zeroed from now on."""
        if self.configured:
            check_names(self.rig.channel_names, value)
        return super().prepare_change(name, value)

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `/diagnostics`, with the device's counts and calibration."""
        fault, message, values = super().diagnose()
        if self.configured:
            values["device"] = self.path
            values |= {f"device {name}": n for name, n in getattr(self.device, "counters", dict)().items()}
            calibration = self.calibration
            values |= {"calibration": (calibration and calibration.path) or "none", "zeroed": self.zeroed}
            if calibration is not None:
                values |= {f"calibration {name}": text for name, text in calibration.facts().items()}
        return fault, message, values


def main() -> int:
    """Entry point."""
    return run(SensorBridge)
