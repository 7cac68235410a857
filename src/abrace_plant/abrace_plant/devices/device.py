# SPDX-License-Identifier: Apache-2.0
"""The interface to a rig's hardware: a device takes one command and gives one reading at every tick of its hardware."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray


class DeviceError(AbraceError):
    """The hardware fails: the message names the device, what was missing, and for how long."""


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
    age: float = 0.0
    """Seconds since that tick. Its answers have so much less time; at a sample period or more the reading is late."""
    taken: bool = True
    """False: a command was late for that tick, or lost on the way. The next one is then the last one again, since two
    changes would be one step at the next tick."""
    on_the_way: int = 0
    """How many of the last commands may not have acted at that tick where `taken`: a target or link needs as many ticks
    more. The next one is within the rate limit of each of them, as it may arrive together with them."""


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

    def exchange(self, command: Sequence[float], table: float) -> Reading:
        """Send a command and wait for the hardware's next tick.

        Parameters
        ----------
        command
            (groups,) force of one brace of each group [N].
        table
            The table's acceleration [m/s^2].

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


def give_up(device: Device, error: BaseException) -> None:
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
