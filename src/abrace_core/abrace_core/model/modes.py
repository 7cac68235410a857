# SPDX-License-Identifier: Apache-2.0
"""The same mode in two sets of modes: by frequency and, where they are known, by mode shapes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import linear_sum_assignment

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

SAME_MODE = 0.05
"""Greatest relative difference in frequency of the same mode in two models: fits differ by some percent at most, and
neighbouring modes of a building by more."""

MOVED = 0.1
"""Of a mode in two tests, which may have moved between them."""


def nearest_mode(frequencies: ArrayLike, frequency: float) -> int | None:
    """Number of the mode with this `frequency` among those with these `frequencies`; None: it is none of them."""
    apart = np.abs(np.asarray(frequencies) / frequency - 1)
    return int(np.argmin(apart)) if apart.size and apart.min() < SAME_MODE else None


def modal_assurance(one: NDArray[Any], other: NDArray[Any]) -> NDArray[np.float64]:
    """Modal assurance criterion of mode shapes, 1 for the same shape and 0 for orthogonal ones (Allemang 1982).

    Parameters
    ----------
    one, other
        (modes, channels) and (other modes, channels).

    Returns
    -------
    NDArray
        (modes, other modes).
    """
    product = np.abs(one.conj() @ other.T) ** 2
    sizes = np.outer(np.sum(np.abs(one) ** 2, axis=1), np.sum(np.abs(other) ** 2, axis=1))
    return np.asarray(product / np.maximum(sizes, np.finfo(float).tiny))


def match_modes(
    one: ArrayLike,
    other: ArrayLike,
    alike: NDArray[np.float64] | None = None,
    least_alike: float = 0.0,
    tolerance: float = MOVED,
) -> list[tuple[int, int]]:
    """Indices of the modes that two sets have in common, each used once.

    Parameters
    ----------
    one, other
        (modes,) and (other modes,) frequencies.
    alike
        (modes, other modes) modal assurance; the modes that are most alike are matched. None: the nearest ones.
    least_alike
        Least modal assurance of the same mode.
    tolerance
        Greatest relative difference of the frequencies.
    """
    first, second = np.asarray(one, dtype=np.float64), np.asarray(other, dtype=np.float64)
    if not len(first) or not len(second):
        return []
    apart = np.abs(second / first[:, None] - 1)
    cost = apart / tolerance if alike is None else 1 - alike + apart / tolerance
    possible = (apart <= tolerance) & (True if alike is None else alike >= least_alike)
    cost = np.where(possible, cost, 1e6)
    rows, columns = linear_sum_assignment(cost)
    return [(i, j) for i, j in zip(rows.tolist(), columns.tolist(), strict=True) if possible[i, j]]
