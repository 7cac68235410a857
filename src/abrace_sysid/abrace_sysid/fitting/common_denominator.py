"""Several transfer functions as ratios of polynomials of s with one denominator: Eq. (1) for more than one output.

One numerator for each output, and the Sanathanan-Koerner iterations of `curve_fit`. The numerators are condensed out by
an orthogonal factorisation of each output (as by Deschrijver et al. 2008 for vector fitting), which leaves a linear
problem of the denominator alone; the cost grows linearly with lines and outputs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError
from abrace_sysid.fitting.curve_fit import CONVERGED, ITERATIONS, RationalFit, least_squares

if TYPE_CHECKING:
    from numpy.typing import NDArray


def fit_common_denominator(
    omega: NDArray[np.float64],
    responses: NDArray[np.complex128],
    denominator_order: int,
    numerator_order: int,
    weights: NDArray[np.float64],
) -> list[RationalFit]:
    """A fit of each output, all with the same denominator, by Sanathanan-Koerner iterations.

    Of all iterations the one with the least weighted error is returned.

    Parameters
    ----------
    omega
        (lines,) angular frequencies [rad/s].
    responses
        (lines, outputs) transfer functions.
    denominator_order, numerator_order
        m and n.
    weights
        (lines, outputs) lambda.

    Raises
    ------
    AbraceError
        If there are too few lines, or a value is not finite.
    """
    m, n = denominator_order, numerator_order
    if 2 * len(omega) < m + n + 1:
        raise AbraceError(f"curve fit: {len(omega)} frequency lines, expected at least {(m + n + 2) // 2}")
    if not np.isfinite(responses).all():
        raise AbraceError("curve fit: a transfer function has a value that is not finite")
    scale = float(omega.max())
    s = 1j * omega / scale
    powers = np.vander(s, max(m, n) + 1)
    above, below, leading = powers[:, -(n + 1) :], powers[:, -m:], s**m
    past = np.ones(len(omega))
    best: list[RationalFit] | None = None
    least, before = np.inf, np.inf
    for _ in range(ITERATIONS):
        root = np.sqrt(weights) / past[:, None]
        rows = []
        for g, weight in zip(responses.T, root.T, strict=True):
            columns = np.hstack([above, -below * g[:, None], (leading * g)[:, None]]) * weight[:, None]
            r = np.asarray(np.linalg.qr(np.vstack([columns.real, columns.imag]), mode="r"), dtype=np.float64)
            rows.append(r[n + 1 :, n + 1 :])
        condensed = np.vstack(rows).astype(np.complex128)
        a = least_squares(condensed[:, :-1], condensed[:, -1:])[:, 0]
        denominator = np.concatenate([[1.0], a])
        values = np.polyval(denominator, s)
        fits, error = [], 0.0
        for g, weight in zip(responses.T, np.sqrt(weights).T, strict=True):
            # with the denominator given, the numerator that fits best in the weights themselves
            columns = above * (weight / values)[:, None]
            fit = RationalFit(least_squares(columns, (g * weight)[:, None])[:, 0], denominator, scale)
            error += float(np.sum(np.abs(weight * (fit.response(omega) - g)) ** 2))
            fits.append(fit)
        if error < least:
            best, least = fits, error
        if abs(before - error) <= CONVERGED * error:
            break
        before, past = error, np.abs(values)
    if best is None:
        raise AbraceError("curve fit: no iteration gave a finite error; are the transfer functions zero?")
    return best
