# SPDX-License-Identifier: Apache-2.0
"""The port of an emulated target: UDP packets through two faulty links."""

from __future__ import annotations

import socket
from collections import Counter
from typing import TYPE_CHECKING

from abrace_core import AbraceError
from abrace_plant.devices.file import load_calibration
from abrace_plant.devices.layout import Malformed
from abrace_plant.devices.udp import packets
from abrace_plant.emulator.link import Link

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from abrace_plant.devices.udp import UdpFile
    from abrace_plant.emulator.target import Target
    from abrace_plant.rig.model import Rig


class Port:
    """Takes commands for a target and gives its samples away, in packets as the device file says.

    Parameters
    ----------
    path, file
        Of the device, and its content, whose `address` has to be one of this computer's. Samples are sent raw, to the
        bridge on this computer.
    rig
        Whose channels and commands are in the packets.
    target
        Who takes commands.
    seed
        Of what happens by chance on the links.

    Attributes
    ----------
    socket
        At which commands come.
    links
        By the direction of what goes through them.
    dropped
        Counts of rejected commands, by reason.
    """

    def __init__(self, path: Path, file: UdpFile, rig: Rig, target: Target, seed: int) -> None:
        self._samples, self._commands = packets(path, file, rig)
        self._calibration, self._target = load_calibration(path, file, rig), target
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        try:
            self.socket.bind((str(file.address), file.sender[1]))
        except OSError as error:
            self.socket.close()
            raise AbraceError(f"cannot receive at {file.address}:{file.sender[1]}: {error.strerror}") from error
        self._to = "127.0.0.1", file.local_port
        self.links = {"sample": Link(seed), "command": Link(seed + 1)}
        self.dropped: Counter[str] = Counter()
        self._table = len(self._samples.signals) > len(rig.channel_names) + self._calibration.commands

    def serve(self, now: float) -> None:
        """Take what has come and send what is due at `now` [s]."""
        command, sample = self.links["command"], self.links["sample"]
        while True:
            try:
                command.put(self.socket.recv(self._commands.length + 1), now)
            except OSError:
                break
        for packet in command.take(now):
            try:
                self._take(packet)
            except Malformed as fault:
                self.dropped[str(fault)] += 1
        for packet in sample.take(now):
            try:
                self.socket.sendto(packet, self._to)
            except OSError:
                self.dropped["not_sent"] += 1

    def _take(self, packet: bytes) -> None:
        content = self._commands.decode(packet)
        values = self._calibration.commanded(content.signals)
        if outcome := self._target.command(content.counter, values, content.arm, content.state):
            raise Malformed(outcome)

    def publish(self, reading: NDArray[np.float64], now: float) -> None:
        """Send the `reading` (channels,) in SI units of the target's present tick, at `now` [s]."""
        target = self._target
        outputs = target.outputs
        applied = outputs.applied.tolist()[: self._calibration.commands]
        raw = [*self._calibration.raw(reading).tolist(), *self._calibration.outputs(applied)]
        raw += [target.displacement] * self._table
        time = round(target.tick * target.period * 1e9)
        status = outputs.last_arm, outputs.state, outputs.causes, outputs.applied_counter
        self.links["sample"].put(self._samples.encode(raw, target.tick, time, *status), now)
        self.serve(now)

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()
