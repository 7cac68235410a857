# SPDX-License-Identifier: Apache-2.0
"""Mass and stiffness of a structure on the ground, and smaller models of it with their errors.

    M q'' + C q' + K q = -L w + forces,     displacements = T q

with w the acceleration of the ground [m/s^2] and L the mass that it moves in each coordinate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

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

    def effective_masses(self) -> NDArray[np.float64]:
        """(modes,) mass that each mode moves with the ground, slowest first [kg]."""
        return np.asarray((self.modes()[1].T @ self.ground_load) ** 2)

    def condensed(self, kept: NDArray[np.intp]) -> Structure:
        """The `kept` coordinates alone; the others follow statically, with the mass that they have (Guyan 1965).

        Exact where the others have no mass; otherwise `frequency_errors` gives the error.
        """
        other = np.setdiff1d(np.arange(len(self.mass)), kept)
        follow = np.zeros((len(self.mass), len(kept)))
        follow[kept, np.arange(len(kept))] = 1.0
        if len(other):
            coupling = self.stiffness[np.ix_(other, kept)]
            follow[other] = -linalg.solve(self.stiffness[np.ix_(other, other)], coupling, assume_a="pos")
        return self.projected(follow)

    def truncated(self, modes: int) -> Structure:
        """The slowest `modes` alone, as coordinates of unit mass; `mass_left_out` gives the share left out.

        Raises
        ------
        AbraceError
            If it has not so many.
        """
        if not 1 <= modes <= len(self.mass):
            raise AbraceError(f"structure: {modes} modes, expected 1 to {len(self.mass)}")
        return self.projected(self.modes()[1][:, :modes])

    def projected(self, shapes: NDArray[np.float64]) -> Structure:
        """In other coordinates, of which the `shapes` (coordinates, new ones) make these."""
        mass, stiffness = (shapes.T @ matrix @ shapes for matrix in (self.mass, self.stiffness))
        return Structure(
            (mass + mass.T) / 2, (stiffness + stiffness.T) / 2, shapes.T @ self.ground_load, self.displacements @ shapes
        )

    def frequency_errors(self, smaller: Structure) -> NDArray[np.float64]:
        """(modes of the smaller one,) relative errors of its frequencies, compared mode by mode.

        A condensed structure lacks some modes: each of its shapes is compared with the one here that it is most like.
        """
        frequencies, shapes = self.modes()
        theirs, their_shapes = smaller.modes()
        into = linalg.lstsq(self.displacements, smaller.displacements @ their_shapes)[0]
        alike = np.abs(shapes.T @ self.mass @ into)
        return np.asarray(theirs / frequencies[np.argmax(alike, axis=0)] - 1)

    def mass_left_out(self, smaller: Structure) -> float:
        """Share of the mass moved by the ground that a `smaller` model of this one does not move."""
        return 1 - float(smaller.effective_masses().sum() / self.effective_masses().sum())


def rayleigh_coefficients(frequencies: Sequence[float], ratios: Sequence[float]) -> tuple[float, float]:
    """a0 [1/s] and a1 [s] of the damping a0 M + a1 K with given ratios at two frequencies [rad/s] (Chopra, 11.4.1).

    >>> [round(value, 6) for value in rayleigh_coefficients((1.0, 9.0), (0.05, 0.05))]
    [0.09, 0.01]
    """
    two = np.asarray(frequencies)
    of_mass, of_stiffness = np.linalg.solve(np.column_stack([1 / two, two]) / 2, np.array(ratios))
    return float(of_mass), float(of_stiffness)
