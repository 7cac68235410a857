"""The frame: lumped floor masses, condensed stiffness, modes and modal damping.

    M x'' + C x' + K x = -M 1 w + forces

with x the floor displacements relative to the table [m] and w the table's acceleration [m/s^2].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True)
class Building:
    """The bare frame.

    Parameters
    ----------
    masses
        (floors,) [kg].
    stiffness
        (floors, floors) [N/m], condensed to the floors, symmetric and positive definite.
    damping_ratios
        (floors,), of the bare frame's modes, slowest first.
    """

    masses: NDArray[np.float64]
    stiffness: NDArray[np.float64]
    damping_ratios: NDArray[np.float64]

    @property
    def floors(self) -> int:
        """Number of floors."""
        return len(self.masses)

    def modes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Undamped frequencies (floors,) [rad/s], slowest first, and mass-normalised shapes (floors, modes)."""
        eigenvalues, shapes = linalg.eigh(self.stiffness, np.diag(self.masses))
        return np.sqrt(eigenvalues), shapes * np.sign(shapes[-1])

    def damping(self) -> NDArray[np.float64]:
        """Damping matrix (floors, floors) [N s/m] with the given ratio in each mode (Chopra, sec. 11.4.2)."""
        frequencies, shapes = self.modes()
        weighted = self.masses[:, None] * shapes
        return (weighted * (2 * self.damping_ratios * frequencies)) @ weighted.T
