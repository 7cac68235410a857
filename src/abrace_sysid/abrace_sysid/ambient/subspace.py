# SPDX-License-Identifier: Apache-2.0
"""Modes from responses only, with their uncertainty: covariance-driven stochastic subspace identification.

If the excitation is white over the band, the covariances R(k) of the responses at lags k = 1, 2, ... have the form of a
free decay of the structure. The block Hankel matrix of the R(k) has the rank of the system. Its left singular vectors
form an observability matrix, and the shift structure of that matrix gives poles and mode shapes (Peeters and De Roeck
1999). White sensor noise affects only R(0), which is not used.

The uncertainty of the R(k) is estimated from pieces of the record, and propagated to first order through singular
vectors, least squares and eigenvalues (Reynders, Pintelon and De Roeck 2008; Doehler and Mevel 2013).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


@dataclass(frozen=True)
class SubspaceModes:
    """The oscillating poles of one model order, lowest frequency first.

    Parameters
    ----------
    frequency, damping
        (modes,) modulus [rad/s] and damping ratio.
    covariance
        (modes, 2, 2) of frequency and damping ratio.
    shapes
        (modes, channels) complex mode shapes, the greatest entry of each 1.
    """

    order: int
    frequency: NDArray[np.float64]
    damping: NDArray[np.float64]
    covariance: NDArray[np.float64]
    shapes: NDArray[np.complex128]


class OutputCovariances:
    """The Hankel matrix of the output covariances, and its variation from piece to piece of the records.

    Parameters
    ----------
    records
        Each (samples, channels), of one structure and at the same rate, means removed.
    lags
        Number of block columns of the Hankel matrix, one less than its block rows; the longest lag is twice that.
    pieces
        Number of pieces into which all records together are cut.

    Raises
    ------
    AbraceError
        If a record is too short for the lags.
    """

    def __init__(self, records: Sequence[NDArray[np.float64]], lags: int, pieces: int) -> None:
        total = sum(len(record) - 2 * lags for record in records)
        self.lags, self.channels = lags, records[0].shape[1]
        covariances, weights = [], []
        for record in records:
            usable = len(record) - 2 * lags
            count = max(1, round(pieces * usable / total))
            if usable < 4 * lags * count:
                raise AbraceError(
                    f"{len(record)} samples in {count} pieces with lags up to {2 * lags}, expected at least "
                    f"{(4 * count + 2) * lags} samples"
                )
            edges = np.linspace(0, usable, count + 1).round().astype(int)
            for begin, end in itertools.pairwise(edges):
                covariances.append(_covariances(record, int(begin), int(end), 2 * lags))
                weights.append(end - begin)
        self.pieces = len(covariances)
        share = np.array(weights) / sum(weights)
        mean = np.einsum("j,jkab->kab", share, np.array(covariances))
        self.hankel = self._hankel(mean)
        # deviations of the mean: those of the pieces, weighted by each piece's share of the record
        scale = np.sqrt(self.pieces / (self.pieces - 1)) if self.pieces > 1 else np.inf
        self._deviations = [
            scale * part * self._hankel(one - mean) for part, one in zip(share, covariances, strict=True)
        ]
        self._left, self._singular, self._right = linalg.svd(self.hankel, full_matrices=False)

    def _hankel(self, covariances: NDArray[np.float64]) -> NDArray[np.float64]:
        """((lags + 1) channels, lags channels) from (2 lags, channels, channels), the first of lag 1."""
        rows, columns = np.arange(self.lags + 1)[:, None], np.arange(self.lags)
        blocks = covariances[np.minimum(rows + columns, 2 * self.lags - 1)]
        return np.asarray(blocks.swapaxes(1, 2).reshape((self.lags + 1) * self.channels, self.lags * self.channels))

    def modes(self, orders: Sequence[int], sample_period: float) -> list[SubspaceModes]:
        """The oscillating poles of each of the `orders`; `sample_period` [s] is that of the records."""
        highest = max(orders)
        projected = np.array([deviation @ self._right[:highest].T for deviation in self._deviations])
        return [self._modes(order, projected[:, :, :order], sample_period) for order in orders]

    def _modes(self, order: int, projected: NDArray[np.float64], sample_period: float) -> SubspaceModes:
        observability = self._left[:, :order]
        # to first order the singular vectors move within their space, which changes no pole, and out of it; singular
        # values beyond the order are noise, taken as small
        moved = projected / self._singular[:order]
        moved = moved - observability @ (observability.T @ moved)
        above, below = observability[: -self.channels], observability[self.channels :]
        inverse = np.linalg.pinv(above)
        a = inverse @ below
        left_over = below - above @ a
        gram = np.linalg.inv(above.T @ above)
        change = (
            inverse @ (moved[:, self.channels :] - moved[:, : -self.channels] @ a)
            + gram @ moved[:, : -self.channels].swapaxes(1, 2) @ left_over
        )
        values, left, right = _eigenvectors(a)
        scale = np.sum(left.conj() * right, axis=0)
        changes = np.einsum("ai,jab,bi->ji", left.conj(), change, right) / scale
        chosen = np.flatnonzero((values.imag > 0) & (np.abs(values) < 1))
        discrete, changes = values[chosen], changes[:, chosen]
        poles = np.log(discrete) / sample_period
        moves = changes / discrete / sample_period
        frequency, damping = np.abs(poles), -poles.real / np.abs(poles)
        of_frequency = np.real(poles.conj() * moves) / frequency
        of_damping = -moves.real / frequency - damping * of_frequency / frequency
        both = np.stack([of_frequency, of_damping], axis=-1)
        shapes = (self._left[: self.channels, :order] @ right[:, chosen]).T
        greatest = np.argmax(np.abs(shapes), axis=1)
        shapes = shapes / shapes[np.arange(len(shapes)), greatest][:, None]
        by_frequency = np.argsort(frequency)
        return SubspaceModes(
            order,
            frequency[by_frequency],
            damping[by_frequency],
            np.einsum("jma,jmb->mab", both, both)[by_frequency],
            shapes[by_frequency],
        )


def _eigenvectors(
    a: NDArray[np.float64],
) -> tuple[NDArray[np.complex128], NDArray[np.complex128], NDArray[np.complex128]]:
    """Eigenvalues, left and right eigenvectors."""
    values, right = np.linalg.eig(a.astype(np.complex128))
    return values, np.linalg.inv(right).conj().T, right


def _covariances(record: NDArray[np.float64], begin: int, end: int, lags: int) -> NDArray[np.float64]:
    """(lags, channels, channels) mean of y(t + k) y(t)' over t from `begin` to `end`, k from 1."""
    now = record[begin:end]
    return np.array([record[begin + k : end + k].T @ now for k in range(1, lags + 1)]) / (end - begin)
