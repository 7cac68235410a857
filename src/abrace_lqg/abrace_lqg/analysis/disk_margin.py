# SPDX-License-Identifier: Apache-2.0
"""The multi-loop disk margin: simultaneous, independent changes of gain and phase in all commands and all sensors.

Each signal is multiplied by a factor f = (1 + d/2) / (1 - d/2) with a complex d of |d| < alpha: a disk that is
symmetric about 1 on a logarithmic scale of gain (skew 0). The loop stays stable for all such factors as long as alpha
is below 1 / max over frequency of mu(S - I/2), with S the sensitivity of all signals together and mu the structured
singular value for a diagonal d (Seiler, Packard and Gahinet 2020, An introduction to disk margins). Commands and
sensors change together: S is that of the loop [U; y] = [[0, K], [G/z, 0]] [U; y].

mu is bounded from above by the least sigma_max(D M D^-1) over diagonal D that a gradient descent finds, so that the
margin is never overestimated; up to three signals the bound can be met exactly (Doyle 1982).

python-control's `disk_margins` is of the commands or of the sensors, not of both, and of several signals needs SLICOT
(slycot, GPL). S - I has only twice the rank of the smaller one of commands and sensors: with one command and fifty
sensors the descent is over matrices of four rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
import pydantic

from abrace_core import AbraceError
from abrace_core.files.config_file import Number  # noqa: TC001  pydantic reads it
from abrace_core.model.linear_model import takes_models
from abrace_lqg.loop import Loop

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.model.linear_model import LinearModel

DESCENT_STEPS = 60
"""Steps of the gradient descent over D."""

LIKELY = 8
"""Number of frequencies, those with the greatest first bounds, that are refined first; then twice as many, ..."""

SPACING = 16
"""Every 16th frequency has a D of its own for the first bounds: any D gives a bound."""

BALANCING_SWEEPS = 20
"""Sweeps that bring rows and columns to one size."""

SQUARINGS = 6
"""Squarings of |M|: to its 64th power."""

TINY = 1e-9
"""Share of the greatest entry that is added to all of |M|, so that Perron's vectors have no zero."""


