# SPDX-License-Identifier: Apache-2.0
"""Columns of a least-squares problem over the lines of several records, most of which belong to one record alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import blas

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True)
class RecordColumns:
    """Real columns over all rows, as a block of each record: what others of the columns have there is zero.

    Parameters
    ----------
    height, count
        Number of rows and of columns.
    rows
        Of each block the indices of its rows.
    places
        Of each block the indices of its columns, rising.
    blocks
        (rows, columns) of each record.
    """

    height: int
    count: int
    rows: tuple[NDArray[np.int64], ...]
    places: tuple[NDArray[np.int64], ...]
    blocks: tuple[NDArray[np.float64], ...]

    def beside(self, other: RecordColumns) -> RecordColumns:
        """These columns, and those of an `other` after them, of the same records."""
        places = tuple(
            np.concatenate([mine, self.count + theirs]) for mine, theirs in zip(self.places, other.places, strict=True)
        )
        blocks = tuple(np.concatenate(both, axis=1) for both in zip(self.blocks, other.blocks, strict=True))
        return replace(self, count=self.count + other.count, places=places, blocks=blocks)

    def weighted(self, weight: NDArray[np.float64]) -> RecordColumns:
        """The rows times a `weight` (rows,); without the records where it is zero."""
        kept = [i for i, rows in enumerate(self.rows) if weight[rows[0]]]
        rows, places = (tuple(each[i] for i in kept) for each in (self.rows, self.places))
        blocks = tuple(self.blocks[i] * weight[self.rows[i], None] for i in kept)
        return replace(self, rows=rows, places=places, blocks=blocks)

    def times(self, coefficients: NDArray[np.float64]) -> NDArray[np.float64]:
        """(rows, k) the columns times `coefficients` (columns, k)."""
        found = np.zeros((self.height, coefficients.shape[1]))
        for rows, places, block in zip(self.rows, self.places, self.blocks, strict=True):
            found[rows] = block @ coefficients[places]
        return found

    def onto(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """(columns, k) the products of the columns with `values` (rows, k)."""
        found = np.zeros((self.count, values.shape[1]))
        for rows, places, block in zip(self.rows, self.places, self.blocks, strict=True):
            found[places] += block.T @ values[rows]
        return found

    def squares(self) -> NDArray[np.float64]:
        """(columns, columns) their products with each other; the lower triangle alone."""
        found = np.zeros((self.count, self.count))
        for places, block in zip(self.places, self.blocks, strict=True):
            found[np.ix_(places, places)] += blas.dsyrk(1.0, block, trans=1, lower=1)
        return found

    def products(self, other: RecordColumns) -> NDArray[np.float64]:
        """(columns, other columns) the products with those of an `other`, of the same records."""
        found = np.zeros((self.count, other.count))
        every = zip(self.places, self.blocks, other.places, other.blocks, strict=True)
        for mine, block, theirs, beside in every:
            found[np.ix_(mine, theirs)] += block.T @ beside
        return found
