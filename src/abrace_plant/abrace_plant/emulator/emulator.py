# SPDX-License-Identifier: Apache-2.0
"""The emulator: a target that ticks by its own clock behind a port, with faults on demand.

A fault is a text: `loss=0.01` (in both directions), `sample.delay=0.005` or `command.loss=0.2` (in one), `freeze=0.1`
(the target does nothing for so many seconds), `stop=64` (the target stops by itself, for a cause of its own: the bit of
docs/target.md), `a2=stuck` (a sensor, as for the node `plant`). With `@SECONDS` it begins so long after the start.
`loss=0` ends a fault of the link, `clear` ends all but a stop.
"""

from __future__ import annotations

import contextlib
import json
import math
import select
import socket
import time
from dataclasses import fields
from functools import partial
from typing import TYPE_CHECKING, Any

from abrace_core import AbraceError
from abrace_core.files.config_file import read_config
from abrace_plant.devices.c_target import ARMED
from abrace_plant.devices.udp import UdpFile
from abrace_plant.emulator.link import Faults
from abrace_plant.emulator.port import Port
from abrace_plant.emulator.target import Target
from abrace_plant.rig.sensors import parse_fault

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from abrace_plant.emulator.link import Link
    from abrace_plant.rig.model import Rig

LONGEST_CATCH_UP = 0.02
"""Seconds of late ticks whose samples are still sent, one after the other; further ones are missed."""
LINK_FAULTS = tuple(field.name for field in fields(Faults))
FREEZE, STOP = "freeze", "stop"


