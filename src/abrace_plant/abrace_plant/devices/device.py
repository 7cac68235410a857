# SPDX-License-Identifier: Apache-2.0
"""The interface to a rig's hardware: a device takes one command and gives one reading at every tick of its hardware."""

from __future__ import annotations

import contextlib
import threading
from enum import IntEnum
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


class DeviceError(AbraceError):
    """The hardware fails: the message names the device, what was missing, and for how long."""


class Wanted(IntEnum):
    """What the rig wants of its target, which makes commands act and has a state machine and watchdog of its own."""

    SAFE = 0
    """Outputs to rest along the target's own ramp, then its brake or valve acts. The arm number is void."""
    HOLD_ZERO = 1
    """Powered, outputs at zero. A new arm number, `TargetStatus.last_arm` + 1, arms the target."""
    FOLLOW = 2
    """Outputs follow the commands, as long as the target is armed with this number."""


class TargetStatus(NamedTuple):
    """What the target reports of itself at one tick."""

    armed: int
    """The arm number that it follows; 0: none, it is disarmed or stopping."""
    last_arm: int
    """The last number that it has accepted: an old packet arms nothing."""
    cause: str
    """Why it has stopped; empty: it has not."""
    applied: list[float]
    """Outputs at this tick: the force of one brace of each group [N], the table's acceleration [m/s^2]."""
    table: float | None = None
    """Measured displacement of the table [m]; None: nobody measures it."""


class Reading(NamedTuple):
    """What a device measured at one tick."""

    values: NDArray[np.float64]
    """(channels,) in SI units, calibrated: [displacements, strokes, accelerations, forces, ground acceleration]."""
    stamp: int
    """Sampling instant by the wall clock [ns]."""
    clipped: int
    """Bit i is set where channel i is at the end of its range."""
    missed: int
    """Ticks of the hardware since the last reading that were not answered in time."""
    target: TargetStatus
    """The target at that tick."""
    age: float = 0.0
    """Seconds since that tick. Its answers have so much less time; at a sample period or more the reading is late."""
    command_applied: bool = True
    """False: the target had not applied the latest command at this tick: it was late, or lost. It is sent again, since
    two changes would be one step at the next tick."""
    commands_in_flight: int = 0
    """Commands before the latest that the target may not have applied yet, where it needs more ticks or a link delays.
    The next command is within the rate limit of each of them, as it may arrive together with them."""


class Device(Protocol):
    """The hardware of a rig. One thread calls all of it."""

    def open(self) -> None:
        """Connect; the device does not move yet, but outputs that are not at zero are ramped there.

        Raises
        ------
        AbraceError
            If it is not there, or cannot be used: it is closed, and made safe before that as far as it was reached.
        """
        ...

    def exchange(self, command: Sequence[float], table: float, wanted: Wanted, arm: int) -> Reading:
        """Send a command and wait for the hardware's next tick.

        Parameters
        ----------
        command
            (groups,) force of one brace of each group [N].
        table
            The table's acceleration [m/s^2].
        wanted, arm
            What the target shall do, and the arm number.

        Raises
        ------
        DeviceError
            If the device fails or does not answer in time.
        """
        ...

    def make_safe(self) -> None:
        """Bring force to zero and the table to rest, as far as the device can.

        Raises
        ------
        DeviceError
            If it could not: with what the hardware does now. The process then ends with exit code 1.
        """
        ...

    def close(self) -> None:
        """Disconnect."""
        ...


def exchange(
    device: Device, names: Sequence[str], command: Sequence[float], table: float, wanted: Wanted, arm: int
) -> Reading:
    """One exchange with a `device` of a rig with channels of these `names`, whose reading is checked.

    `command`, `table`, `wanted` and `arm` are as in `Device`.

    Raises
    ------
    DeviceError
        If the device fails.
    AbraceError
        If what it gives is no `Reading` of these channels: its program is wrong, and breaks off the run.
    """
    reading = device.exchange(command, table, wanted, arm)
    if problem := _problem(reading, names):
        raise AbraceError(f"{type(device).__name__.lower()}: {problem}")
    return reading


def _problem(reading: object, names: Sequence[str]) -> str:
    """Why what a device has given is no reading of the channels with these `names`; empty: it is one."""
    if not isinstance(reading, Reading):
        return f"exchange gave {reading!r:.40}, expected a Reading"
    values = reading.values
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu":
        return f"values {values!r:.40}, expected a NumPy array of numbers"
    if problem := shape_problem(values, names):
        return problem
    if not isinstance(reading.target, TargetStatus):
        return f"target {reading.target!r:.40}, expected a TargetStatus"
    for name in ("stamp", "clipped", "missed", "commands_in_flight"):
        number = getattr(reading, name)
        if not isinstance(number, (int, np.integer)) or number < 0:
            return f"{name} {number!r:.40}, expected a whole number, at least 0"
    return ""


def shape_problem(values: NDArray[Any], names: Sequence[str]) -> str:
    """Why `values` are not one for each of these `names`; empty: they are."""
    if values.shape == (len(names),):
        return ""
    count = f"{len(values)} values" if values.ndim == 1 else f"values of shape {values.shape}"
    return f"{count}, expected {len(names)}: {', '.join(names)}"


OPEN_TIME = 5.0
"""Seconds that a device may take to open."""


def open_device(device: Device) -> None:
    """Open a `device`; one that raises anything but an AbraceError is made safe and closed.

    Raises
    ------
    Exception
        What `open` raised; a DeviceError if it has not returned within OPEN_TIME. Where it returns after all, the
        device is made safe and closed.
    """
    ended = threading.Condition()
    outcome: list[BaseException | None] = []
    given_up = False

    def act() -> None:
        error: BaseException | None = None
        try:
            device.open()
        except BaseException as raised:
            error = raised
        with ended:
            outcome.append(error)
            ended.notify()
        if given_up and error is None:
            with contextlib.suppress(Exception):  # nobody is left to hear it
                device.make_safe()
            device.close()

    threading.Thread(target=act, name="open", daemon=True).start()
    with ended:
        if not ended.wait_for(lambda: outcome, OPEN_TIME):
            given_up = True
            raise DeviceError(f"the device has not opened within {OPEN_TIME:g} s")
    (error,) = outcome
    if error is not None:
        if not isinstance(error, AbraceError):
            make_safe_and_close(device, error)
        raise error


def make_safe_and_close(device: Device, error: BaseException) -> None:
    """Make a `device` safe and close it after an `error`, which is then raised again.

    Raises
    ------
    DeviceError
        Of both, if it could not be made safe.
    """
    try:
        device.make_safe()
    except DeviceError as unsafe:
        raise DeviceError(f"{error}; {unsafe}") from error
    finally:
        device.close()
