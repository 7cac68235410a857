# SPDX-License-Identifier: Apache-2.0
"""A target that sends and receives one UDP packet a tick: Speedgoat, dSPACE, LabVIEW, Simulink, a custom board.

Every packet is checked; one that is not from the target, incomplete, not finite or not the next sample is
dropped and counted by its name. Samples are used in their order, one for each exchange: after a delay the waiting ones
are processed late, one after the other, unless they are older than the time-out.
"""

from __future__ import annotations

import select
import socket
import time
from collections import Counter, deque
from typing import TYPE_CHECKING, Literal, Self

import numpy as np
import pydantic

from abrace_core import AbraceError
from abrace_core.files.config_file import read_config
from abrace_core.model import signals
from abrace_plant.devices.c_target import ARMED, causes_in_words
from abrace_plant.devices.device import DeviceError, Reading, TargetStatus, Wanted
from abrace_plant.devices.file import (
    Address,
    DeviceFile,
    PortNumber,
    TimeOut,
    commands_of,
    load_calibration,
)
from abrace_plant.devices.layout import Content, Malformed, Packet, read_layout
from abrace_plant.devices.succession import Succession, TargetClock

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from abrace_plant.devices.calibration import Calibration
    from abrace_plant.rig.model import Rig

OPEN_TIME = 2.0
"""Seconds that `open` waits for a target's samples."""
ASKING_PERIOD = 0.01
"""Seconds between the commands that `open` sends, which ask for nothing but a safe target."""
BUFFER = 1 << 20
"""Bytes of packets that the socket buffers, as far as the system allows."""
LARGEST_RESOLUTION = 0.25
"""Of a target's time, in ticks: counter and time have to agree better than to half a tick."""
SLOWER = 10
"""Ticks in a row with more commands on the way than before, after which the link or the target counts as slower."""
LARGEST_ERROR = 0.01
"""Share by which the target may be commanded less, or more, than the greatest force or acceleration of its rig."""
LAST_COMMANDS = 3
"""Packets with which `make_safe` asks for a safe target; several, as packets may be lost."""
TABLE = "table_displacement"
"""Field of a sample with the table's measured displacement [m], where it is measured."""


class UdpFile(DeviceFile):
    """A device file of the kind udp.

    Commands go to `address` and `port`; samples come from `address` and `source_port` (else `port`) to `local_port` of
    `local_address` (else of any of this computer's). `timeout` [s] is how long a sample may stay away; `life_time` [s],
    as set at the target, after how long without a new command it stops by itself.
    """

    kind: Literal["udp"]
    layout: str
    address: Address
    port: PortNumber
    source_port: PortNumber | None = None
    local_address: Address = Address("0.0.0.0")
    local_port: PortNumber
    timeout: TimeOut = 0.02
    life_time: TimeOut = 0.05

    @pydantic.model_validator(mode="after")
    def _target_outlasts_us(self) -> Self:
        if self.timeout >= self.life_time:
            raise ValueError(f"timeout {self.timeout:g} below the target's life_time, {self.life_time:g}")
        return self

    @property
    def sender(self) -> tuple[str, int]:
        """Address and port that samples come from."""
        return str(self.address), self.source_port or self.port