class Emulator:
    """A rig behind a device file.

    Parameters
    ----------
    path
        Of the device file.
    rig
        The rig; its sample rate is that of the ticks.
    seed
        Of the sensors' noise and of what happens by chance.
    faults
        Texts as above.
    control_port
        UDP port of this computer that takes texts while it runs, and `report`, each answered by a line; 0: none.

    Raises
    ------
    AbraceError
        Naming the file, the key, the value and what was expected; a port that is taken; a fault that there is not.
    """

    def __init__(
        self,
        path: Path,
        rig: Rig,
        seed: int = 0,
        faults: Sequence[str] = (),
        control_port: int = 0,
    ) -> None:
        self._channels = rig.channel_names
        file = read_config(path, UdpFile, "device")
        self.target = Target(rig, seed, file.life_time)
        self.port = Port(path, file, rig, self.target, seed)
        self._later: list[tuple[float, Callable[[], None]]] = []
        self._sensor_faults: dict[str, str] = {}
        self._frozen_until = 0.0
        self._late = 0
        self._worst_late = 0.0
        self._started = time.monotonic()
        self._control: socket.socket | None = None
        try:
            for text in faults:
                self.cause(text)
            if control_port:
                self._control = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                self._control.setblocking(False)
                self._control.bind(("127.0.0.1", control_port))
        except AbraceError:
            self.close()
            raise
        except OSError as error:
            self.close()
            raise AbraceError(f"control port {control_port}: {error.strerror}") from error

    def run(self, stopped: Callable[[], bool], duration: float = math.inf) -> None:
        """Tick until `stopped` says so, or `duration` seconds have passed."""
        period = self.target.period
        self._started = due = time.monotonic()
        listening = [self.port.socket, *([self._control] if self._control else [])]
        while not stopped():
            now = time.monotonic()
            if now - self._started > duration:
                return
            self._cause_what_is_due(now)
            if now < self._frozen_until:
                time.sleep(self._frozen_until - now)
                continue
            self.port.serve(now)
            if now >= due:
                late = now - due
                self._late += late > period
                self._worst_late = max(self._worst_late, late)
                missed = int(late / period) if late > LONGEST_CATCH_UP else 0
                self.target.hold(missed)
                self.port.publish(self.target.step(), now)
                due += (missed + 1) * period
            wait = min([due, *(link.due for link in self.port.links.values())]) - time.monotonic()
            if wait > 0:
                select.select(listening, [], [], wait)
            self._obey()

    def cause(self, text: str) -> None:
        """Let a fault begin, or end, as the `text` says, at once or later; it is checked at once.

        Raises
        ------
        AbraceError
            If there is no such fault, or its value is none that it can have.
        """
        if text == "clear":
            self._clear()
            return
        name, _, rest = text.partition("=")
        value, at, begin = rest.partition("@")
        act = self._checked(text, name, value)
        if at:
            self._later.append((_number(text, begin), act))
        else:
            act()

    def report(self) -> dict[str, Any]:
        """Counts so far, and the greatest steps that reached the actuators."""
        target = self.target
        return {
            "ticks": target.tick + 1,
            "late_ticks": self._late,
            "worst_late": self._worst_late,
            "stops": target.stops,
            "following": target.outputs.state == ARMED,
            "causes": target.outputs.causes,
            "last_arm": target.outputs.last_arm,
            "worst_step": target.worst_step,
            "worst_step_over_rate_limit": target.worst_step_over_rate_limit,
            "worst_table_step": target.worst_table_step,
            "worst_force": target.worst_force,
            "worst_command": target.worst_command,
            "worst_seconds_to_zero": target.worst_seconds_to_zero,
            "dropped": dict(self.port.dropped),
        }

    def close(self) -> None:
        """Close the sockets."""
        self.port.close()
        if self._control is not None:
            self._control.close()

    def _checked(self, text: str, name: str, value: str) -> Callable[[], None]:
        """What lets the fault begin or end; the whole fault has been checked before it is called."""
        if name == FREEZE:
            return partial(self._freeze, _number(text, value))
        if name == STOP:
            return partial(self.target.outputs.stop, _cause(text, value))
        if name in self._channels:
            if value != "well":
                parse_fault(f"{name}={value}", self._channels, self.target.period)
            return partial(self._set_sensor_fault, name, value)
        direction, dot, fault = name.rpartition(".")
        links = [link for key, link in self.port.links.items() if direction == key or not dot]
        if fault not in LINK_FAULTS or not links:
            known = ", ".join([*LINK_FAULTS, FREEZE, STOP, "clear", *self._channels])
            raise AbraceError(f"fault {text!r}: expected NAME=VALUE or NAME=VALUE@SECONDS, the name one of {known}")
        return partial(_set_link_fault, links, fault, _number(text, value))

    def _clear(self) -> None:
        for link in self.port.links.values():
            link.faults = Faults()
        self._sensor_faults.clear()
        self.target.set_sensor_faults([])

    def _freeze(self, seconds: float) -> None:
        self._frozen_until = time.monotonic() + seconds

    def _set_sensor_fault(self, channel: str, kind: str) -> None:
        self._sensor_faults.pop(channel, None)
        if kind != "well":
            self._sensor_faults[channel] = kind
        self.target.set_sensor_faults([f"{name}={kind}" for name, kind in self._sensor_faults.items()])

    def _cause_what_is_due(self, now: float) -> None:
        for entry in [entry for entry in self._later if now - self._started >= entry[0]]:
            self._later.remove(entry)
            entry[1]()

    def _obey(self) -> None:
        """Carry out the requests received at the control port, and answer them."""
        with contextlib.suppress(BlockingIOError):
            while self._control is not None:
                text, sender = self._control.recvfrom(1024)
                try:
                    word = text.decode("utf-8", "replace").strip()
                    answer = json.dumps(self.report()) if word == "report" else ""
                    if not answer:
                        self.cause(word)
                except AbraceError as error:
                    answer = str(error)
                self._control.sendto((answer or "ok").encode(), sender)


def _set_link_fault(links: Sequence[Link], fault: str, value: float) -> None:
    for link in links:
        setattr(link.faults, fault, value)


def _number(text: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not 0 <= number < math.inf:
        raise AbraceError(f"fault {text!r}: {value!r}, expected a number, 0 or more")
    return number


def _cause(text: str, value: str) -> int:
    if not value.isdecimal() or not 1 <= int(value) < 2**32:
        raise AbraceError(f"fault {text!r}: {value!r}, expected a cause, a bit of 32")
    return int(value)
