# SPDX-License-Identifier: Apache-2.0
"""An emulated target behind Modbus-TCP: pymodbus's server, whose registers are the target's."""

from __future__ import annotations

import asyncio
import threading
from collections import Counter
from typing import TYPE_CHECKING

from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    import socket
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from abrace_plant.devices.calibration import Calibration
    from abrace_plant.devices.registers import Block
    from abrace_plant.emulator.link import Link
    from abrace_plant.emulator.target import Target


class ModbusPort:
    """Registers as the register map says, by pymodbus's server in a thread of its own.

    Parameters
    ----------
    address
        Address and port to serve at.
    inputs, outputs
        Blocks of the map, the channels' and the commands'.
    calibration
        Registers hold raw values.
    target
        Who takes commands. Every write counts as life.
    """

    def __init__(
        self,
        address: tuple[str, int],
        inputs: Sequence[Block],
        outputs: Sequence[Block],
        calibration: Calibration,
        target: Target,
    ) -> None:
        self.links: dict[str, Link] = {}
        self.dropped: Counter[str] = Counter()
        self._inputs, self._outputs, self._calibration, self._target = inputs, outputs, calibration, target
        self._registers = [0] * 65536
        zero = calibration.outputs([0.0] * calibration.commands)
        for block in outputs:
            self._registers[block.first : block.first + block.words] = block.encode([zero[i] for i in block.positions])
        self._commanded = list(self._registers)
        self._written: list[tuple[int, list[int]]] = []
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="modbus", daemon=True)
        self._thread.start()
        serving = asyncio.run_coroutine_threadsafe(self._serve(address), self._loop)
        try:
            serving.result(5.0)
        except RuntimeError as error:
            self.close()
            raise AbraceError(f"cannot serve Modbus at {address[0]}:{address[1]}: is the port taken?") from error

    @property
    def sockets(self) -> Sequence[socket.socket]:
        """At which something may come: the server's own thread looks after its sockets."""
        return ()

    async def _serve(self, address: tuple[str, int]) -> None:
        async def action(
            _: int, start: int, first: int, count: int, registers: list[int], values: list[int] | list[bool] | None
        ) -> None:
            if values is None:
                registers[first - start : first - start + count] = self._registers[first : first + count]
            else:
                words = [int(value) for value in values]
                self._registers[first : first + count] = words
                self._written.append((first, words))

        registers = [SimData(0, count=65536, datatype=DataType.REGISTERS)]
        self._server = ModbusTcpServer(SimDevice(id=0, simdata=registers, action=action), address=address)
        await self._server.serve_forever(background=True)

    def serve(self, now: float) -> None:  # noqa: ARG002
        """Give the target what has been written until `now`."""
        while self._written:
            first, words = self._written.pop(0)
            self._commanded[first : first + len(words)] = words
            raw = [0.0] * self._calibration.commands
            for block in self._outputs:
                values = block.decode(self._commanded[block.first : block.first + block.words])
                for position, value in zip(block.positions, values, strict=True):
                    raw[position] = value
            self._target.command(self._calibration.commanded(raw), enabled=True)

    def publish(self, reading: NDArray[np.float64], now: float) -> None:
        """Put the `reading` (channels,) in SI units into the registers, at `now` [s]."""
        raw = self._calibration.raw(reading)
        for block in self._inputs:
            words = block.encode(raw[block.positions].tolist())
            self._registers[block.first : block.first + block.words] = words
        self.serve(now)

    def close(self) -> None:
        """Stop the server."""
        asyncio.run_coroutine_threadsafe(self._server.shutdown(), self._loop).result(5.0)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(5.0)
        self._loop.close()