def load(path: Path, rig: Rig) -> UdpDevice:
    """The device of a device file of the kind udp, for a `rig`.

    Raises
    ------
    AbraceError
        Naming the file, the key, the value and what was expected.
    """
    file = read_config(path, UdpFile, "device")
    samples, commands = packets(path, file, rig)
    if samples.resolution > LARGEST_RESOLUTION * 1e9 / rig.sample_rate:
        raise AbraceError(
            f"layout file {path.parent / file.layout}: time in steps of {1e-6 * samples.resolution:g} ms, expected a "
            f"unit that distinguishes ticks of {rig.sample_rate:g} Hz"
        )
    calibration = load_calibration(path, file, rig)
    # a device whose outputs end before the limits of its rig would cut commands without a word
    most = np.array([*rig.capacity, rig.table.peak_acceleration])[: calibration.commands]
    for wanted in (most, -most):
        sent = commands.decode(commands.encode(calibration.outputs(wanted.tolist()), 1)).signals
        for name, one, found in zip(
            commands_of(rig), wanted.tolist(), calibration.commanded(sent).tolist(), strict=True
        ):
            if abs(found - one) > LARGEST_ERROR * abs(one):
                limit = "the table's peak_acceleration" if name == signals.GROUND else "the capacity"
                raise AbraceError(
                    f"device file {path}: command {name}: the device puts out at most {found:g} {signals.unit(name)}, "
                    f"expected {limit}, {one:g}: widen the command's range in the calibration file, or its type"
                )
    return UdpDevice(file, samples, commands, calibration, rig.sample_rate)


def packets(path: Path, file: UdpFile, rig: Rig) -> tuple[Packet, Packet]:
    """The packets of samples and of commands of the device `file` at `path`, for a `rig`.

    Raises
    ------
    AbraceError
        Naming the layout file, the field and what was expected.
    """
    part_path = path.parent / file.layout
    layout = read_layout(part_path)
    names = [name for entry in layout.sample for name in entry.names]
    given = [
        *rig.channel_names,
        *(f"applied_{name}" for name in commands_of(rig)),
        *([TABLE] if TABLE in names else []),
    ]
    try:
        return Packet(layout, "sample", given), Packet(layout, "command", commands_of(rig))
    except AbraceError as error:
        raise AbraceError(f"layout file {part_path}: {error}") from error


