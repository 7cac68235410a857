# SPDX-License-Identifier: Apache-2.0
"""Response spectra: the greatest response of oscillators of one degree of freedom to a ground motion.

    u'' + 2 zeta omega u' + omega^2 u = -a(t)

from rest, with a(t) linear between samples. Such a response is advanced exactly from sample to sample (Nigam and
Jennings, 1969). Its two states obey one linear recurrence of second order, a digital filter for each oscillator.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg, signal

from abrace_core.errors import AbraceError
from abrace_plant.records.record import check_record

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_plant.records.record import Record

PERIODS = np.geomspace(0.05, 5.0, 121)
"""Natural periods [s] of a spectrum that is drawn."""
DAMPING_RATIOS = (0.02, 0.05, 0.10)
"""Of a spectrum that is drawn."""
STEPS_PER_PERIOD = 40
"""Least number of steps per natural period: a peak between two steps is at most 0.3 % higher.

Longer steps of a motion are divided, which does not change the motion, as it is linear between samples.
"""


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
    natural = np.asarray(periods, dtype=np.float64)
    ratios = np.asarray(damping_ratios, dtype=np.float64)
    if not (np.isfinite(natural).all() and (natural > 0).all()):
        raise AbraceError(f"response spectrum of {motion.name}: periods {periods} s, expected each more than 0")
    if not ((ratios >= 0) & (ratios < 1)).all():
        raise AbraceError(
            f"response spectrum of {motion.name}: damping ratios {damping_ratios}, expected each from 0 to below 1"
        )
    displacement, velocity = np.empty((2, len(ratios), len(natural)))
    divided, divisions = motion.acceleration, 1
    for j in np.argsort(natural)[::-1]:
        needed = math.ceil(STEPS_PER_PERIOD * motion.sample_period / natural[j] * (1 - 1e-9))
        if needed > divisions:
            divisions = needed
            divided = _divide(motion.acceleration, divisions)
        for i, ratio in enumerate(ratios):
            displacement[i, j], velocity[i, j] = _greatest_response(
                divided, motion.sample_period / divisions, 2 * np.pi / natural[j], ratio
            )
    return ResponseSpectrum(natural, ratios, displacement, velocity)


def _divide(acceleration: NDArray[np.float64], divisions: int) -> NDArray[np.float64]:
    """The acceleration with its steps divided, linear between its samples."""
    steps = len(acceleration) - 1
    return np.interp(np.arange(steps * divisions + 1) / divisions, np.arange(steps + 1), acceleration)


def _greatest_response(acceleration: NDArray[np.float64], step: float, omega: float, ratio: float) -> tuple:
    """Greatest absolute displacement and velocity of one oscillator.

    The exact step x[k+1] = F x[k] + g a[k] + h a[k+1] of x = (u, u') is the exponential of the oscillator joined with
    the value and the slope of the acceleration (Van Loan, 1978). By Cayley and Hamilton each state then obeys
    y[k] - tr(F) y[k-1] + det(F) y[k-2] = n0 a[k] + n1 a[k-1] + n2 a[k-2].
    """
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
    return tuple(greatest)
