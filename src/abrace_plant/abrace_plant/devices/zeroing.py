# SPDX-License-Identifier: Apache-2.0
"""Zeroing: the readings of a rig at rest, and the calibration with which their mean is zero."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_core.model import signals
from abrace_plant.devices.calibration import si_gain

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_plant.devices.calibration import Calibration

LIMIT = 0.05
"""Greatest `zero` of a channel, as a share of half its range: several zeroings do not add up to more."""
REST = 0.005
"""Greatest standard deviation, and drift from half to half, of a channel at rest, likewise; noise is a tenth of it."""


class Zeroing:
    """Collects the readings.

    Parameters
    ----------
    calibration
        In use meanwhile, with its file.
    which
        Names of the channels to zero; none: all.
    samples
        That are expected.

    Attributes
    ----------
    over
        Set once all have come, or something has acted.
    """

    def __init__(self, calibration: Calibration, which: Sequence[str], samples: int) -> None:
        self._calibration = calibration
        self._which = tuple(which) or calibration.channels
        self._samples = samples
        self._readings: list[Sequence[float]] = []
        self._moved = ""
        self.over = threading.Event()

    def take(self, reading: Sequence[float], acting: Sequence[float]) -> None:
        """One sample's `reading` (channels,) in SI units, and all that `acting` on the rig was commanded then."""
        self._readings.append(reading)
        if any(acting):
            self._moved = f"zeroing: a command acts ({', '.join(f'{value:.3g}' for value in acting)})"
        if self._moved or len(self._readings) >= self._samples:
            self.over.set()

    def result(self) -> tuple[Calibration, str]:
        """The calibration by which the mean of the readings is zero, and the changes as text.

        Raises
        ------
        AbraceError
            Saying why nothing is zeroed: something acted, samples are missing, or every channel that is not at rest or
            too far from zero.
        """
        if self._moved:
            raise AbraceError(self._moved)
        if len(self._readings) < self._samples:
            raise AbraceError(f"zeroing: only {len(self._readings)} of {self._samples} samples arrived")
        values, file = np.array(self._readings, dtype=np.float64), self._calibration.file
        assert file is not None
        new, changes, refused, half = dict(file.channels), [], [], self._samples // 2
        for name in self._which:
            column, old = values[:, self._calibration.channels.index(name)], file.channels[name]
            size = si_gain(name, old)
            half_range = size * (old.range[1] - old.range[0]) / 2
            motion = max(float(column.std()), abs(float(column[half:].mean() - column[:half].mean())))
            zero = float(column.mean()) + old.sign * size * old.zero
            unit = signals.unit(name)
            if not motion <= REST * half_range:
                refused.append(f"{name} is not at rest ({motion:.3g} {unit}, expected at most {REST * half_range:.3g})")
            elif abs(zero) > LIMIT * half_range:
                most = f"expected at most {LIMIT * half_range:.3g}"
                refused.append(f"{name} is {zero:.3g} {unit} from its calibrated offset, {most}")
            else:
                new[name] = old.model_copy(update={"zero": old.sign * zero / size})
                changes.append(f"{name} {old.zero:.6g} to {new[name].zero:.6g}")
        if refused:
            raise AbraceError(f"zeroing: {'; '.join(refused)}")
        used = self._calibration.with_file(file.model_copy(update={"channels": new}))
        return used, f"zero of each channel: {', '.join(changes)}"


def check_names(channels: Sequence[str], which: Sequence[str]) -> None:
    """Refuse names in `which` that are none of the `channels`.

    Raises
    ------
    AbraceError
        Naming all of them.
    """
    if unknown := [repr(name) for name in which if name not in channels]:
        raise AbraceError(f"zero_channels: no channel {', '.join(unknown)}, expected some of {', '.join(channels)}")
