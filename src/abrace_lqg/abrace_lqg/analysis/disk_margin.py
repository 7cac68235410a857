# SPDX-License-Identifier: Apache-2.0
"""The multi-loop disk margin: simultaneous, independent changes of gain and phase in all commands and all sensors.

Each signal is multiplied by a factor f = (1 + d/2) / (1 - d/2) with a complex d of |d| < alpha: a disk that is
symmetric about 1 on a logarithmic scale of gain (skew 0). The loop stays stable for all such factors as long as alpha
is below 1 / max over frequency of mu(S - I/2), with S the sensitivity of all signals together and mu the structured
singular value for a diagonal d (Seiler, Packard and Gahinet 2020, An introduction to disk margins). Commands and
sensors change together: S is that of the loop [U; y] = [[0, K], [G/z, 0]] [U; y].

mu is bounded from above by the least sigma_max(D M D^-1) over diagonal D that a gradient descent finds, so that the
margin is never overestimated; up to three signals the bound can be met exactly (Doyle 1982).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError
from abrace_core.linear_model import takes_models
from abrace_lqg.loop import Loop

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel

DESCENT_STEPS = 60
"""Of the gradient descent over D."""

LIKELY = 8
"""Number of frequencies, those with the greatest first bounds, that are refined first; then twice as many, ..."""

SPACING = 16
"""For the first bounds D is computed at every 16th frequency: any D gives a bound."""

BALANCING_SWEEPS = 20
"""Sweeps that bring rows and columns to one size."""

SQUARINGS = 6
"""Squarings of |M|: to its 64th power."""

TINY = 1e-9
"""Share of the greatest entry that is added to all of |M|, so that Perron's vectors have no zero."""


@dataclass(frozen=True)
class DiskMargin:
    """Simultaneous change of gain and phase of all signals that the loop tolerates.

    Parameters
    ----------
    alpha
        Radius of the disk of d.
    frequency
        At which it is least [rad/s].
    """

    alpha: float
    frequency: float

    @property
    def gain(self) -> float:
        """Tolerated change of gain of all signals at once, up or down [dB]."""
        return float(20 * np.log10((2 + self.alpha) / (2 - self.alpha))) if self.alpha < 2 else np.inf

    @property
    def phase(self) -> float:
        """Tolerated change of phase of all signals at once, either way [degrees]."""
        return float(np.degrees(2 * np.arctan(self.alpha / 2)))

    def __str__(self) -> str:
        return (
            f"disk margin {self.alpha:.2f} at {self.frequency:.1f} rad/s: {self.gain:.1f} dB or {self.phase:.0f} deg "
            "in all signals at once"
        )


