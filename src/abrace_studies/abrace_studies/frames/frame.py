# SPDX-License-Identifier: Apache-2.0
"""A plane frame of straight members: its stiffness, its masses, and the bending moments at the ends of its members.

Euler-Bernoulli members, small displacements, no shear deformation, no P-Delta, joints without size (Przemieniecki 1968,
sec. 5.6). Each node moves horizontally, vertically and turns; supports hold some of these, a rigid floor gives several
nodes one horizontal displacement. A hinge releases the moment at a member's end.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from abrace_core import AbraceError
from abrace_studies.frames.structure import Structure

if TYPE_CHECKING:
    from numpy.typing import NDArray

DIRECTIONS = ("horizontal displacement", "vertical displacement", "rotation")
LEAST_STIFFNESS = 1e-13
"""Least eigenvalue of the stiffness scaled to a unit diagonal: below it the frame is a mechanism."""


@dataclass(frozen=True)
class Section:
    """Section of a member.

    Parameters
    ----------
    axial
        EA [N].
    bending
        EI [N m^2].
    yield_curvature
        At which an end begins to yield [1/m]; infinite: not known.
    """

    axial: float
    bending: float
    yield_curvature: float = np.inf


@dataclass(frozen=True)
class Member:
    """A straight member of one section between two nodes, by their numbers; its start and its end may turn freely."""

    start: int
    end: int
    section: Section
    hinged: tuple[bool, bool] = (False, False)


@dataclass(frozen=True)
class Frame:
    """A plane frame.

    Parameters
    ----------
    nodes
        (nodes, 2) positions, horizontal and vertical [m].
    members
        The members.
    supports
        (nodes, 3) whether the horizontal displacement, the vertical one and the rotation are held.
    masses
        (nodes, 3) lumped at the nodes: horizontal and vertical [kg], rotational inertia [kg m^2].
    rigid_floors
        Groups of nodes with one horizontal displacement each.

    Raises
    ------
    AbraceError
        If a member, a support or a floor names a node that is not there, or a member has no length.
    """

    nodes: NDArray[np.float64]
    members: tuple[Member, ...]
    supports: NDArray[np.bool_]
    masses: NDArray[np.float64]
    rigid_floors: tuple[tuple[int, ...], ...] = ()

    def __post_init__(self) -> None:
        count = len(self.nodes)
        for name, shape in (("nodes", (count, 2)), ("supports", (count, 3)), ("masses", (count, 3))):
            if np.shape(getattr(self, name)) != shape:
                raise AbraceError(f"frame: {name} of shape {np.shape(getattr(self, name))}, expected {shape}")
        named = [number for member in self.members for number in (member.start, member.end)]
        named += [number for floor in self.rigid_floors for number in floor]
        unknown = [number for number in named if not 0 <= number < count]
        if unknown:
            raise AbraceError(f"frame: node {unknown[0]}, expected one from 0 to {count - 1}")
        for i, member in enumerate(self.members):
            if not np.any(self.nodes[member.start] != self.nodes[member.end]):
                raise AbraceError(f"frame: member {i} has no length, expected two nodes apart from each other")

    def coordinates(self) -> NDArray[np.int64]:
        """(nodes, 3) number of the coordinate that each displacement is; -1: held."""
        leader = np.arange(3 * len(self.nodes)).reshape(-1, 3)
        supports = self.supports.copy()
        for floor in self.rigid_floors:
            leader[list(floor), 0] = leader[floor[0], 0]
            supports[list(floor), 0] = supports[list(floor), 0].any()
        free = np.unique(leader[~supports])
        numbers = np.full(leader.size, -1)
        numbers[free] = np.arange(len(free))
        return np.where(supports, -1, numbers[leader])

    def stiffness(self) -> NDArray[np.float64]:
        """(coordinates, coordinates) [N/m, N, N m].

        Raises
        ------
        AbraceError
            If the frame is a mechanism; names a displacement that nothing holds.
        """
        displacements = self._displacements()
        turned, local = self._member_matrices()
        of_member = np.einsum("mij,mjk,mkl->mil", turned.swapaxes(1, 2), local, turned, optimize=True)
        places = self._places()
        whole = np.zeros((len(displacements), len(displacements)))
        np.add.at(whole, (places[:, :, None], places[:, None, :]), of_member)
        stiffness = displacements.T @ whole @ displacements
        self._expect_stable(stiffness)
        return np.asarray(stiffness)

    def structure(self) -> Structure:
        """Mass and stiffness of the coordinates that have mass; those without follow statically, which is exact."""
        displacements = self._displacements()
        # the nodes of a rigid floor have one coordinate each: the mass matrix is diagonal
        masses = np.einsum("dn,d->n", displacements, self.masses.ravel())
        moved = np.tile([1.0, 0.0, 0.0], len(self.nodes)) * self.masses.ravel()
        whole = Structure(np.diag(masses), self.stiffness(), moved @ displacements, displacements)
        return whole.condensed(np.flatnonzero(masses > 0))

    def end_moments(self) -> NDArray[np.float64]:
        """(2 * members, 3 * nodes) bending moments at both ends of each member, of the nodes' displacements [N m]."""
        turned, local = self._member_matrices()
        moments = np.einsum("mij,mjk->mik", local[:, [2, 5]], turned, optimize=True)
        whole = np.zeros((len(self.members), 2, 3 * len(self.nodes)))
        np.put_along_axis(whole, np.repeat(self._places()[:, None], 2, axis=1), moments, axis=2)
        return whole.reshape(2 * len(self.members), -1)

    def _displacements(self) -> NDArray[np.float64]:
        """(3 * nodes, coordinates) displacements of the nodes, of the coordinates."""
        numbers = self.coordinates().ravel()
        found = np.zeros((len(numbers), int(numbers.max(initial=-1)) + 1))
        free = np.flatnonzero(numbers >= 0)
        found[free, numbers[free]] = 1.0
        return found

    def _places(self) -> NDArray[np.int64]:
        """(members, 6) which of the nodes' displacements are the members'."""
        ends = np.array([(member.start, member.end) for member in self.members])
        return (3 * ends[:, :, None] + np.arange(3)).reshape(-1, 6)

    def _member_matrices(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(members, 6, 6) each: the nodes' displacements to those along and across a member, and its stiffness."""
        ends = np.array([(member.start, member.end) for member in self.members])
        along = self.nodes[ends[:, 1]] - self.nodes[ends[:, 0]]
        length = np.hypot(*along.T)
        cosine, sine = along.T / length
        turned = np.zeros((len(ends), 6, 6))
        for first in (0, 3):
            turned[:, first, first] = turned[:, first + 1, first + 1] = cosine
            turned[:, first, first + 1], turned[:, first + 1, first] = sine, -sine
            turned[:, first + 2, first + 2] = 1.0
        axial = np.array([member.section.axial for member in self.members]) / length
        bending = np.array([member.section.bending for member in self.members]) / length
        local = np.zeros((len(ends), 6, 6))
        local[:, [0, 3], [0, 3]] = axial[:, None]
        local[:, [0, 3], [3, 0]] = -axial[:, None]
        # displacements across, and rotations: two columns (-1/L or 1/L, 1) and the moments that they meet
        slope = np.zeros((len(ends), 2, 6))
        slope[:, :, 1], slope[:, :, 4] = 1 / length[:, None], -1 / length[:, None]
        slope[:, 0, 2] = slope[:, 1, 5] = 1.0
        hinged = np.array([member.hinged for member in self.members])
        flexure = bending[:, None, None] * _flexure(hinged)
        return turned, local + np.einsum("mia,mij,mjb->mab", slope, flexure, slope, optimize=True)

    def _expect_stable(self, stiffness: NDArray[np.float64]) -> None:
        diagonal = np.diag(stiffness)
        numbers = self.coordinates()
        found = int(np.argmin(diagonal))
        if diagonal[found] > 0:
            root = np.sqrt(diagonal)
            values, vectors = linalg.eigh(stiffness / np.outer(root, root), subset_by_index=(0, 0))
            if values[0] > LEAST_STIFFNESS:
                return
            found = int(np.argmax(np.abs(vectors[:, 0])))
        node, direction = np.argwhere(numbers == found)[0]
        raise AbraceError(f"frame: {DIRECTIONS[direction]} of node {node}: nothing holds it, expected a stable frame")


def _flexure(hinged: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(members, 2, 2) moments over EI/L at both ends, of the ends' rotations against the chord."""
    start, end = hinged.T
    found = np.zeros((len(hinged), 2, 2))
    both, one = ~start & ~end, start ^ end
    found[both] = [[4.0, 2.0], [2.0, 4.0]]
    found[one & end, 0, 0] = 3.0
    found[one & start, 1, 1] = 3.0
    return found
