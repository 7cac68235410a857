# SPDX-License-Identifier: Apache-2.0
"""Poles fitted to tests, with their covariance, and frequency and damping of the pairs with confidence intervals."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan
from typing import TYPE_CHECKING, Annotated

import numpy as np
import pydantic

from abrace_core.files.config_file import Number  # noqa: TC001  pydantic reads it

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

NORMAL_95 = 1.959964
"""Half the width of a normal distribution's central 95 %, in standard deviations."""

TESTS = {"table": "table test", "command": "command test", "common": "both tests"}
"""What pole pairs are from: as key in files, and in words."""


SURE = 3.0
"""Standard deviations: of 174 records of 40 s five had a pair of noise beyond 2 of them, one beyond 3."""


@dataclass(frozen=True)
class PoleInterval:
    """One pole pair with its uncertainty; in files by pydantic, with `damping_ratio`.

    Parameters
    ----------
    frequency, damping
        Modulus [rad/s] and damping ratio.
    frequency_deviation, damping_deviation
        Standard deviations of these; not numbers where they are not known.
    """

    frequency: float
    damping: Annotated[float, pydantic.Field(alias="damping_ratio")]
    frequency_deviation: Number = nan
    damping_deviation: Annotated[Number, pydantic.Field(alias="damping_ratio_deviation")] = nan

    @property
    def frequency_interval(self) -> tuple[float, float]:
        """95 % confidence interval of the frequency [rad/s]."""
        half = NORMAL_95 * self.frequency_deviation
        return self.frequency - half, self.frequency + half

    @property
    def damping_interval(self) -> tuple[float, float]:
        """95 % confidence interval of the damping ratio."""
        half = NORMAL_95 * self.damping_deviation
        return self.damping - half, self.damping + half

    @property
    def is_sure(self) -> bool:
        """Whether the damping ratio is SURE standard deviations from 0, or these are not known; noise is no mode."""
        return not self.damping <= SURE * self.damping_deviation


@dataclass(frozen=True)
class PoleEstimate:
    """Poles by maximum likelihood.

    Parameters
    ----------
    poles
        (poles,) [rad/s]: of each pair the one above the real axis, and real poles, in the order of the start.
    covariance
        Covariance of the poles' real and imaginary parts, in the order of `poles` (real poles: the real part alone),
        then of the directions of the drives. NaN: not computed. [rad^2/s^2]
    cost
        -2 log likelihood, minus a constant.
    observed
        Number of real values that were fitted.
    unknowns
        Number of unknowns: poles' parts, coefficients and noise levels.
    drive
        (poles, inputs) complex: how much each input drives each mode, q' = p q + drive u; real of a real pole.
    shapes
        (channels, poles) complex: the outputs are the real part of shapes q, plus direct u.
    direct
        (channels, inputs) direct terms.
    delays
        (inputs,) delay of each input [s]; NaN for inputs with direct terms.
    inflation
        Greatest ratio, over the pairs, of a pair's variance to its variance if channels and lines were independent.
    joint
        Covariance of all of these: the poles' parts as in `covariance`, then (parts, inputs) of `drive`,
        (channels, parts) of `shapes`, real and imaginary parts in turn, `direct` and `delays` (0 if not estimated);
        None: not computed.
    """

    poles: NDArray[np.complex128]
    covariance: NDArray[np.float64]
    cost: float
    observed: int
    unknowns: int
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    drive: NDArray[np.complex128]
    shapes: NDArray[np.complex128]
    direct: NDArray[np.float64]
    delays: NDArray[np.float64]
    inflation: float = 1.0
    joint: NDArray[np.float64] | None = None

    @property
    def mdl(self) -> float:
        """Twice Rissanen's minimum description length (1978): the least is best."""
        return self.cost + self.unknowns * float(np.log(self.observed))

    def pairs(self, among: Sequence[int] | NDArray[np.int64] | None = None) -> list[PoleInterval]:
        """Frequency and damping ratio of each pair with their uncertainty, slowest first.

        Parameters
        ----------
        among
            Indices of the poles that are wanted; None: all.
        """
        found, places = [], columns_of(self.poles)
        for i in range(len(self.poles)) if among is None else among:
            pole, columns = self.poles[i], places[i]
            if pole.imag > 0:
                modulus = abs(pole)
                # frequency |p|, damping -re/|p|; gradients with respect to re and im
                of_frequency = np.array([pole.real, pole.imag]) / modulus
                of_damping = np.array([-(pole.imag**2), pole.real * pole.imag]) / modulus**3
                covariance = self.covariance[columns, columns]
                spread = [float(np.sqrt(g @ covariance @ g)) for g in (of_frequency, of_damping)]
                found.append(PoleInterval(float(modulus), float(-pole.real / modulus), *spread))
        return sorted(found, key=lambda pair: pair.frequency)


def columns_of(poles: NDArray[np.complex128]) -> list[slice]:
    """The columns of each of the `poles` among real parameters or states: two of a pair, one of a real pole."""
    ends = np.cumsum(np.where(poles.imag > 0, 2, 1))
    return [slice(int(end) - (2 if pole.imag > 0 else 1), int(end)) for pole, end in zip(poles, ends, strict=True)]