@takes_models
def disk_margin(model: LinearModel, controller: LinearModel, below: float = np.inf) -> DiskMargin:
    """The disk margin of all commands and all measured quantities at once.

    Parameters
    ----------
    model, controller
        As in `abrace_lqg.loop.closed_loop`.
    below
        Only a margin below that is wanted: of a greater one a lower bound is returned, which is not below that.

    Raises
    ------
    AbraceError
        If the loop is not stable.
    """
    loop = Loop(model, controller)
    if not loop.is_stable:
        raise AbraceError("disk margin: the closed loop is not stable")
    omega = loop.frequencies()
    plant, law = loop.components(omega)
    size, commands = len(loop.signals), law.shape[1]
    open_loop = np.zeros((len(omega), size, size), dtype=np.complex128)
    open_loop[:, :commands, commands:], open_loop[:, commands:, :commands] = law, plant
    matrix = np.asarray(np.linalg.inv(np.eye(size) - open_loop) - np.eye(size) / 2, dtype=np.complex128)
    bound = norm_bound(matrix, perron_scaling(matrix[::SPACING])[np.arange(len(omega)) // SPACING])
    order = np.argsort(-bound)
    peak, worst, first, batch = 1 / below, order[0], 0, LIKELY
    # the frequencies with the greatest bounds are refined first, until those that are left are below the peak found
    while first < len(order) and bound[order[first]] >= peak:
        chosen = order[first : first + batch]
        refined = descended(matrix[chosen], perron_scaling(matrix[chosen]), DESCENT_STEPS, peak)
        if refined.max() > peak:
            peak, worst = float(refined.max()), chosen[np.argmax(refined)]
        first, batch = first + batch, 2 * batch
    return DiskMargin(1 / peak, float(omega[worst]))


def structured_bound(matrix: NDArray[np.complex128], descent_steps: int) -> NDArray[np.float64]:
    """Upper bound (matrices,) of mu of each matrix, for a diagonal complex perturbation.

    Parameters
    ----------
    matrix
        Matrices M (matrices, signals, signals).
    descent_steps
        From `perron_scaling` on.
    """
    return descended(matrix, perron_scaling(matrix), descent_steps)


def norm_bound(matrix: NDArray[np.complex128], scaling: NDArray[np.float64]) -> NDArray[np.float64]:
    """Upper bound (matrices,) of sigma_max(D M D^-1): the 16th root of the sum of the singular values' 16th powers.

    It needs only products of matrices, and is at most 1.3 times sigma_max for up to 64 signals.

    Parameters
    ----------
    matrix
        Matrices M (matrices, signals, signals).
    scaling
        Logarithms of the diagonal D (matrices, signals).
    """
    scale = np.exp(scaling)
    rescaled = matrix * (scale[:, :, None] / scale[:, None, :])
    power = rescaled.conj().swapaxes(1, 2) @ rescaled
    for _ in range(2):
        power = power @ power
    return np.asarray(np.linalg.norm(power, axis=(1, 2)) ** (1 / 8))


def perron_scaling(matrix: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Logarithms (matrices, signals) of the diagonal D of Perron's vectors of |M|.

    Rows and columns of |M| are balanced before, as signals are in newtons and in m/s^2.

    Parameters
    ----------
    matrix
        Matrices M (matrices, signals, signals).
    """
    logarithm = np.zeros(matrix.shape[:2])
    sizes = np.abs(matrix)
    for _ in range(BALANCING_SWEEPS):
        scale = np.exp(logarithm)
        scaled = sizes * (scale[:, :, None] / scale[:, None, :]) + np.finfo(np.float64).tiny
        step = np.log(scaled.sum(axis=1) / scaled.sum(axis=2)) / 4
        logarithm += np.clip(step, -5, 5)
    scale = np.exp(logarithm)
    scaled = sizes * (scale[:, :, None] / scale[:, None, :])
    scaled += TINY * scaled.max(axis=(1, 2), keepdims=True)
    for _ in range(SQUARINGS):
        scaled = scaled @ scaled
        scaled /= scaled.max(axis=(1, 2), keepdims=True)
    # a high power of a positive matrix is Perron's right vector times the left one
    right, left = scaled.sum(axis=2), scaled.sum(axis=1)
    return np.asarray(logarithm + (np.log(left) - np.log(right)) / 2)


def descended(
    matrix: NDArray[np.complex128], scaling: NDArray[np.float64], descent_steps: int, enough: float = 0.0
) -> NDArray[np.float64]:
    """The least bound (matrices,) of mu along a descent over the scaling D.

    Parameters
    ----------
    matrix
        Matrices M (matrices, signals, signals).
    scaling
        Logarithms of the first D (matrices, signals).
    descent_steps
        Steps along the gradient of log sigma_max(D M D^-1) by log D, which is |u_i|^2 - |v_i|^2 with the first singular
        vectors u and v. The least bound of all steps is returned.
    enough
        A matrix whose bound is below that takes no further step.
    """
    logarithm = scaling.copy()
    best, active = np.full(len(matrix), np.inf), np.arange(len(matrix))
    for step in range(descent_steps + 1):
        scale = np.exp(logarithm[active])
        rescaled = matrix[active] * (scale[:, :, None] / scale[:, None, :])
        # the greatest singular value and its vectors, of the Hermitian product: a third of the work of all
        squares, vectors = np.linalg.eigh(rescaled.conj().swapaxes(1, 2) @ rescaled)
        sigma, v = np.sqrt(squares[:, -1]), vectors[:, :, -1]
        u = np.einsum("nij,nj->ni", rescaled, v) / sigma[:, None]
        best[active] = np.minimum(best[active], sigma)
        logarithm[active] -= (np.abs(u) ** 2 - np.abs(v) ** 2) / (1 + step) ** 0.5
        active = active[best[active] >= enough]
        if not active.size:
            break
    return best
