"""What a rig is made of: something that takes commands, and gives a sample of all its sensors at each of its ticks."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray


class DeviceError(AbraceError):
    """A device that does not do what it is asked for."""


class Reading(NamedTuple):
    """One sample of a device.

    Parameters
    ----------
    values
        (channels,) [displacements, strokes, accelerations, forces, ground acceleration], calibrated, in SI units.
    stamp
        When it was sampled [ns, wall clock].
    clipped
        Bit i: channel i is at the end of its range.
    missed
        Ticks since the last reading that were not answered in time: their samples are lost.
    late
        Whether it was taken a sample period late or more.
    """

    values: NDArray[np.float64]
    stamp: int
    clipped: int
    missed: int
    late: bool = False


class Device(Protocol):
    """A rig's hardware, or what stands for it."""

    def open(self) -> None:
        """Begin; an AbraceError says what is not there."""

    def exchange(self, command: Sequence[float], table: float) -> Reading:
        """Send the commands, wait for the hardware's next tick, and give its sample.

        Parameters
        ----------
        command
            (groups,) force of one brace of each group [N].
        table
            Acceleration of the table [m/s^2].

        Raises
        ------
        DeviceError
            If it fails; it may be tried again.
        """

    def make_safe(self) -> None:
        """Zero force and a table at rest, as far as that is in the device's hand; raises nothing."""

    def close(self) -> None:
        """End."""
