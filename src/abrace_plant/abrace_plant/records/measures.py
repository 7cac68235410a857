# SPDX-License-Identifier: Apache-2.0
"""Velocity, displacement, intensity measures and response spectra of a recorded or played ground motion.

The acceleration is linear between samples, from rest at the first. Velocity and displacement are the exact integrals of
that; an oscillator's response is advanced exactly from sample to sample (Nigam and Jennings, 1969). The integrals of
a^2 and |a| are by the trapezoidal rule, which for a^2 of a band-limited motion is exact except at the ends.

eqsig computes the same spectra (the tests compare them, to 1e-7) with a loop in Python over the samples: 20 to 40 times
as long.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_plant.records.record import check_record

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_plant.records.record import Record

STANDARD_GRAVITY = 9.80665
"""g [m/s^2]."""
SIGNIFICANT = (0.05, 0.95)
"""Shares of the Arias intensity between which D5-95 lies."""
PERIODS = np.geomspace(0.05, 5.0, 121)
"""Natural periods [s] of a spectrum that is drawn."""
DAMPING_RATIOS = (0.02, 0.05, 0.10)
"""Of a spectrum that is drawn."""
STEPS_PER_PERIOD = 40
"""Least number of steps per natural period: a peak in between is at most 0.3 % higher. Longer steps are divided."""


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


@dataclass(frozen=True)
class ResponseSpectrum:
    """Greatest absolute responses while the motion lasts.

    Parameters
    ----------
    periods
        (periods,) natural periods [s].
    damping_ratios
        (ratios,) of critical damping.
    displacement, velocity
        (ratios, periods) relative to the ground [m] and [m/s].
    """

    periods: NDArray[np.float64]
    damping_ratios: NDArray[np.float64]
    displacement: NDArray[np.float64]
    velocity: NDArray[np.float64]

    @property
    def pseudo_acceleration(self) -> NDArray[np.float64]:
        """(ratios, periods) omega^2 times the displacement [m/s^2]."""
        return self.displacement * (2 * np.pi / self.periods) ** 2


def integrate(
    acceleration: NDArray[np.float64], sample_period: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Velocity [m/s] and displacement [m] from rest, each shaped as the acceleration.

    Parameters
    ----------
    acceleration
        (samples, ...) [m/s^2].
    sample_period
        [s].
    """
    velocity, displacement = np.zeros_like(acceleration), np.zeros_like(acceleration)
    begin, end = acceleration[:-1], acceleration[1:]
    np.cumsum(sample_period / 2 * (begin + end), axis=0, out=velocity[1:])
    step = sample_period * velocity[:-1] + sample_period**2 / 6 * (2 * begin + end)
    np.cumsum(step, axis=0, out=displacement[1:])
    return velocity, displacement


def husid(acceleration: NDArray[np.float64], sample_period: float) -> NDArray[np.float64]:
    """(samples,) build-up of the Arias intensity [m/s] of an acceleration (samples,) [m/s^2]; `sample_period` in s."""
    square = acceleration**2
    built_up = np.zeros_like(square)
    np.cumsum(sample_period / 2 * (square[:-1] + square[1:]), out=built_up[1:])
    return np.pi / (2 * STANDARD_GRAVITY) * built_up


def intensity(motion: Record) -> Intensity:
    """The intensity measures of a recorded or played `motion`; an AbraceError as in `check_record`."""
    check_record(motion)
    period, size = motion.sample_period, np.abs(motion.acceleration)
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


def response_spectrum(
    motion: Record,
    periods: NDArray[np.float64] | Sequence[float] = PERIODS,
    damping_ratios: Sequence[float] = DAMPING_RATIOS,
) -> ResponseSpectrum:
    """The response spectra of a motion.

    Parameters
    ----------
    motion
        Recorded or played.
    periods
        Natural periods [s].
    damping_ratios
        Of critical damping, 0 or more and less than 1.

    Raises
    ------
    AbraceError
        If a period or ratio is out of range, or as in `check_record`.
    """
    check_record(motion)
    natural, ratios = np.asarray(periods, dtype=np.float64), np.asarray(damping_ratios, dtype=np.float64)
    where = f"response spectrum of {motion.name}"
    if not (np.isfinite(natural).all() and (natural > 0).all()):
        raise AbraceError(f"{where}: periods {periods} s, expected each more than 0")
    if not ((ratios >= 0) & (ratios < 1)).all():
        raise AbraceError(f"{where}: damping ratios {damping_ratios}, expected each from 0 to below 1")
    greatest = np.empty((len(ratios), len(natural), 2))
    samples, steps = np.arange(len(motion.acceleration)), len(motion.acceleration) - 1
    divided, divisions = motion.acceleration, 1
    for j in np.argsort(natural)[::-1]:
        needed = math.ceil(STEPS_PER_PERIOD * motion.sample_period / natural[j] * (1 - 1e-9))
        if needed > divisions:
            divisions = needed
            divided = np.interp(np.arange(steps * divisions + 1) / divisions, samples, motion.acceleration)
        for i, ratio in enumerate(ratios):
            step = motion.sample_period / divisions
            greatest[i, j] = _greatest_response(divided, step, 2 * np.pi / natural[j], ratio)
    return ResponseSpectrum(natural, ratios, greatest[:, :, 0], greatest[:, :, 1])


def _greatest_response(acceleration: NDArray[np.float64], step: float, omega: float, ratio: float) -> list[float]:
    """Greatest absolute displacement and velocity of u'' + 2 ratio omega u' + omega^2 u = -a from rest.

    The exact step x[k+1] = F x[k] + g a[k] + h a[k+1] of x = (u, u') is the exponential of the oscillator joined with
    the value and the slope of the acceleration (Van Loan, 1978). By Cayley and Hamilton each state then obeys
    y[k] - tr(F) y[k-1] + det(F) y[k-2] = n0 a[k] + n1 a[k-1] + n2 a[k-2].
    """
    from scipy import linalg, signal  # imports for half a second: to integrate a motion needs none of it

    joined = np.zeros((4, 4))
    joined[0, 1] = step
    joined[1] = [-(omega**2) * step, -2 * ratio * omega * step, -step, 0]
    joined[2, 3] = 1
    advanced = linalg.expm(joined)
    F, h = advanced[:2, :2], advanced[:2, 3]
    g = advanced[:2, 2] - h
    trace, determinant = np.trace(F), np.linalg.det(F)
    # adj(z I - F) (g + h z) = n0 z^2 + n1 z + n2
    adjoint = F - trace * np.eye(2)
    n0, n1, n2 = h, g + adjoint @ h, adjoint @ g
    greatest = []
    for state in range(2):
        # the filter's state with which the oscillator is at rest at the first sample, not one before it
        rest = acceleration[0] * np.array([-n0[state], g[state] - n1[state]])
        response, _ = signal.lfilter([n0[state], n1[state], n2[state]], [1, -trace, determinant], acceleration, zi=rest)
        greatest.append(float(np.abs(response).max()))
    return greatest
