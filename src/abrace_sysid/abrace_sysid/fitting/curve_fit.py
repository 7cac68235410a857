# SPDX-License-Identifier: Apache-2.0
"""What fits of poles have in common: least squares, triangular factors, weights, and the refusal of unstable poles."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

RELATIVE_ERROR = 0.01
"""Error of the model class, as a share of |g|, that is added to a line's variance."""


INDEPENDENT = 1e-4
"""Share of every column that the others leave unexplained, above which products of columns are as good as a QR."""


def least_squares(columns: NDArray[np.complex128], right: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Real solution (unknowns, problems) of `columns` x = `right` in the complex least-squares sense."""
    both = stacked(columns)
    length = np.linalg.norm(both, axis=0)
    length[length == 0] = 1.0
    solution = np.linalg.lstsq(both / length, stacked(right), rcond=None)[0]
    return np.asarray(solution / length[:, None])


def uncertainty_weights(g: NDArray[np.complex128], sigma: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights lambda = 1 / (sigma^2 + (0.01 |g|)^2) of each line of `g` with standard deviation `sigma`.

    Robust, where 1 / sigma^2 alone trusts a few lines too much.
    """
    variance = sigma**2 + (RELATIVE_ERROR * np.abs(g)) ** 2
    return np.asarray(1 / np.maximum(variance, np.finfo(float).tiny))


class UnstablePolesError(AbraceError):
    """Poles of a fit are unstable: `unstable` (poles,) tells which."""

    def __init__(self, message: str, unstable: NDArray[np.bool_]) -> None:
        super().__init__(message)
        self.unstable = unstable


def require_stable(poles: NDArray[np.complex128], where: str) -> NDArray[np.complex128]:
    """The `poles`, if all of them are stable; an error begins with `where` they come from.

    Raises
    ------
    UnstablePolesError
        Naming the unstable poles.
    """
    unstable = poles.real >= 0
    if unstable.any():
        named = ", ".join(f"{p.real:+.4g}{p.imag:+.4g}i" for p in poles[unstable] if p.imag >= 0)
        raise UnstablePolesError(
            f"{where}: unstable poles {named} rad/s, expected stable ones; "
            "a longer or stronger test, a narrower band or a lower order may help",
            unstable,
        )
    return poles


def stacked(lines: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Complex `lines` as real numbers: the real parts above the imaginary ones; column by column in memory."""
    half = len(lines)
    found = np.empty((2 * half, *lines.shape[1:]), order="F")
    found[:half], found[half:] = lines.real, lines.imag
    return found


def triangular_factor(rows: NDArray[np.float64], alike: Sequence[int] = ()) -> NDArray[np.float64]:
    """R of a QR factorization of `rows`, from the products of their columns where these are well apart.

    Columns that are nearly `alike`, given by rising index, are made orthogonal to each other before.
    """
    own, among = rows, np.zeros((0, 0))
    if len(alike) > 1:
        own = rows.copy(order="F")
        own[:, alike], among = np.linalg.qr(rows[:, alike])
    try:
        factor = np.asarray(linalg.cholesky(own.T @ own, check_finite=False))
    except linalg.LinAlgError:
        return _factorized(rows)
    if not (np.diag(factor) > INDEPENDENT * np.linalg.norm(factor, axis=0)).all():
        return _factorized(rows)
    if len(alike) > 1:
        factor[:, alike] = factor[:, alike] @ among
    return factor


def _factorized(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """R of a QR factorization of `rows`; without the copies that np.linalg.qr makes."""
    _, factor = linalg.qr(rows, mode="raw", check_finite=False)
    return np.asarray(factor)
