# SPDX-License-Identifier: Apache-2.0
"""Curve fitting of transfer functions by ratios of two polynomials of s: Eqs. (1) and (2) of the paper.

Eq. (1) is the set of normal equations of the linear least-squares problem

    minimise sum_j lambda_j |B(i w_j) - A(i w_j) g_j|^2,   A monic of order m, B of order n.

As printed it has a sign error: its upper right block is **-**Omega* Lambda Gamma. Here the same problem is solved by
orthogonal factorisation, s in units of the highest frequency and columns scaled to unit length, which gives the same
coefficients without squaring the condition number (harmless at order 12 up to 190 rad/s).

Eq. (1) weights the error of g_j by |A(i w_j)|^2, which no fixed lambda undoes. The Sanathanan-Koerner iterations do, by
dividing lambda by the last |A|^2 until A no longer changes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from numpy.typing import NDArray

RELATIVE_ERROR = 0.01
"""Error of the model class, as a share of |g|, that is added to a line's variance."""

ITERATIONS = 50
CONVERGED = 1e-8


@dataclass(frozen=True)
class RationalFit:
    """A ratio of two polynomials of s, in the scaled variable s / frequency_scale.

    Parameters
    ----------
    numerator
        (n + 1,) b_n ... b_0, highest power first.
    denominator
        (m + 1,) 1, a_(m-1) ... a_0, highest power first.
    frequency_scale
        [rad/s].
    """

    numerator: NDArray[np.float64]
    denominator: NDArray[np.float64]
    frequency_scale: float

    def poles(self) -> NDArray[np.complex128]:
        """Roots of the denominator [rad/s], slowest first."""
        poles = np.roots(self.denominator).astype(np.complex128) * self.frequency_scale
        return poles[np.argsort(np.abs(poles), kind="stable")]

    def response(self, omega: NDArray[np.float64]) -> NDArray[np.complex128]:
        """(lines,) at the angular frequencies `omega` [rad/s]."""
        s = 1j * omega / self.frequency_scale
        return np.asarray(np.polyval(self.numerator, s) / np.polyval(self.denominator, s))


def fit_rational(
    omega: NDArray[np.float64],
    g: NDArray[np.complex128],
    denominator_order: int,
    numerator_order: int,
    weights: NDArray[np.float64] | None = None,
) -> RationalFit:
    """Coefficients by Eqs. (1) and (2).

    Parameters
    ----------
    omega
        (lines,) angular frequencies w_j [rad/s].
    g
        (lines,) transfer function.
    denominator_order, numerator_order
        m and n.
    weights
        (lines,) lambda_j, 1 by default.

    Raises
    ------
    AbraceError
        If there are too few lines, or a value is not finite.
    """
    unknowns = denominator_order + numerator_order + 1
    if 2 * len(omega) < unknowns:
        raise AbraceError(f"curve fit: {len(omega)} frequency lines, expected at least {(unknowns + 1) // 2}")
    if not np.isfinite(g).all():
        raise AbraceError("curve fit: the transfer function has a value that is not finite")
    root = np.ones(len(omega)) if weights is None else np.sqrt(weights)
    scale = float(omega.max())
    s = 1j * omega / scale
    powers = np.vander(s, max(denominator_order, numerator_order) + 1)
    of_numerator = powers[:, -(numerator_order + 1) :]
    of_denominator = powers[:, -denominator_order:] * g[:, None]
    columns = np.asarray(np.hstack([of_numerator, -of_denominator]) * root[:, None], dtype=np.complex128)
    right = np.asarray(s**denominator_order * g * root, dtype=np.complex128)
    solution = least_squares(columns, right[:, None])[:, 0]
    b, a = solution[: numerator_order + 1], solution[numerator_order + 1 :]
    return RationalFit(b, np.concatenate([[1.0], a]), scale)


def least_squares(columns: NDArray[np.complex128], right: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Real solution (unknowns, problems) of `columns` x = `right` in the complex least-squares sense."""
    stacked = np.vstack([columns.real, columns.imag])
    length = np.linalg.norm(stacked, axis=0)
    length[length == 0] = 1.0
    solution = np.linalg.lstsq(stacked / length, np.vstack([right.real, right.imag]), rcond=None)[0]
    return np.asarray(solution / length[:, None])


def uncertainty_weights(g: NDArray[np.complex128], sigma: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights lambda = 1 / (sigma^2 + (0.01 |g|)^2) of each line of `g` with standard deviation `sigma`.

    Robust, where 1 / sigma^2 alone trusts a few lines too much.
    """
    variance = sigma**2 + (RELATIVE_ERROR * np.abs(g)) ** 2
    return np.asarray(1 / np.maximum(variance, np.finfo(float).tiny))


def fit_sanathanan_koerner(
    omega: NDArray[np.float64],
    g: NDArray[np.complex128],
    denominator_order: int,
    numerator_order: int,
    weights: NDArray[np.float64],
) -> RationalFit:
    """Coefficients by Sanathanan-Koerner iterations: Eq. (1) with lambda / |A|^2 of the iteration before.

    Parameters and errors as in `fit_rational`. Of all iterations the one with the least weighted error is returned.
    """
    past_denominator = np.ones(len(omega))
    best, least, before = None, np.inf, np.inf
    for _ in range(ITERATIONS):
        fit = fit_rational(omega, g, denominator_order, numerator_order, weights / past_denominator)
        error = float(np.sum(weights * np.abs(fit.response(omega) - g) ** 2))
        if error < least:
            best, least = fit, error
        if abs(before - error) <= CONVERGED * error:
            break
        before = error
        past_denominator = np.abs(np.polyval(fit.denominator, 1j * omega / fit.frequency_scale)) ** 2
    if best is None:
        raise AbraceError("curve fit: no iteration gave a finite error; is the transfer function zero?")
    return best


def require_stable(poles: NDArray[np.complex128], where: str) -> NDArray[np.complex128]:
    """The `poles`, if all of them are stable; an error begins with `where` they come from.

    Raises
    ------
    AbraceError
        Naming the unstable poles.
    """
    unstable = poles[poles.real >= 0]
    if len(unstable):
        named = ", ".join(f"{p.real:+.4g}{p.imag:+.4g}i" for p in unstable if p.imag >= 0)
        raise AbraceError(
            f"{where}: unstable poles {named} rad/s, expected stable ones; "
            "a longer or stronger test, a narrower band or a lower order may help"
        )
    return poles
