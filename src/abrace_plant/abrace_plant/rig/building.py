# SPDX-License-Identifier: Apache-2.0
"""The frame: lumped floor masses, condensed stiffness and damping, and the ways to state them.

    M x'' + C x' + K x = -M 1 w + forces

with x the floor displacements relative to the table [m] and w the table's acceleration [m/s^2].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_plant.rig.hysteresis import Hysteresis

STANDARD_GRAVITY = 9.80665
"""[m/s^2]."""

ALIKE = 0.2
"""Greatest cosine, in the mass metric, between two measured mode shapes. The modes of a frame have 0; a modal test
counts as good up to 0.1 (the orthogonality criterion of NASA-STD-5002); more than 0.2 is taken for a typing mistake."""


@dataclass(frozen=True)
class Building:
    """The bare frame.

    Parameters
    ----------
    masses
        (floors,) [kg].
    stiffness
        (floors, floors) [N/m], condensed to the floors, symmetric and positive definite; see `shear_stiffness` and
        `stiffness_of_modes`.
    damping
        (floors, floors) [N s/m], condensed to the floors, symmetric; see `modal_damping` and `rayleigh_damping`.
    friction
        (floors,) Coulomb friction of each storey's bearings and guides [N]; empty: none.
    hysteresis
        Springs that yield, each in place of a part of the stiffness.
    heights
        (floors,) of the storeys [m]; empty: all alike.
    """

    masses: NDArray[np.float64]
    stiffness: NDArray[np.float64]
    damping: NDArray[np.float64]
    friction: tuple[float, ...] = ()
    hysteresis: tuple[Hysteresis, ...] = ()
    heights: tuple[float, ...] = ()

    @property
    def floors(self) -> int:
        """Number of floors."""
        return len(self.masses)

    def modes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Undamped frequencies (floors,) [rad/s], slowest first, and mass-normalised shapes (floors, modes)."""
        return _modes(self.masses, self.stiffness)

    @property
    def damping_ratios(self) -> NDArray[np.float64]:
        """(floors,) of the undamped modes, slowest first; what couples the modes is left out."""
        frequencies, shapes = self.modes()
        return np.asarray(np.einsum("im,ij,jm->m", shapes, self.damping, shapes) / (2 * frequencies))


def storey_direction(storey: int, floors: int) -> NDArray[np.float64]:
    """(floors,) 1 at the floor on top of a `storey` (1 the lowest), -1 at the floor below it: their drift."""
    direction = np.zeros(floors)
    direction[storey - 1] = 1.0
    if storey > 1:
        direction[storey - 2] = -1.0
    return direction


def gravity_stiffness(masses: NDArray[np.float64], heights: float | NDArray[np.float64]) -> NDArray[np.float64]:
    """What the weight takes from the stiffness (floors, floors) [N/m]: P-Delta (Wilson 2002, ch. 11).

    In a storey of height h [m], one of the `heights`, that leans by a drift d, the weight W of the `masses` (floors,)
    [kg] above it pushes on with W d / h.
    """
    weight = STANDARD_GRAVITY * np.cumsum(masses[::-1])[::-1]
    return shear_stiffness(weight / heights)


def shear_stiffness(storey_stiffness: NDArray[np.float64]) -> NDArray[np.float64]:
    """Stiffness (floors, floors) [N/m] of a shear building, each floor tied to its neighbours (Chopra 2017, ch. 9).

    Parameters
    ----------
    storey_stiffness
        (floors,) [N/m]: force between the floors below and above a storey for each metre between them, lowest first.
    """
    above = np.append(storey_stiffness[1:], 0.0)
    return np.diag(storey_stiffness + above) - np.diag(above[:-1], 1) - np.diag(above[:-1], -1)


