# SPDX-License-Identifier: Apache-2.0
"""Detection of a mode that the model lacks: one pole pair then explains nearly all of the strongest residual."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import optimize

from abrace_core.model.modes import nearest_mode
from abrace_sysid.fitting.pole_basis import forced, transients

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.validity.residuals import Residual

SEARCHED_AROUND = 0.1
"""Half-width of the window about the strongest residual in which the mode is fitted, as a share of its frequency."""

LEAST_LINES = 40

DAMPING = (0.003, 0.02, 0.1)
"""Initial values of the damping ratio."""

EXPLAINED, SMOOTH = 0.9, 0.8
"""The residual is a missing mode if a mode explains more than EXPLAINED of it, and a response without resonance less
than SMOOTH.

Friction and backlash leave residuals of which a mode explains less than half."""


@dataclass(frozen=True)
class MissingMode:
    """The mode (pole pair) that explains most of the strongest residual.

    Parameters
    ----------
    frequency, damping
        [rad/s] and ratio.
    explained, smoothly
        Shares of the residual beyond noise, about that frequency, that the mode explains, and that a straight line over
        frequency times the inputs (a response without resonance) explains.
    known
        Whether the model already has a mode at this frequency, but fits it badly.
    """

    frequency: float
    damping: float
    explained: float
    smoothly: float
    known: bool

    @property
    def is_one(self) -> bool:
        """Whether the residual is a mode that the model lacks."""
        explains = self.explained > EXPLAINED and self.smoothly < SMOOTH
        return explains and not self.known and 1e-4 < self.damping < 0.3


def missing_mode(residual: Residual) -> MissingMode | None:
    """The mode that explains most of a residual; None if the residual is no more than noise.

    Parameters
    ----------
    residual
        Residual of a test with noise.
    """
    test, omega, power = residual.test, residual.test.omega, residual.ratio.sum(axis=1)
    smooth = np.convolve(power, np.ones(5) / 5, "same")
    centre = int(np.argmax(smooth))
    reach = max(LEAST_LINES, int(SEARCHED_AROUND * omega[centre] / (omega[1] - omega[0])))
    lines = slice(max(0, centre - reach), centre + reach + 1)
    z, excitation = test.z[lines], test.excitation[lines]
    left = residual.left[lines] / np.sqrt(residual.noise[lines])
    total, expected = float(np.sum(np.abs(left) ** 2)), float(left.size)
    if total < 2 * expected:
        return None

    constant = np.ones((len(z), 1), dtype=np.complex128)

    def without(columns: Sequence[NDArray[np.complex128]]) -> float:
        stacked = np.column_stack(columns)
        q = np.linalg.qr(stacked / np.linalg.norm(stacked, axis=0))[0]
        return float(np.sum(np.abs(left - q @ (q.conj().T @ left)) ** 2))

    def rest(parameters: NDArray[np.float64]) -> float:
        frequency, damping = np.exp(parameters)
        if damping > 0.5:
            return total
        pole = frequency * complex(-damping, np.sqrt(1 - damping**2))
        return without(
            [constant, *forced([pole], z, test.samplings, excitation), *transients([pole], z, test.samplings[0])]
        )

    starts = [np.log([omega[centre], damping]) for damping in DAMPING]
    first = min(starts, key=rest)
    found = optimize.minimize(
        rest, first, method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-3 * total, "maxiter": 120}
    )
    frequency, damping = np.exp(found.x)
    along = np.linspace(-1, 1, len(z))[:, None]
    shares = [
        min(1.0, (total - left_over) / (total - expected))
        for left_over in (float(found.fun), without([constant, along * constant, excitation, along * excitation]))
    ]
    pairs = np.abs(residual.poles[residual.poles.imag > 0])
    known = nearest_mode(pairs, frequency) is not None
    return MissingMode(float(frequency), float(damping), shares[0], shares[1], known)
