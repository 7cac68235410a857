# SPDX-License-Identifier: Apache-2.0
"""Finds the pole pairs that are modes of the building, and the same modes in several fits, by their mode shapes.

In a mode of the building the shape of the accelerations equals that of the displacements times the pole squared. In a
local mode (a slab, torsion, a brace) accelerations and strokes are large, but the floors' displacements are small.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_sysid.fitting.pole_estimate import PoleEstimate

ALIKE = 0.6
"""Greatest difference of both shapes, over the sum of their sizes, of a mode of the building."""

NEAR = 0.1
"""Greatest relative difference in frequency of the same mode in two fits."""


def building_modes(estimate: PoleEstimate, floors: int) -> NDArray[np.int64]:
    """(modes,) indices into `estimate.poles` of the building's pole pairs, slowest first.

    Parameters
    ----------
    estimate
        The fit; its outputs are displacements x1, x2 ... and accelerations a1, a2 ... of the same floors. Without
        these the slowest pairs are taken.
    floors
        Number of floors, which is the greatest number of modes.
    """
    pairs = np.flatnonzero(estimate.poles.imag > 0)
    pairs = pairs[np.argsort(np.abs(estimate.poles[pairs]))]
    names = estimate.outputs
    both = [f"{i + 1}" for i in range(floors) if f"x{i + 1}" in names and f"a{i + 1}" in names]
    if not both:
        return pairs[:floors]
    displacement, acceleration = (estimate.shapes[[names.index(kind + i) for i in both]] for kind in "xa")
    expected = displacement * estimate.poles**2
    difference, sizes = np.linalg.norm(acceleration - expected, axis=0), np.linalg.norm(acceleration, axis=0)
    unlike = (difference / np.maximum(sizes + np.linalg.norm(expected, axis=0), np.finfo(float).tiny))[pairs]
    chosen = np.argsort(unlike, kind="stable")[:floors]
    return pairs[np.sort(chosen[unlike[chosen] < ALIKE])]


def same_modes(estimate: PoleEstimate, wanted: NDArray[np.int64], other: PoleEstimate) -> NDArray[np.int64]:
    """(modes,) indices into `other.poles` of the modes `wanted` of `estimate`; -1: not found.

    Parameters
    ----------
    estimate, other
        Two fits with the same outputs.
    wanted
        (modes,) indices into `estimate.poles`, of pairs.
    """
    unit = np.sqrt(np.mean(np.abs(estimate.shapes[:, wanted]) ** 2, axis=1, keepdims=True))
    unit[unit == 0] = 1.0
    free = list(np.flatnonzero(other.poles.imag > 0))
    found = np.full(len(wanted), -1)
    for i, mode in enumerate(wanted):
        pole, shape = estimate.poles[mode], estimate.shapes[:, mode] / unit[:, 0]
        near = [k for k in free if abs(abs(other.poles[k]) / abs(pole) - 1) < NEAR]
        if near:
            alike = [assurance(shape, other.shapes[:, k] / unit[:, 0]) for k in near]
            found[i] = near[int(np.argmax(alike))]
            free.remove(found[i])
    return found


def assurance(one: NDArray[np.complex128], other: NDArray[np.complex128]) -> float:
    """The modal assurance criterion of two shapes `one` and `other` (Allemang 1982): 1 alike, 0 orthogonal."""
    sizes = float(np.vdot(one, one).real * np.vdot(other, other).real)
    return float(abs(np.vdot(one, other)) ** 2 / sizes) if sizes else 0.0
