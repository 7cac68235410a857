# SPDX-License-Identifier: Apache-2.0
"""Mass and stiffness of a structure on the ground, and smaller models of it.

    M q'' + C q' + K q = -L w + forces,     displacements = T q

with w the acceleration of the ground [m/s^2] and L the mass that it moves in each coordinate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True)
class Structure:
    """A structure in some coordinates q.

    Parameters
    ----------
    mass, stiffness
        (coordinates, coordinates), symmetric [kg], [N/m] where the coordinates are displacements.
    ground_load
        (coordinates,) L: force for each m/s^2 that the ground accelerates against it [kg].
    displacements
        (displacements, coordinates) T: those of the nodes, three a node where it is a frame.
    """

    mass: NDArray[np.float64]
    stiffness: NDArray[np.float64]
    ground_load: NDArray[np.float64]
    displacements: NDArray[np.float64]

    def modes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Undamped frequencies [rad/s], slowest first, and mass-normalised shapes (coordinates, modes)."""
        squares, shapes = linalg.eigh(self.stiffness, self.mass)
        return np.sqrt(squares), shapes

    def condensed(self, kept: NDArray[np.intp]) -> Structure:
        """The `kept` coordinates alone; the others follow statically, with the mass that they have (Guyan 1965).

        Exact where the others have no mass.
        """
        other = np.setdiff1d(np.arange(len(self.mass)), kept)
        follow = np.zeros((len(self.mass), len(kept)))
        follow[kept, np.arange(len(kept))] = 1.0
        if len(other):
            coupling = self.stiffness[np.ix_(other, kept)]
            follow[other] = -linalg.solve(self.stiffness[np.ix_(other, other)], coupling, assume_a="pos")
        return self.projected(follow)

    def projected(self, shapes: NDArray[np.float64]) -> Structure:
        """The structure in other coordinates, of which the `shapes` (coordinates, new ones) make these."""
        mass, stiffness = (shapes.T @ matrix @ shapes for matrix in (self.mass, self.stiffness))
        return Structure(
            (mass + mass.T) / 2, (stiffness + stiffness.T) / 2, shapes.T @ self.ground_load, self.displacements @ shapes
        )
