# SPDX-License-Identifier: Apache-2.0
"""Velocity, displacement and intensity measures of a recorded or played ground motion.

The acceleration is taken to be linear between samples, from rest at the first. Velocity and displacement are the exact
integrals of that. The integrals of a^2 and |a| are by the trapezoidal rule, which for a^2 of a band-limited motion is
exact except at the ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_plant.records.record import check_record

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_plant.records.record import Record

STANDARD_GRAVITY = 9.80665
"""g [m/s^2]."""
SIGNIFICANT = (0.05, 0.95)
"""Shares of the Arias intensity between which D5-95 lies."""


@dataclass(frozen=True)
class Intensity:
    """Intensity measures of a motion; the peaks are the greatest absolute values at a sample.

    Parameters
    ----------
    peak_acceleration, peak_velocity, peak_displacement
        PGA [m/s^2], PGV [m/s] and PGD [m].
    arias_intensity
        pi / (2 g) times the integral of the squared acceleration [m/s] (Arias, 1970).
    cumulative_absolute_velocity
        CAV, the integral of the absolute acceleration [m/s] (EPRI NP-5930, 1988).
    significant_from, significant_to
        Times after the first sample at which 5 % and 95 % of the Arias intensity are reached [s] (Trifunac and Brady,
        1975).
    """

    peak_acceleration: float
    peak_velocity: float
    peak_displacement: float
    arias_intensity: float
    cumulative_absolute_velocity: float
    significant_from: float
    significant_to: float

    @property
    def significant_duration(self) -> float:
        """D5-95 [s]."""
        return self.significant_to - self.significant_from


def integrate(
    acceleration: NDArray[np.float64], sample_period: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Velocity and displacement, from rest, of an acceleration that is linear between samples.

    Parameters
    ----------
    acceleration
        (samples, ...) [m/s^2].
    sample_period
        [s].

    Returns
    -------
    tuple
        Velocity [m/s] and displacement [m], each shaped as the acceleration.
    """
    velocity, displacement = np.zeros_like(acceleration), np.zeros_like(acceleration)
    begin, end = acceleration[:-1], acceleration[1:]
    np.cumsum(sample_period / 2 * (begin + end), axis=0, out=velocity[1:])
    step = sample_period * velocity[:-1] + sample_period**2 / 6 * (2 * begin + end)
    np.cumsum(step, axis=0, out=displacement[1:])
    return velocity, displacement


def husid(acceleration: NDArray[np.float64], sample_period: float) -> NDArray[np.float64]:
    """Build-up of the Arias intensity, as drawn in a Husid plot.

    Parameters
    ----------
    acceleration
        (samples,) [m/s^2].
    sample_period
        [s].

    Returns
    -------
    NDArray
        (samples,) [m/s]; the last is the Arias intensity.
    """
    square = acceleration**2
    built_up = np.zeros_like(square)
    np.cumsum(sample_period / 2 * (square[:-1] + square[1:]), out=built_up[1:])
    return np.pi / (2 * STANDARD_GRAVITY) * built_up


def intensity(motion: Record) -> Intensity:
    """The intensity measures of a motion.

    Parameters
    ----------
    motion
        Recorded or played.

    Raises
    ------
    AbraceError
        As in `check_record`.
    """
    check_record(motion)
    period = motion.sample_period
    size = np.abs(motion.acceleration)
    velocity, displacement = integrate(motion.acceleration, period)
    built_up = husid(motion.acceleration, period)
    begin, end = (_moment(built_up, share, period) for share in SIGNIFICANT)
    return Intensity(
        peak_acceleration=float(size.max()),
        peak_velocity=float(np.abs(velocity).max()),
        peak_displacement=float(np.abs(displacement).max()),
        arias_intensity=float(built_up[-1]),
        cumulative_absolute_velocity=float(period * (size.sum() - (size[0] + size[-1]) / 2)),
        significant_from=begin,
        significant_to=end,
    )


def _moment(built_up: NDArray[np.float64], share: float, period: float) -> float:
    """Time at which a share of the build-up is reached [s], interpolated linearly; 0 for a motion of zeros."""
    level = share * built_up[-1]
    after = int(np.argmax(built_up >= level))
    if after == 0:
        return 0.0
    before = after - 1
    return float(before + (level - built_up[before]) / (built_up[after] - built_up[before])) * period
