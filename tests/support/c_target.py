# SPDX-License-Identifier: Apache-2.0
"""The C target, compiled and driven through ctypes; its packets, made by hand."""

from __future__ import annotations

import ctypes
import os
import shlex
import struct
import subprocess
import zlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from source_tree import ROOT

from abrace_plant.devices.c_target import Settings, TargetStruct

if TYPE_CHECKING:
    from pathlib import Path

SOURCES = ROOT / "targets/c99"
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2", f"-I{SOURCES}")

DISARMED, ARMED, STOPPING = 0, 1, 2
SAFE, HOLD_ZERO, FOLLOW = 0, 1, 2
RESTARTED, ASKED, NO_COMMANDS, OTHER_ARM, BAD_COMMAND, MISSED_TICKS, OWN_LIMIT, EMERGENCY_STOP = (
    1 << k for k in range(8)
)
OBEYED, REFUSED, REPEATED, OLD, NOT_FINITE, WRONG_LENGTH, WRONG_CRC, WRONG_CONSTANT = range(8)


def compiled(output: Path, *sources: Path, flags: tuple[str, ...] = ()) -> Path:
    """What the C `sources` become with every warning an error."""
    compiler = shlex.split(os.environ.get("CC", "cc"))
    subprocess.run([*compiler, *STRICT, *flags, "-o", str(output), *map(str, sources), "-lm"], check=True)
    return output


def target_library(folder: Path) -> ctypes.CDLL:
    """The target as a shared library."""
    library = ctypes.CDLL(str(compiled(folder / "target.so", SOURCES / "abrace_target.c", flags=("-shared", "-fPIC"))))
    library.abrace_target_sample.restype = ctypes.c_size_t
    return library


def target_program(folder: Path) -> Path:
    """The target with its port for Linux, as a program."""
    return compiled(folder / "target", SOURCES / "port_linux_udp.c", SOURCES / "abrace_target.c")


def command_packet(counter: int, arm: int, wanted: int, outputs: list[float]) -> bytes:
    """A command as docs/target.md describes it."""
    body = struct.pack(f"<IIIII{len(outputs)}d", 0x41425232, 2, counter % 2**32, arm % 2**32, wanted, *outputs)
    return body + struct.pack("<I", zlib.crc32(body))


class Sample:
    """A sample, read as docs/target.md describes it."""

    def __init__(self, packet: bytes, groups: int, table_measured: bool) -> None:
        count = (len(packet) - 40) // 8
        *head, crc = struct.unpack(f"<IIIQIIII{count}dI", packet)
        assert zlib.crc32(packet[:-4]) == crc
        assert head[:2] == [0x41425231, 2]
        self.counter, self.time, self.state, self.causes, self.arm, self.applied_counter = head[2:8]
        values = head[8:]
        self.applied = values[: groups + 1]
        self.table = values[groups + 1] if table_measured else None
        self.measured = values[groups + 1 + table_measured :]


@dataclass
class Rig:
    """Settings of the tests: round numbers."""

    period: float = 0.002
    life_time: float = 0.05
    ramp_time: float = 0.1
    capacity: tuple[float, ...] = (1000.0, 500.0)
    rate_limit: tuple[float, ...] = (1e5, 5e4)
    table_acceleration: float = 10.0
    table_jerk: float = 2000.0
    channels: int = 3
    table_driven: int = 1
    table_measured: int = 1
    last_arm: int = 0


@dataclass
class CTarget:
    """A target in C with a bridge that counts its commands."""

    library: ctypes.CDLL
    rig: Rig = field(default_factory=Rig)

    def __post_init__(self) -> None:
        self.counter = 0
        self.c = TargetStruct()
        assert self.initial() == 0

    def initial(self) -> int:
        """What the target says of its settings; it begins."""
        rig = vars(self.rig)
        settings = Settings(groups=len(self.rig.capacity))
        for name, value in rig.items():
            if isinstance(value, tuple):
                getattr(settings, name)[: len(value)] = value
            else:
                setattr(settings, name, value)
        return int(self.library.abrace_target_init(ctypes.byref(self.c), ctypes.byref(settings)))

    def command(
        self, wanted: int, arm: int, outputs: tuple[float, ...] = (0.0, 0.0, 0.0), counter: int | None = None
    ) -> int:
        """What has become of a command, the next one unless `counter` says which."""
        if counter is None:
            counter = self.counter = self.counter + 1
        values = (ctypes.c_double * len(outputs))(*outputs)
        numbers = (ctypes.c_uint32(each % 2**32) for each in (counter, arm, wanted))
        return int(self.library.abrace_target_command(ctypes.byref(self.c), *numbers, values))

    def receive(self, packet: bytes) -> int:
        """What has become of a packet."""
        return int(self.library.abrace_target_receive(ctypes.byref(self.c), packet, ctypes.c_size_t(len(packet))))

    def stop(self, cause: int) -> None:
        """A stop of the target's own."""
        self.library.abrace_target_stop(ctypes.byref(self.c), ctypes.c_uint32(cause))

    def force(self, forces: tuple[float, ...], margin: float) -> int:
        """What has become of the forces of a law on the target."""
        values = (ctypes.c_double * len(forces))(*forces)
        return int(self.library.abrace_target_force(ctypes.byref(self.c), values, ctypes.c_double(margin)))

    def tick(self, ticks: int = 1) -> list[float]:
        """The outputs at the next tick."""
        self.library.abrace_target_tick(ctypes.byref(self.c), ctypes.c_uint32(ticks))
        return self.applied

    def sample(self, time: int = 0, table: float = 0.0, measured: tuple[float, ...] = (0.0, 0.0, 0.0)) -> bytes:
        """The packet of this tick."""
        packet = ctypes.create_string_buffer(700)
        values = (ctypes.c_double * len(measured))(*measured)
        length = self.library.abrace_target_sample(
            ctypes.byref(self.c), ctypes.c_uint64(time), ctypes.c_double(table), values, packet
        )
        return packet.raw[:length]

    def follow(self, outputs: tuple[float, ...], ticks: int = 1) -> list[float]:
        """The outputs after `ticks` ticks with a command of the accepted arm number in each."""
        for _ in range(ticks):
            self.command(FOLLOW, self.c.last_arm, outputs)
            self.tick()
        return self.applied

    def arm(self) -> None:
        """Arm with the next number."""
        assert self.command(HOLD_ZERO, self.c.last_arm + 1) == OBEYED
        self.tick()

    @property
    def applied(self) -> list[float]:
        """Outputs of this tick."""
        return list(self.c.applied[: len(self.rig.capacity) + 1])

    @property
    def state(self) -> int:
        """DISARMED, ARMED or STOPPING."""
        return int(self.c.state)
