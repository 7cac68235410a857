# SPDX-License-Identifier: Apache-2.0
"""The node `sensor_bridge`: the real rig behind a device file, with exactly the topics of the simulated one.

abrace run abrace_plant sensor_bridge --ros-args -p rig:=my_rig.yaml -p device:=my_device.yaml -p thread_priority:=50
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable

from std_srvs.srv import Trigger

from abrace_core.errors import AbraceError
from abrace_core.node import Parameter, find_file, run
from abrace_plant.devices.calibration import Calibration, read_calibration, write_calibration
from abrace_plant.devices.device import Device, DeviceError, Reading
from abrace_plant.devices.file import calibration_of, commands_of, load_device
from abrace_plant.devices.zeroing import Zeroing, check_names
from abrace_plant.live.loop import Sample
from abrace_plant.live.real_time import command_zeros
from abrace_plant.nodes.rig_node import STOP_PERIOD, RigNode, time_limits
from abrace_plant.rig.model import Rig

PARAMETERS = [
    Parameter("device", "", "device: a name in the package's configuration or a file", required=True),
    *time_limits(0.1, 100),  # at real hardware the last force is held so long
    Parameter("zero_channels", [], "channels that ~/zero_sensors zeroes; empty: all", element=str, live=True),
]
ZEROS_TIME = 0.2
"""Seconds of zero commands before the first sample: longer than a target takes to come to rest after a bridge was
killed. A target follows commands only after a zero command."""
ZEROS_PATIENCE = 1.0
"""Seconds of failure during the zero commands after which the activation is refused."""
WARM_UP = 5
"""Samples in a row that the thread of a run must take in time before the first one that is published."""
WARM_UP_TIME = 1.0
"""Seconds after which the run begins even if it is not in time; it is then a fault as soon as something acts."""
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
        self.path = find_file(self.parameters.device, "abrace_plant", "config/devices", ".yaml", "device")
        self.device = load_device(self.path, rig)
        self.calibration_file = calibration_of(self.path)
        check_names(rig.channel_names, self.parameters.zero_channels)
        return rig

    def make_device(self) -> Device:
        """The device, from the present content of its files."""
        self.next_calibration = None
        return load_device(self.path, self.rig)

    def open_device(self) -> None:
        """Connect, and command zero until the target follows; nothing acts yet, so that a delay does no harm."""
        self.device.open()
        command_zeros(self.device, self.rig.groups, round(ZEROS_TIME * self.rig.sample_rate), ZEROS_PATIENCE)

    def prepare(self) -> None:
        """Set up the thread, and discard the samples that have arrived since the device was opened: begin in time."""
        super().prepare()
        in_time, latest = 0, time.monotonic() + WARM_UP_TIME
        with contextlib.suppress(DeviceError):  # the first sample of the run will meet the same error
            while in_time < WARM_UP and time.monotonic() < latest:
                in_time = in_time + 1 if self.command_zero().age < 1 / self.rig.sample_rate else 0

    def command_zero(self) -> Reading:
        """Exchange a sample for a command of zero."""
        return self.device.exchange([0.0] * self.rig.groups, 0.0)

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
            path, rig = self.calibration_file, self.rig
            calibration = getattr(self.device, "calibration", None)
            if path is None or not isinstance(calibration, Calibration):
                raise AbraceError(f"zeroing: device file {self.path} names no calibration")
            samples = round(ZEROING_TIME * rig.sample_rate)
            self.zeroing = zeroing = Zeroing(calibration, self.parameters.zero_channels, samples)
        end = time.monotonic() + PATIENCE * ZEROING_TIME
        while not zeroing.over.wait(STOP_PERIOD) and time.monotonic() < end:
            self.look_for_stops()  # whose timer waits for this thread
        with self.lock:
            self.zeroing = None
        new, changes = zeroing.result()
        used = Calibration(new, rig.channel_names, commands_of(rig), rig.sample_rate)
        if read_calibration(path) != calibration.file:
            raise AbraceError(f"zeroing: {path} was changed after the activation: deactivate, activate, zero again")
        write_calibration(path, new)
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
            values |= {"calibration": self.calibration_file or "none", "zeroed": self.zeroed}
            calibration = getattr(self.device, "calibration", None)
            if isinstance(calibration, Calibration):
                values |= {f"calibration {name}": text for name, text in calibration.facts().items()}
        return fault, message, values


def main() -> int:
    """Entry point."""
    return run(SensorBridge)
