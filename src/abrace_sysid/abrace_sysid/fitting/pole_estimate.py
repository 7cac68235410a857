"""What a fit of poles to tests found: poles, how certain they are, and the numerators that belong to them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

NORMAL_95 = 1.959964
"""Half the width of a normal distribution's central 95 %, in standard deviations."""


@dataclass(frozen=True)
class PoleInterval:
    """One pole pair with its uncertainty.

    Parameters
    ----------
    frequency, damping
        Modulus [rad/s] and damping ratio.
    frequency_deviation, damping_deviation
        Standard deviations of these.
    """

    frequency: float
    damping: float
    frequency_deviation: float
    damping_deviation: float

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


@dataclass(frozen=True)
class Numerators:
    """What one test says of its channels, the poles given.

    Parameters
    ----------
    inputs, outputs
        Names.
    poles
        Which of the common poles the test shows, as indices.
    c
        (inputs, channels, states): rows of C for the modal states of these poles, as `realization.modal_states` has
        them: two for a pair, one for a real pole, in the order of `poles`.
    d
        (inputs, channels) direct terms.
    residual
        (channels,) root mean square of what is left over at a line, in the unit of what was fitted.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    poles: tuple[int, ...]
    c: NDArray[np.float64]
    d: NDArray[np.float64]
    residual: NDArray[np.float64]


@dataclass(frozen=True)
class PoleEstimate:
    """Poles by maximum likelihood.

    Parameters
    ----------
    poles
        (poles,) [rad/s]: of each pair the one above the real axis, and real poles, in the order of the start.
    covariance
        Of the poles' real and imaginary parts, in the order of `poles`; of a real pole the real part alone. [rad^2/s^2]
    numerators
        One for each test.
    cost
        -2 log likelihood, less a constant.
    observed
        Real numbers fitted.
    unknowns
        Poles' parts, coefficients and noise levels.
    iterations
        Steps taken.
    """

    poles: NDArray[np.complex128]
    covariance: NDArray[np.float64]
    numerators: tuple[Numerators, ...]
    cost: float
    observed: int
    unknowns: int
    iterations: int

    @property
    def aic(self) -> float:
        """Akaike's information criterion (1974): the least is best, and it errs to too many poles."""
        return self.cost + 2 * self.unknowns

    @property
    def mdl(self) -> float:
        """Rissanen's minimum description length (1978), twice: the least is best."""
        return self.cost + self.unknowns * float(np.log(self.observed))

    def all_poles(self) -> NDArray[np.complex128]:
        """All poles [rad/s], conjugates too, slowest first."""
        upper = self.poles[self.poles.imag > 0]
        poles = np.concatenate([self.poles, upper.conj()])
        return poles[np.lexsort((-poles.imag, np.abs(poles)))]

    def covariance_of(self, pole: int) -> NDArray[np.float64]:
        """Covariance of the real and imaginary part of one pole (2, 2), or (1, 1) of a real one."""
        columns = columns_of(self.poles)[pole]
        return self.covariance[columns, columns]

    def pairs(self) -> list[PoleInterval]:
        """Frequency and damping ratio of each pair with their uncertainty, slowest first."""
        found = []
        for i, pole in enumerate(self.poles):
            if pole.imag > 0:
                modulus = abs(pole)
                # frequency |p|, damping -re/|p|; gradients with respect to re and im
                of_frequency = np.array([pole.real, pole.imag]) / modulus
                of_damping = np.array([-(pole.imag**2), pole.real * pole.imag]) / modulus**3
                covariance = self.covariance_of(i)
                spread = [float(np.sqrt(g @ covariance @ g)) for g in (of_frequency, of_damping)]
                found.append(PoleInterval(float(modulus), float(-pole.real / modulus), *spread))
        return sorted(found, key=lambda pair: pair.frequency)


def columns_of(poles: NDArray[np.complex128]) -> list[slice]:
    """Where each of the `poles` stands among real parameters or states: a pair takes two places, a real pole one."""
    ends = np.cumsum(np.where(poles.imag > 0, 2, 1))
    return [slice(int(end) - (2 if pole.imag > 0 else 1), int(end)) for pole, end in zip(poles, ends, strict=True)]
