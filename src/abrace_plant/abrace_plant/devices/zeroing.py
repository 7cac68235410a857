# SPDX-License-Identifier: Apache-2.0
"""Zeroing: the readings of a rig at rest, and the calibration file at which their mean is zero."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError
from abrace_plant.devices.calibration import zeroed

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_plant.devices.calibration import Calibration, CalibrationFile

LIMIT = 0.05
"""Greatest `zero` of a channel, as a share of half its range."""
REST = 0.005
"""Greatest standard deviation, and drift from half to half, of a channel at rest, likewise; noise is a tenth of it."""


class Zeroing:
    """Collects the readings.

    Parameters
    ----------
    calibration
        In use meanwhile.
    which
        Names of the channels to zero; none: all.
    samples
        That are expected.

    Attributes
    ----------
    over
        Set once all have come, or something has acted.

    Raises
    ------
    AbraceError
        If the device has no calibration file, or no channel of such a name.
    """

    def __init__(self, calibration: Calibration, which: Sequence[str], samples: int) -> None:
        check_names(calibration.channels, which)
        if calibration.file is None:
            raise AbraceError("zeroing: the device has no calibration file")
        self._file = calibration.file
        self._channels = calibration.channels
        self._which = tuple(which) or calibration.channels
        self._samples = samples
        self._readings: list[NDArray[np.float64] | Sequence[float]] = []
        self._moved = ""
        self.over = threading.Event()

    def take(self, reading: NDArray[np.float64] | Sequence[float], acting: Sequence[float]) -> None:
        """One sample's `reading` (channels,) in SI units, and all that `acting` on the rig was commanded then."""
        self._readings.append(reading)
        if any(acting):
            self._moved = f"zeroing: a command acts ({', '.join(f'{value:.3g}' for value in acting)})"
        if self._moved or len(self._readings) >= self._samples:
            self.over.set()

    def result(self) -> tuple[CalibrationFile, str]:
        """The new calibration file, and the changes as text.

        Raises
        ------
        AbraceError
            Saying why nothing is zeroed: something acted, samples are missing, or what `zeroed` says.
        """
        if self._moved:
            raise AbraceError(self._moved)
        if len(self._readings) < self._samples:
            raise AbraceError(f"zeroing: only {len(self._readings)} of {self._samples} samples arrived")
        new = zeroed(self._file, self._channels, np.array(self._readings), self._which, LIMIT, REST)
        changes = (
            f"{name} {self._file.channels[name].zero:.6g} to {new.channels[name].zero:.6g}" for name in self._which
        )
        return new, f"zero of each channel: {', '.join(changes)}"


def check_names(channels: Sequence[str], which: Sequence[str]) -> None:
    """Refuse names in `which` that are none of the `channels`.

    Raises
    ------
    AbraceError
        Naming all of them.
    """
    if unknown := [repr(name) for name in which if name not in channels]:
        raise AbraceError(f"zero_channels: no channel {', '.join(unknown)}, expected some of {', '.join(channels)}")
