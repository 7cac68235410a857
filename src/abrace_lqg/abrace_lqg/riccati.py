# SPDX-License-Identifier: Apache-2.0
"""Gains of the optimal regulator and of the Kalman filter, from algebraic Riccati equations.

The regulator minimises Eq. (11) with z-bar = C_z Z + D_z U, which gives cross terms of states and commands; the Kalman
filter takes into account that the ground acceleration both drives the states and feeds through to the measured
quantities (F_y), so that process and measurement noise are correlated (Anderson & Moore, Optimal Control: Linear
Quadratic Methods, chapters 3 and 7).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from abrace_core import AbraceError

if TYPE_CHECKING:
    from numpy.typing import NDArray

RESIDUAL_LIMIT = 1e-8
"""Greatest residual of a Riccati equation, relative to its largest term."""


def regulator(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    c: NDArray[np.float64],
    d: NDArray[np.float64],
    q: NDArray[np.float64],
    r: NDArray[np.float64],
) -> NDArray[np.float64]:
    """K of U = -K Z that minimises the mean of z' Q z + U' R U with z = C Z + D U (Eq. 11).

    Parameters
    ----------
    a, b, c, d
        Shapes (states, states), (states, commands), (outputs, states), (outputs, commands).
    q, r
        Weights (outputs, outputs) and (commands, commands).

    Returns
    -------
    NDArray
        (commands, states).
    """
    return _gain(a, b, (c.T @ q @ c, r + d.T @ q @ d, c.T @ q @ d), "regulator")


def kalman(
    a: NDArray[np.float64],
    e: NDArray[np.float64],
    c: NDArray[np.float64],
    f: NDArray[np.float64],
    v: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Gain L of the Kalman filter for Z' = A Z + E W, y = C Z + F W + v, with W white of unit intensity.

    Parameters
    ----------
    a, e, c, f
        Shapes (states, states), (states, excitations), (measured, states), (measured, excitations).
    v
        Intensity of the measurement noise (measured, measured).

    Returns
    -------
    NDArray
        (states, measured).
    """
    return _gain(a.T, c.T, (e @ e.T, v + f @ f.T, e @ f.T), "Kalman filter").T


def _gain(
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    weights: tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]],
    name: str,
) -> NDArray[np.float64]:
    """K = R^-1 (B'X + S') of the stabilising X of A'X + X A - (X B + S) R^-1 (B'X + S') + Q = 0, checked.

    python-control's, of states scaled so that A is balanced, inputs so that R has a unit diagonal, and weights so that
    Q and B R^-1 B' are of one size. Without that its gains for a rig in metres and newtons are off by up to 6e-7.

    Parameters
    ----------
    b
    name
        What the equation is of.

    Raises
    ------
    AbraceError
        If there is no solution, its residual is too large, or it is not stabilising.
    """
    import control

    q, r, s = weights
    _, (scale, _) = linalg.matrix_balance(a, permute=False, separate=True)
    root = np.sqrt(np.diag(r))
    a = a * scale / scale[:, None]
    b = b / scale[:, None] / root
    q = q * np.outer(scale, scale)
    s = s * scale[:, None] / root
    r = r / np.outer(root, root)
    size = np.sqrt(linalg.norm(q) / linalg.norm(b @ linalg.solve(r, b.T, assume_a="pos"))) or 1.0
    q, r, s = (q + q.T) / 2 / size, (r + r.T) / 2 / size, s / size
    try:
        gain, x, poles = control.lqr(a, b, q, r, s, method="scipy")
    except (control.ControlArgument, linalg.LinAlgError, ValueError) as error:
        raise AbraceError(f"design: the {name}'s Riccati equation has no solution ({error})") from error
    terms = (a.T @ x, x @ a, -(x @ b + s) @ gain, q)
    residual = linalg.norm(sum(terms)) / max(linalg.norm(term) for term in terms)
    if not residual < RESIDUAL_LIMIT:
        raise AbraceError(
            f"design: the {name}'s Riccati equation has a relative residual of {residual:.1e}, "
            f"expected less than {RESIDUAL_LIMIT:.0e}"
        )
    if poles.real.max() >= 0:
        raise AbraceError(f"design: the {name} is not stable")
    return np.asarray(gain / root[:, None] / scale)