@dataclass(frozen=True)
class DiskMargin:
    """Simultaneous change of gain and phase of all signals that the loop tolerates; in files by pydantic.

    Parameters
    ----------
    alpha
        Radius of the disk of d.
    frequency
        At which it is least [rad/s].
    """

    alpha: Number
    frequency: Annotated[float, pydantic.Field(alias="frequency_rad_s")]

    @pydantic.computed_field  # type: ignore[prop-decorator]
    @property
    def gain_db(self) -> Number:
        """Tolerated change of gain of all signals at once, up or down [dB]."""
        return float(20 * np.log10((2 + self.alpha) / (2 - self.alpha))) if self.alpha < 2 else np.inf

    @pydantic.computed_field  # type: ignore[prop-decorator]
    @property
    def phase_deg(self) -> Number:
        """Tolerated change of phase of all signals at once, either way [degrees]."""
        return float(np.degrees(2 * np.arctan(self.alpha / 2)))

    def __str__(self) -> str:
        return (
            f"disk margin {self.alpha:.2f} at {self.frequency:.1f} rad/s: {self.gain_db:.1f} dB or "
            f"{self.phase_deg:.0f} deg in all signals at once"
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
    matrices = _Matrices.of(*loop.components(omega))
    spaced = perron_scaling(matrices.at(slice(None, None, SPACING)).full())
    bound, _ = matrices.norms(spaced[np.arange(len(omega)) // SPACING])
    order = np.argsort(-bound)
    peak, worst, first, batch = 1 / below, order[0], 0, LIKELY
    # the frequencies with the greatest bounds are refined first, until those that are left are below the peak found
    while first < len(order) and bound[order[first]] >= peak:
        chosen = order[first : first + batch]
        refined = _descended(matrices.at(chosen), DESCENT_STEPS, peak)
        if not refined.max() <= peak:  # NaN stays
            peak, worst = float(refined.max()), chosen[np.argmax(refined)]
        first, batch = first + batch, 2 * batch
    return DiskMargin(1 / peak, float(omega[worst]))


class _Matrices(NamedTuple):
    """Matrices M = shift I + left right.

    Parameters
    ----------
    left, right
        (matrices, signals, rank) and (matrices, rank, signals).
    """

    shift: float
    left: NDArray[np.complex128]
    right: NDArray[np.complex128]

    @classmethod
    def of(cls, plant: NDArray[np.complex128], law: NDArray[np.complex128]) -> _Matrices:
        """S - I/2 of the loop of `plant` (frequencies, sensors, commands) and `law` (frequencies, commands, sensors).

        [[0, K], [G, 0]] is the product left @ right of a block diagonal and its blocks' places, and S = I + left (I -
        right left)^-1 right.
        """
        count, sensors, commands = plant.shape
        few = min(sensors, commands)
        left = np.zeros((count, commands + sensors, 2 * few), dtype=np.complex128)
        right = np.zeros((count, 2 * few, commands + sensors), dtype=np.complex128)
        eye = np.eye(few)
        left[:, :commands, :few], left[:, commands:, few:] = (eye, plant) if few == commands else (law, eye)
        right[:, :few, commands:], right[:, few:, :commands] = (law, eye) if few == commands else (eye, plant)
        return cls(0.5, left, np.linalg.solve(np.eye(2 * few) - right @ left, right))

    def at(self, chosen: Any) -> _Matrices:
        """The matrices with these places."""
        return _Matrices(self.shift, self.left[chosen], self.right[chosen])

    def full(self) -> NDArray[np.complex128]:
        """(matrices, signals, signals)."""
        return self.shift * np.eye(self.left.shape[1]) + self.left @ self.right

    def norms(self, scaling: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """sigma_max(D M D^-1) of each, and its gradient.

        Parameters
        ----------
        scaling
            Logarithms of the diagonal D (matrices, signals).

        Returns
        -------
        norms, gradients
            (matrices,), and (matrices, signals) of the norm's logarithm by those of D: |u_i|^2 - |v_i|^2 with the first
            singular vectors u and v.
        """
        scale, (signals, rank) = np.exp(scaling), self.left.shape[1:]
        left, right = self.left * scale[:, :, None], self.right / scale[:, None, :]
        basis = None
        if 2 * rank < signals:  # M and its transpose keep the columns' space; outside it M is shift I
            basis, upper = np.linalg.qr(np.concatenate([left, right.conj().swapaxes(1, 2)], axis=2))
            left, right = upper[:, :, :rank], upper[:, :, rank:].conj().swapaxes(1, 2)
        matrix = self.shift * np.eye(left.shape[1]) + left @ right
        # the greatest singular value and its vectors, of the Hermitian product: a third of the work of all
        squares, vectors = np.linalg.eigh(matrix.conj().swapaxes(1, 2) @ matrix)
        sigma, v = np.sqrt(squares[:, -1]), vectors[:, :, -1:]
        u = matrix @ v / sigma[:, None, None]
        if basis is not None:
            u, v = basis @ u, basis @ v
        return sigma, (np.abs(u) ** 2 - np.abs(v) ** 2)[:, :, 0]


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


def _descended(matrices: _Matrices, descent_steps: int, enough: float = 0.0) -> NDArray[np.float64]:
    """The least bound (matrices,) of mu along a descent from `perron_scaling` on over the scaling D.

    Parameters
    ----------
    matrices
        M.
    descent_steps
        Steps along the gradient. The least bound of all steps is returned.
    enough
        A matrix whose bound is below that takes no further step.
    """
    logarithm = perron_scaling(matrices.full())
    best, active = np.full(len(logarithm), np.inf), np.arange(len(logarithm))
    for step in range(descent_steps + 1):
        sigma, gradient = matrices.at(active).norms(logarithm[active])
        best[active] = np.minimum(best[active], sigma)
        logarithm[active] -= gradient / (1 + step) ** 0.5
        active = active[best[active] >= enough]
        if not active.size:
            break
    return best
