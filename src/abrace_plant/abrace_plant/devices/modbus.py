# SPDX-License-Identifier: Apache-2.0
"""A device behind Modbus-TCP, such as LabJack's T7: commands are written and readings read at a tick of our own clock.

A device that only answers has no tick of its own, and keeps its outputs when nothing is written any more. So
`make_safe` brings them to zero itself; in case this computer fails, the device has to watch the life counter. When it
is opened, and after a request without an answer, its outputs are read, because it may have kept or changed them, and
are brought to zero from there; until it has answered that, no output is written. A request without an answer ends the
connection, so that the kernel does not send it again later.

A device that restarts ends its connections too. So after a request without an answer the registers of the set-up are
also read: a device that has lost it gives no samples until it is opened again, which sets it up.
"""

from __future__ import annotations

import contextlib
import logging
import math
import socket
import struct
import time
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import pydantic
from pymodbus import ModbusException
from pymodbus.client import ModbusTcpClient

from abrace_core.config_file import read_config
from abrace_core.errors import AbraceError
from abrace_plant.devices.device import DeviceError, Reading, give_up
from abrace_plant.devices.file import (
    Address,
    DeviceFile,
    PortNumber,
    TimeOut,
    check_outputs,
    commands_of,
    load_calibration,
)
from abrace_plant.devices.registers import WIDEST_GAP, Block, RegisterMap, blocks, read_register_map

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from abrace_plant.devices.calibration import Calibration
    from abrace_plant.rig.model import Rig

RAMP_TIME = 0.5
"""Seconds in which the outputs are brought to zero."""
OPEN_TIME = 2.0
"""Seconds that `open` waits for a connection."""
SAFE_TIME = 2.0
"""Seconds for which `make_safe` tries again when requests are not answered; a ramp that has begun then is finished."""
NOT_NOW = (5, 6, 10, 11)
"""Modbus exception codes of a device that is busy, and of a gateway that does not reach it."""
RESET = struct.pack("ii", 1, 0)
"""SO_LINGER: a socket that is closed drops what has not been received."""

# errors are raised; pymodbus would also print them
logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)


class RefusalError(DeviceError):
    """The device answers that it does not allow a request."""


class ModbusFile(DeviceFile):
    """A device file of the kind modbus; `timeout` [s] is how long an answer may take."""

    kind: Literal["modbus"]
    registers: str
    address: Address
    port: PortNumber = 502
    unit: Annotated[int, pydantic.Field(ge=0, le=255)] = 1
    timeout: TimeOut = 0.02


def load(path: Path, rig: Rig) -> ModbusDevice:
    """The device of a device file of the kind modbus, for a `rig`.

    Raises
    ------
    AbraceError
        Naming the file, the key, the value and what was expected.
    """
    file = read_config(path, ModbusFile, "device")
    registers, inputs, outputs = register_blocks(path, file, rig)
    calibration = load_calibration(path, file, rig)

    def taken(values: Sequence[float]) -> NDArray[np.float64]:
        raw = np.array(calibration.outputs(values))
        for block in outputs:
            raw[block.positions] = block.decode(block.encode(raw[block.positions].tolist()))
        return calibration.commanded(raw.tolist())

    check_outputs(path, rig, taken)
    return ModbusDevice(file, registers, inputs, outputs, calibration, rig.sample_rate)


def register_blocks(path: Path, file: ModbusFile, rig: Rig) -> tuple[RegisterMap, list[Block], list[Block]]:
    """The register map of the device `file` at `path`, and its blocks of channels and of commands, for a `rig`.

    Raises
    ------
    AbraceError
        Naming the file, the key, the value and what was expected; a rig that is too fast for the device.
    """
    part_path = path.parent / file.registers
    registers = read_register_map(part_path)
    if rig.sample_rate > registers.highest_rate:
        raise AbraceError(
            f"device file {path}: {registers.name} takes at most {registers.highest_rate:g} samples/s; the sample_rate "
            f"of {rig.name} is {rig.sample_rate:g} Hz, expected a rig file with a lower one"
        )
    try:
        inputs = blocks(registers.inputs, rig.channel_names, registers.word_order, WIDEST_GAP, "inputs")
        outputs = blocks(registers.outputs, commands_of(rig), registers.word_order, 0, "outputs")
    except AbraceError as error:
        raise AbraceError(f"register map file {part_path}: {error}") from error
    return registers, inputs, outputs


