# SPDX-License-Identifier: Apache-2.0
"""Ports of an emulated target: the interface, and the port for UDP packets through two faulty links."""

from __future__ import annotations

import socket
from collections import Counter
from typing import TYPE_CHECKING, Protocol

from abrace_core.errors import AbraceError
from abrace_plant.devices.layout import Malformed
from abrace_plant.emulator.link import Link

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from abrace_plant.devices.calibration import Calibration
    from abrace_plant.devices.layout import Packet
    from abrace_plant.devices.udp import UdpFile
    from abrace_plant.emulator.target import Target


class Port(Protocol):
    """Takes commands for a target and gives its samples away."""

    @property
    def sockets(self) -> Sequence[socket.socket]:
        """At which something may come."""
        ...

    links: dict[str, Link]
    """By the direction of what goes through them."""
    dropped: Counter[str]
    """Counts of rejected commands, by reason."""

    def serve(self, now: float) -> None:
        """Take what has come and send what is due at `now` [s]."""
        ...

    def publish(self, reading: NDArray[np.float64], now: float) -> None:
        """Give away the `reading` (channels,) in SI units of the target's present tick, at `now` [s]."""
        ...

    def close(self) -> None:
        """Serve no longer."""
        ...


class UdpPort:
    """Packets as the device file says, seen from the target.

    Parameters
    ----------
    file
        The device file; its `address` has to be one of this computer's.
    samples, commands
        Its packets.
    calibration
        Its calibration: samples are sent raw.
    target
        Who takes commands.
    bridge
        Address that samples are sent to.
    seed
        Of what happens by chance on the links.
    """

    def __init__(
        self,
        file: UdpFile,
        samples: Packet,
        commands: Packet,
        calibration: Calibration,
        target: Target,
        bridge: str,
        seed: int,
    ) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind((str(file.address), file.sender[1]))
        except OSError as error:
            self._socket.close()
            raise AbraceError(f"cannot receive at {file.address}:{file.sender[1]}: {error.strerror}") from error
        self._to = bridge, file.local_port
        self._samples, self._commands, self._calibration, self._target = samples, commands, calibration, target
        self.links = {"sample": Link(seed), "command": Link(seed + 1)}
        self.dropped: Counter[str] = Counter()
        self._last: int | None = None

    @property
    def sockets(self) -> Sequence[socket.socket]:
        """At which something may come."""
        return (self._socket,)

    def serve(self, now: float) -> None:
        """Take what has come and send what is due at `now` [s]."""
        command, sample = self.links["command"], self.links["sample"]
        while True:
            try:
                command.put(self._socket.recv(self._commands.length + 1), now)
            except OSError:
                break
        for packet in command.take(now):
            try:
                self._take(packet)
            except Malformed as fault:
                self.dropped[str(fault)] += 1
        for packet in sample.take(now):
            try:
                self._socket.sendto(packet, self._to)
            except OSError:
                self.dropped["not_sent"] += 1

    def _take(self, packet: bytes) -> None:
        content = self._commands.decode(packet)
        if self._last is not None:
            ticks = (content.counter - self._last) % self._commands.modulus
            if ticks == 0:
                raise Malformed("repeated")
            # at rest, a restarted bridge may count from any number
            if self._target.following and ticks > self._commands.modulus // 2:
                raise Malformed("old")
        self._last = content.counter
        self._target.command(self._calibration.commanded(content.signals), content.enabled)

    def publish(self, reading: NDArray[np.float64], now: float) -> None:
        """Send the `reading` (channels,) in SI units of the target's present tick, at `now` [s]."""
        tick = self._target.tick
        time = round(tick * self._target.period * 1e9)
        raw = self._calibration.raw(reading).tolist()
        self.links["sample"].put(self._samples.encode(raw, tick, time, self._last or 0), now)
        self.serve(now)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