class UdpDevice:
    """A target behind UDP.

    Parameters
    ----------
    file
        The device file.
    samples
        Packet of a sample: its signals in the order of a reading, the outputs as applied, and the table's displacement
        where that is measured.
    commands
        Packet of a command, its signals U of each group, then w.
    calibration
        Of the channels and of the commands.
    sample_rate
        Of the target's ticks [Hz].

    Attributes
    ----------
    file
        As given.
    calibration
        May be replaced between two exchanges.
    samples
        Good samples that came since `open`.
    commands_late
        Commands since then that were late or lost on the way, as far as the target's samples tell.
    dropped
        Packets that were not used since then, by the name of what was wrong with them.
    """

    def __init__(
        self, file: UdpFile, samples: Packet, commands: Packet, calibration: Calibration, sample_rate: float
    ) -> None:
        self.calibration = calibration
        self.samples = self.commands_late = 0
        self.dropped: Counter[str] = Counter()
        self.file = file
        self._name = f"udp device {file.address}:{file.port}"
        self._sender, self._to = file.sender, (str(file.address), file.port)
        self._samples, self._commands = samples, commands
        self._echo = min(commands.modulus, samples.echo_modulus)
        self._still = [0.0] * calibration.commands
        self._period = 1e9 / sample_rate
        self._allowed = max(2, round(file.timeout * sample_rate))
        self._order = Succession(samples.modulus, self._period)
        self._socket: socket.socket | None = None
        self._counter = self._ticks = self._stamp = 0
        self._exchanged = 0.0
        self._last_outputs: list[float] = []

    def open(self) -> None:
        """Bind the socket and wait until two samples follow each other; commands say that they are not to be followed.

        Raises
        ------
        AbraceError
            If the port is taken.
        DeviceError
            If no good samples come: with what came instead.
        """
        self.close()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER)
            self._socket.bind((str(self.file.local_address), self.file.local_port))
        except OSError as error:
            where = f"{self.file.local_address}:{self.file.local_port}"
            self.close()
            raise AbraceError(f"{self._name}: cannot receive at {where}: {error.strerror}") from error
        self._socket.setblocking(False)
        self._poll = select.poll()
        self._poll.register(self._socket, select.POLLIN)
        self._counter = 0
        self._last_outputs = self.calibration.outputs(self._still)
        self.samples = self.commands_late = 0
        self.dropped.clear()
        self._begin()
        end = time.monotonic() + OPEN_TIME
        try:
            while self._order.ticks == 0:
                if time.monotonic() > end:
                    found = self._found_instead(self.dropped)
                    raise DeviceError(f"{self._name}: no valid samples within {OPEN_TIME:g} s; {found}")
                self._send(Wanted.SAFE, 0)
                self._next(time.monotonic() + ASKING_PERIOD, newest=True)
        except DeviceError:
            self.close()
            raise

    def exchange(self, command: Sequence[float], table: float, wanted: Wanted, arm: int) -> Reading:
        """Send `command` (groups,) [N] and the `table`'s acceleration [m/s^2]; wait for the target's next sample.

        Of samples that have arrived already the oldest is taken that is not stale. `missed` counts those that were
        stale or lost on the way. After a pause longer than the time-out the newest one is taken. `wanted` and
        `arm` are as in `Device`.

        Raises
        ------
        DeviceError
            If no sample comes within the time-out, or the target has applied no command for so long while it shall
            follow.
        """
        before = self.dropped.copy()
        self._last_outputs = self.calibration.outputs([*command, table][: self.calibration.commands])
        begun = time.monotonic()
        self._send(wanted, arm)
        paused = begun - self._exchanged > self.file.timeout
        if paused or wanted is not Wanted.FOLLOW:
            self._heard = begun
        self._exchanged = begun
        content = self._next(begun + self.file.timeout, newest=paused)
        if content is None:
            found = self._found_instead(self.dropped - before)
            self._begin()
            raise DeviceError(f"{self._name}: no sample for {1e3 * self.file.timeout:g} ms; {found}")
        if time.monotonic() - self._heard > self.file.timeout and content.state == ARMED:
            self._exchanged = 0.0
            raise DeviceError(f"{self._name}: has applied no command for {1e3 * self.file.timeout:g} ms")
        armed = content.state == ARMED
        channels, commands = len(self.calibration.channels), self.calibration.commands
        values, clipped = self.calibration.measured(np.array(content.signals[:channels], dtype=np.float64))
        target = TargetStatus(
            content.arm if armed else 0,
            content.arm,
            "" if armed else causes_in_words(content.causes),
            self.calibration.commanded(content.signals[channels : channels + commands]).tolist(),
            content.signals[-1] if len(content.signals) > channels + commands else None,
        )
        applied = self._applied(content) if wanted is Wanted.FOLLOW and armed else (True, 0)
        return Reading(values, self._stamp, clipped, self._ticks - 1, target, self._age, *applied)

    def make_safe(self) -> None:
        """Tell the target to bring force and table to rest along its own ramp, and send nothing more.

        Raises
        ------
        DeviceError
            If nothing can be sent.
        """
        try:
            for _ in range(LAST_COMMANDS):
                self._send(Wanted.SAFE, 0)
        except DeviceError as error:
            raise DeviceError(f"not made safe, the target has to watch the life counter: {error}") from error

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def counters(self) -> dict[str, int]:
        """Good samples since `open`, commands that were late, and dropped packets by name."""
        counts = {"samples": self.samples, "commands_late": self.commands_late}
        return counts | {f"dropped_{name}": count for name, count in sorted(self.dropped.items())}

    def _begin(self) -> None:
        """Take the next samples that follow each other, whatever their counter and time."""
        self._order.reset()
        self._clock = TargetClock()
        self._exchanged = self._heard = 0.0
        self._used = time.monotonic_ns()
        self._last_echo = -1
        self._usual, self._slower = self._echo, 0
        self._waiting: deque[tuple[Content, int, int, float]] = deque()
        self._stamp = self._newest = self._since = self._ticks = 0
        self._age = 0.0
        self.calibration.reset()

    def _send(self, wanted: Wanted, arm: int) -> None:
        if self._socket is None:
            raise DeviceError(f"{self._name}: not open")
        self._counter += 1
        packet = self._commands.encode(self._last_outputs, self._counter, time.time_ns(), arm, wanted)
        try:
            self._socket.sendto(packet, self._to)
        except BlockingIOError:
            self.dropped["not_sent"] += 1
        except OSError as error:
            raise DeviceError(f"{self._name}: cannot send: {error.strerror}") from error

    def _next(self, deadline: float, newest: bool) -> Content | None:
        """The next good sample, or the newest that has arrived, as soon as one is there; None at the deadline [s]."""
        self._ticks = 0
        while True:
            self._look(deadline)
            while self._waiting:
                content, stamp, ticks, taken = self._waiting.popleft()
                self._ticks += ticks
                age = time.monotonic_ns() - taken
                if age > 1e9 * self.file.timeout:
                    self.dropped["stale"] += 1
                elif not (newest and self._waiting):
                    self.samples += 1
                    self._stamp, self._age = stamp, 1e-9 * age
                    return content
            wait = deadline - time.monotonic()
            if wait <= 0:
                return None
            self._poll.poll(1e3 * wait)

    def _look(self, deadline: float) -> None:
        """Check every packet that has arrived, in a flood only until the deadline [s]."""
        assert self._socket is not None
        receive, size = self._socket.recvfrom, self._samples.length + 1
        while True:
            try:
                packet, sender = receive(size)
            except BlockingIOError:
                return
            except OSError as error:
                raise DeviceError(f"{self._name}: cannot receive: {error.strerror}") from error
            try:
                self._judge(packet, sender)
            except Malformed as fault:
                self.dropped[str(fault)] += 1
            if time.monotonic() >= deadline:
                return

    def _judge(self, packet: bytes, sender: tuple[str, int]) -> None:
        """Keep the packet's values with its stamp and the ticks since the last good one, if it may be used."""
        if sender != self._sender:
            raise Malformed("other_sender")
        content = self._samples.decode(packet)
        now, wall = time.monotonic_ns(), time.time_ns()
        longest = self._allowed + int((now - self._used) / self._period)
        self._since += self._order.advance(content.counter, content.time, longest)
        self._used = now
        age = float(wall - content.time) if self._samples.wall_clock else self._clock.age(content.time, now)
        if abs(age) > 1e9 * self.file.timeout:
            raise Malformed("stale")
        stamp = wall - round(age + 1e9 * self.calibration.delay)
        # stamps grow, unless this computer's clock was set back
        was_set_back = self._newest - stamp > 1e9 * self.file.timeout
        self._newest = stamp if was_set_back else max(stamp, self._newest + 1)
        self._waiting.append((content, self._newest, self._since, now - age))
        self._since = 0
        if content.applied_counter != self._last_echo:
            behind = (self._counter - content.applied_counter) % self._echo
            if behind <= self._allowed:
                self._last_echo, self._heard = content.applied_counter, time.monotonic()

    def _applied(self, content: Content) -> tuple[bool, int]:
        """Whether at this sample's tick no more commands were on the way than usual, and how many usually are."""
        behind = (self._counter - content.applied_counter) % self._echo
        if behind > self._usual:
            self.commands_late += 1
            self._slower += 1
            if self._slower <= SLOWER:
                return False, self._usual
        self._usual, self._slower = behind, 0
        return True, behind

    def _found_instead(self, dropped: Counter[str]) -> str:
        """A text that lists what was received and not used."""
        if not dropped:
            return f"nothing arrived from {self._sender[0]}:{self._sender[1]} to port {self.file.local_port}"
        names = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in dropped.most_common())
        expected = f"packets of {self._samples.length} bytes, {1e-6 * self._period:g} ms apart, were expected"
        return f"dropped: {names} ({expected})"