def stiffness_of_modes(
    masses: NDArray[np.float64], frequencies: NDArray[np.float64], shapes: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Stiffness (floors, floors) [N/m] whose modes are given: K = M Phi W^2 Phi^T M (Chopra 2017, ch. 10).

    Measured shapes are never quite orthogonal. They are replaced by the orthonormal set nearest to them in the mass
    metric, Phi S^(-1/2) with S = Phi^T M Phi (Loewdin 1950), which prefers none of them; the frequencies stay exact.

    Parameters
    ----------
    masses
        (floors,) [kg].
    frequencies
        (floors,) undamped [rad/s].
    shapes
        (floors, modes), as many as floors, of any scale.

    Raises
    ------
    AbraceError
        If two shapes are too alike to be modes of one frame (see `ALIKE`), or all together nearly dependent.
    """
    root = np.sqrt(masses)
    weighted = root[:, None] * shapes
    lengths = np.linalg.norm(weighted, axis=0)
    if not lengths.all():
        raise AbraceError(f"the shape of mode {np.argmin(lengths) + 1} is zero everywhere, expected a displacement")
    weighted = weighted / lengths
    metric = weighted.T @ weighted
    cosines = np.abs(np.triu(metric, 1))
    i, j = np.unravel_index(np.argmax(cosines), cosines.shape)
    if cosines[i, j] > ALIKE:
        raise AbraceError(
            f"the shapes of modes {i + 1} and {j + 1} are too alike: {cosines[i, j]:.3g} is the cosine between them "
            f"with these masses, expected at most {ALIKE} (modes of one frame have 0)"
        )
    values, vectors = np.linalg.eigh(metric)
    if values[0] < ALIKE:  # pairs that pass can together still be dependent, of six modes or more
        raise AbraceError(f"the shapes are nearly dependent: {values[0]:.3g}, expected at least {ALIKE} of 1")
    orthonormal = weighted @ (vectors / np.sqrt(values)) @ vectors.T * frequencies
    return np.asarray(np.outer(root, root) * (orthonormal @ orthonormal.T))


def modal_damping(
    masses: NDArray[np.float64], stiffness: NDArray[np.float64], ratios: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Damping matrix (floors, floors) [N s/m] with a given ratio in each mode (Chopra 2017, sec. 11.4).

    Parameters
    ----------
    masses, stiffness
        As in `Building`.
    ratios
        (floors,), slowest mode first.
    """
    frequencies, shapes = _modes(masses, stiffness)
    weighted = masses[:, None] * shapes
    return np.asarray((weighted * (2 * ratios * frequencies)) @ weighted.T)


def rayleigh_damping(
    masses: NDArray[np.float64], stiffness: NDArray[np.float64], modes: tuple[int, int], ratios: tuple[float, float]
) -> NDArray[np.float64]:
    """Damping matrix (floors, floors) [N s/m], a0 M + a1 K, with a given ratio in two modes (Chopra 2017, sec. 11.4).

    Parameters
    ----------
    masses, stiffness
        As in `Building`.
    modes
        Two different modes, 1 the slowest.
    ratios
        Of these two.

    Raises
    ------
    AbraceError
        If some mode is left without damping, or is damped critically, or the two have one frequency.
    """
    frequencies, _ = _modes(masses, stiffness)
    two = frequencies[np.array(modes) - 1]
    if np.ptp(two) < 1e-9 * two.max():
        raise AbraceError(f"modes {modes[0]} and {modes[1]} have the same frequency, expected two different ones")
    of_mass, of_stiffness = rayleigh_coefficients(two.tolist(), ratios)
    every = (of_mass / frequencies + of_stiffness * frequencies) / 2
    for i, ratio in enumerate(every):
        if not 0 < ratio < 1:
            listed = ", ".join(f"{value:.3g}" for value in every)
            raise AbraceError(
                f"mode {i + 1} gets a damping ratio of {ratio:.3g}, expected more than 0 and less than 1 in every mode "
                f"(modes 1 to {len(every)} get {listed})"
            )
    return np.asarray(of_mass * np.diag(masses) + of_stiffness * stiffness)


def rayleigh_coefficients(frequencies: Sequence[float], ratios: Sequence[float]) -> tuple[float, float]:
    """a0 [1/s] and a1 [s] of the damping a0 M + a1 K with given ratios at two frequencies [rad/s] (Chopra, 11.4.1).

    >>> [round(value, 6) for value in rayleigh_coefficients((1.0, 9.0), (0.05, 0.05))]
    [0.09, 0.01]
    """
    two = np.asarray(frequencies)
    of_mass, of_stiffness = np.linalg.solve(np.column_stack([1 / two, two]) / 2, np.array(ratios))
    return float(of_mass), float(of_stiffness)


def _modes(
    masses: NDArray[np.float64], stiffness: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    root = np.sqrt(masses)
    eigenvalues, vectors = np.linalg.eigh(stiffness / np.outer(root, root))
    shapes = vectors / root[:, None]
    return np.sqrt(eigenvalues), shapes * np.where(shapes[-1] < 0, -1.0, 1.0)