class ModbusDevice:
    """A device behind Modbus-TCP.

    Parameters
    ----------
    file
        The device file.
    registers
        The register map.
    inputs, outputs
        Blocks of the channels in the order of a reading, and of the commands U of each group, then w.
    calibration
        Of the channels and of the commands.
    sample_rate
        Hz.

    Attributes
    ----------
    calibration
        May be replaced between two exchanges.
    """

    def __init__(
        self,
        file: ModbusFile,
        registers: RegisterMap,
        inputs: Sequence[Block],
        outputs: Sequence[Block],
        calibration: Calibration,
        sample_rate: float,
    ) -> None:
        self.calibration = calibration
        self._file = file
        self._map = registers
        self._inputs, self._outputs = inputs, outputs
        self._set_up = [Block([(0, setting)], registers.word_order) for setting in registers.set_up]
        self._settings: list[list[int]] = []
        self._restarted = ""
        self._life = Block([(0, registers.life_counter)], registers.word_order) if registers.life_counter else None
        self._period = 1 / sample_rate
        self._name = f"modbus device {registers.name} at {file.address}:{file.port}"
        self._client: Any = None
        self._tick = 0.0
        self._counter = 0
        self._last = [0.0] * calibration.commands
        self._outputs_known = False

    def open(self) -> None:
        """Connect, write the settings, bring the outputs to zero, read once.

        Raises
        ------
        DeviceError
            If it does not answer, or refuses a setting; its outputs are first brought to zero, and if that fails, too,
            the error says so.
        """
        self.close()
        address = str(self._file.address)
        self._client = ModbusTcpClient(address, port=self._file.port, timeout=OPEN_TIME, retries=0)
        if not self._client.connect():
            self._client = None
            raise DeviceError(f"{self._name}: no connection within {OPEN_TIME:g} s")
        self._client.comm_params.timeout_connect = self._file.timeout
        self._last = [0.0] * self.calibration.commands
        self._outputs_known = False
        self._tick = 0.0
        self._restarted = ""
        self.calibration.reset()
        try:
            for block, setting in zip(self._set_up, self._map.set_up, strict=True):
                self._write(block, [setting.value])
            self._settings = self._read_settings()
            self._bring_to_rest()
            self._read()
        except DeviceError as error:
            give_up(self, error)
            raise

    def exchange(self, command: Sequence[float], table: float) -> Reading:
        """Write `command` (groups,) [N] and the `table`'s acceleration [m/s^2]; at the next tick read the channels.

        `missed` counts the ticks that had passed before. After an error the outputs are first brought to zero, and zero
        is written instead.

        Raises
        ------
        DeviceError
            If the device does not answer within the time-out, refuses, or has restarted since it was opened.
        """
        if self._restarted:
            raise DeviceError(self._restarted)
        if self._outputs_known:
            self._command([*command, table])
        else:
            self._bring_to_rest()
            self._check_set_up()
        now = time.monotonic()
        missed = int((now - self._tick) / self._period) if self._tick else 0
        self._tick = self._tick + (missed + 1) * self._period if self._tick else now
        time.sleep(max(0.0, self._tick - time.monotonic()))
        begun = time.time_ns()
        raw = self._read()
        stamp = (begun + time.time_ns()) // 2 - round(1e9 * self.calibration.delay)
        values, clipped = self.calibration.measured(raw)
        return Reading(values, stamp, clipped, missed, time.monotonic() - self._tick)

    def make_safe(self) -> None:
        """Bring the outputs to zero within `RAMP_TIME`; try again, with a new connection, for `SAFE_TIME`.

        Raises
        ------
        DeviceError
            If they could not be brought to zero by then.
        """
        latest = time.monotonic() + SAFE_TIME
        while True:
            try:
                if self._outputs_known:
                    self._ramp_to_zero()
                else:
                    self._bring_to_rest()
                return
            except AbraceError as error:
                if time.monotonic() >= latest:
                    raise DeviceError(
                        f"not made safe within {SAFE_TIME:g} s, its outputs stay as they are unless it watches the "
                        f"life counter: {error}"
                    ) from error
            time.sleep(self._period)

    def close(self) -> None:
        """Disconnect."""
        if self._client is not None:
            self._client.close()
            self._client = None

    def _bring_to_rest(self) -> None:
        """Bring the outputs to zero from where the device has them now, or from the last ones if they cannot be read.

        Raises
        ------
        DeviceError
            If there is no answer; no output has been written if it is missing when they are read.
        """
        raw = np.array(self.calibration.outputs(self._last))
        with contextlib.suppress(RefusalError):
            for block in self._outputs:
                raw[block.positions] = block.decode(self._asked("read", block, count=block.words).registers)
        if np.isfinite(raw).all():
            self._last = self.calibration.commanded(raw.tolist()).tolist()
        self._ramp_to_zero()
        self._outputs_known = True

    def _read_settings(self) -> list[list[int]]:
        """The registers of the set-up as the device has them; none of a setting that it does not allow to be read."""
        found = []
        for block in self._set_up:
            try:
                found.append(list(self._asked("read", block, count=block.words).registers))
            except RefusalError:
                found.append([])
        return found

    def _check_set_up(self) -> None:
        """Raise a DeviceError, now and until it is opened again, if the device has lost its set-up."""
        changed = [
            f"register {block.first} has {block.decode(now)[0]:g} instead of {block.decode(before)[0]:g}"
            for block, before, now in zip(self._set_up, self._settings, self._read_settings(), strict=True)
            if before and now and before != now
        ]
        if changed:
            self._restarted = (
                f"{self._name}: has restarted ({', '.join(changed)}); the next activation sets it up again"
            )
            raise DeviceError(self._restarted)

    def _ramp_to_zero(self) -> None:
        steps = max(1, round(RAMP_TIME / self._period)) if any(self._last) else 1
        start, due = self._last, time.monotonic()
        for step in range(1, steps + 1):
            share = (1 + math.cos(math.pi * step / steps)) / 2
            self._command([share * value for value in start])
            due += self._period
            time.sleep(max(0.0, due - time.monotonic()) if step < steps else 0.0)

    def _command(self, values: Sequence[float]) -> None:
        """Write commands in SI units, and the life counter."""
        outputs = self.calibration.outputs(values)
        for block in self._outputs:
            self._write(block, [outputs[position] for position in block.positions])
        self._last = list(values)
        if self._life is not None:
            self._counter = (self._counter + 1) % (1 << 15)
            self._write(self._life, [self._counter])

    def _read(self) -> NDArray[np.float64]:
        """(channels,) as the device gives them."""
        raw = np.empty(len(self.calibration.channels))
        for block in self._inputs:
            answer = self._asked("read", block, count=block.words)
            raw[block.positions] = block.decode(answer.registers)
        if not np.isfinite(raw).all():
            names = [
                name for name, value in zip(self.calibration.channels, raw, strict=True) if not math.isfinite(value)
            ]
            raise DeviceError(f"{self._name}: {', '.join(names)} not finite")
        return raw

    def _write(self, block: Block, values: Sequence[float]) -> None:
        self._asked("write", block, values=block.encode(values))

    def _asked(self, what: Literal["read", "write"], block: Block, **content: Any) -> Any:
        """The answer to a request; DeviceError if there is none now, RefusalError if the device does not allow it."""
        where = f"{what} registers {block.first} to {block.first + block.words - 1}"
        if self._client is None:
            raise DeviceError(f"{self._name}: {where}: not connected")
        try:
            request = self._client.read_holding_registers if what == "read" else self._client.write_registers
            answer = request(block.first, device_id=self._file.unit, **content)
        except (ModbusException, OSError) as error:
            self._outputs_known = False
            self._drop_connection()
            reason = " ".join(str(error).split()).removeprefix("Modbus Error: ")
            raise DeviceError(
                f"{self._name}: {where}: no answer within {1e3 * self._file.timeout:g} ms ({reason})"
            ) from error
        if answer.isError() and answer.exception_code in NOT_NOW:
            self._outputs_known = False
            raise DeviceError(f"{self._name}: {where}: not possible now ({answer})")
        if answer.isError():
            raise RefusalError(f"{self._name}: {where}: refused ({answer})")
        return answer

    def _drop_connection(self) -> None:
        """Disconnect without sending what is still queued; pymodbus connects again at the next request."""
        if self._client.socket is not None:
            self._client.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
        self._client.close()
