# SPDX-License-Identifier: Apache-2.0
"""A target for tests of UDP devices: sends given packets, and stores received ones."""

from __future__ import annotations

import math
import socket
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

from abrace_plant.devices.device import Wanted
from abrace_plant.devices.layout import Packet, read_layout
from abrace_plant.devices.udp import UdpDevice, load
from abrace_plant.rig.file import load_rig

if TYPE_CHECKING:
    from types import TracebackType

CONFIG = Path(__file__).parents[2] / "src/abrace_plant/config"
RIG = load_rig(CONFIG / "ncree_three_storey.yaml")
LAYOUT = CONFIG / "device_parts/udp_layout.yaml"
CHANNELS = ("x1", "x2", "x3", "xf", "a1", "a2", "a3", "fa", "fb", "w")
PERIOD = round(1e9 / RIG.sample_rate)
ARM, APPLIED, TABLE = 7, (1.5, -0.25), 0.125
"""Of every sample: the arm number that the target has accepted, its outputs, and the table's displacement."""


def free_ports(count: int) -> list[int]:
    """Ports that are free now."""
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    for each in sockets:
        each.bind(("127.0.0.1", 0))
    ports = [each.getsockname()[1] for each in sockets]
    for each in sockets:
        each.close()
    return ports


def life_time_of(timeout: float) -> float:
    """Seconds without commands after which the target of a `device_file` stops: longer than a machine is held up."""
    return min(1.0, max(0.3, 3 * timeout))


def device_file(folder: Path, timeout: float = 0.9, calibrated: bool = False, layout: Path = LAYOUT) -> Path:
    """A device file in `folder` with free ports and abrace's own layout, or another; its target waits for us."""
    port, local_port = free_ports(2)
    path = folder / "device.yaml"
    calibration = f"calibration: {CONFIG}/device_parts/calibration.yaml\n" if calibrated else ""
    path.write_text(
        f"kind: udp\naddress: 127.0.0.1\nport: {port}\nlocal_address: 127.0.0.1\nlocal_port: {local_port}\n"
        f"timeout: {timeout}\nlife_time: {life_time_of(timeout)}\nlayout: {layout}\n{calibration}"
    )
    return path


def values_of(counter: int) -> list[float]:
    """The signals of sample `counter`, by which it can be identified."""
    return [counter + 0.001 * i for i in range(len(CHANNELS))]


class UdpTarget:
    """A target that sends samples from its own port, and the device that it belongs to."""

    def __init__(self, path: Path) -> None:
        self.device = self.device_of(path)
        file = self.device.file
        layout = read_layout(path.parent / file.layout)
        self.table = [TABLE] * ("table_displacement" in [entry.field for entry in layout.sample])
        named = (*CHANNELS, "applied_U", "applied_w", "table_displacement")
        self.samples = Packet(layout, "sample", named if self.table else named[:-1])
        self.commands = Packet(layout, "command", ("U", "w"))
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(file.sender)
        self.socket.settimeout(5.0)
        self.to = "127.0.0.1", file.local_port
        self.counter = self.sent = 1000
        self.state, self.causes = 1, 0

    @staticmethod
    def device_of(path: Path) -> UdpDevice:
        """The device of a device file, for the paper's rig."""
        return load(path, RIG)

    def __enter__(self) -> UdpTarget:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.device.close()
        self.socket.close()

    def sample(self, counter: int, values: list[float] | None = None, time: int | None = None) -> bytes:
        """A good packet, unless `values` or `time` [ns] are wrong."""
        return self.encoded(counter, values_of(counter) if values is None else values, self.answered(), time)

    def encoded(self, counter: int, values: list[float], applied_counter: int, time: int | None = None) -> bytes:
        """A sample of a target that has applied that command last."""
        time = counter * PERIOD if time is None else time
        return self.samples.encode(
            [*values, *APPLIED, *self.table], counter, time, ARM, self.state, self.causes, applied_counter
        )

    def answered(self) -> int:
        """Counter of the last received command; 0 before the first."""
        self.socket.setblocking(False)
        try:
            while True:
                self.last = self.commands.decode(self.socket.recv(1024))
        except BlockingIOError:
            pass
        self.socket.settimeout(5.0)
        return self.last.counter if hasattr(self, "last") else 0

    def send(self, *packets: bytes) -> None:
        """Send packets as they are."""
        for packet in packets:
            self.socket.sendto(packet, self.to)

    def tick(self) -> int:
        """Send the next good sample; returns its counter."""
        self.counter += 1
        self.sent = self.counter
        self.send(self.sample(self.counter))
        return self.counter

    def keep_time(self) -> int:
        """Skip the ticks that have passed since `open` without a sample; returns how many."""
        now = self.opened[0] + (time.monotonic_ns() - self.opened[1]) // PERIOD
        skipped = max(0, now - self.counter - 1)
        self.counter += skipped
        return skipped

    def open(self) -> None:
        """Open the device while samples come, and read those that are left."""
        opened = threading.Event()

        def ticking() -> None:
            while not opened.is_set():
                self.tick()
                time.sleep(PERIOD * 1e-9)

        thread = threading.Thread(target=ticking)
        thread.start()
        try:
            self.device.open()
        finally:
            opened.set()
            thread.join()
        self.opened = self.tick(), time.monotonic_ns()
        self.device.exchange([0.0], 0.0, Wanted.FOLLOW, ARM)


KINDS = ("random", "cut", "longer", "bit", "counter", "small_jump", "repeated", "old", "value")


def malformed(target: UdpTarget, kind: str, amount: int, content: bytes) -> bytes:
    """A packet from the target's address that must be rejected; its CRC is right unless the CRC is the mistake.

    Parameters
    ----------
    target
        Whose next sample it pretends to be.
    kind
        Of `KINDS`.
    amount, content
        By which packets of a kind differ.
    """
    if kind == "random":
        return content
    if kind == "counter":
        return target.sample((target.counter + 10**5 + amount) % 2**32)
    if kind == "old":
        return target.sample((target.sent - 1 - amount % 1000) % 2**32)
    if kind == "small_jump":
        return target.sample(target.counter + 2 + amount % 8, time=(target.counter + 1) * PERIOD)
    if kind == "value":
        values = [1.0] * len(CHANNELS)
        for place in (amount, amount + 1):
            values[place % len(CHANNELS)] = (math.nan, math.inf, -math.inf, 1.7e308)[amount % 4]
        return target.sample(target.counter + 1, values)
    good = bytearray(target.sample(target.sent))
    if kind == "cut":
        return bytes(good[: amount % len(good)])
    if kind == "longer":
        return bytes(good) + content[:1] + b"\0"
    if kind == "bit":
        good[amount % len(good)] ^= 1 << amount % 8
    return bytes(good)
