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

BALANCING_SWEEPS = 20
"""Sweeps that bring rows and columns to one size."""

ROUNDING = 1 - 1e-6
"""Share of the greatest spectral radius below which a frequency's bound rules it out: both may be equal but for
rounding."""

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
def disk_margin(model: LinearModel, controller: LinearModel) -> DiskMargin:
    """The disk margin of all commands and all measured quantities at once.

    Parameters
    ----------
    model, controller
        As in `abrace_lqg.loop.closed_loop`.

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
    # mu lies between spectral radius and bound: a frequency whose bound is below the greatest radius cannot be the peak
    greatest = float(np.abs(np.linalg.eigvals(matrix)).max())
    refined = structured_bound(matrix, DESCENT_STEPS, ROUNDING * greatest)
    worst = int(np.argmax(refined))
    return DiskMargin(float(1 / refined[worst]), float(omega[worst]))


def structured_bound(matrix: NDArray[np.complex128], descent_steps: int, enough: float = 0.0) -> NDArray[np.float64]:
    """Upper bound of mu of each matrix, for a diagonal complex perturbation.

    Parameters
    ----------
    matrix
        Matrices M (matrices, signals, signals).
    descent_steps
        Steps along the gradient of log sigma_max(D M D^-1) by log D, which is |u_i|^2 - |v_i|^2 with the first singular
        vectors u and v. They begin at the D of Perron's vectors of |M|, whose rows and columns are balanced before, as
        signals are in newtons and in m/s^2. The least bound of all steps is returned.
    enough
        A matrix whose bound is below that takes no further step.

    Returns
    -------
    NDArray
        (matrices,).
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
    values, right = np.linalg.eig(scaled + TINY * scaled.max(axis=(1, 2), keepdims=True))
    pick, first = np.arange(len(matrix)), np.argmax(values.real, axis=1)
    left = np.linalg.inv(right)[pick, first]
    logarithm += (np.log(np.abs(left)) - np.log(np.abs(right[pick, :, first]))) / 2
    best, active = np.full(len(matrix), np.inf), pick
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
    return best
