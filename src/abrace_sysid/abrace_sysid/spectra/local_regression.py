# SPDX-License-Identifier: Apache-2.0
"""Least squares of the local polynomial and local rational methods, for all frequency lines at once.

Each line of a record's discrete Fourier transform obeys Y(k) = G(k) U(k) + T(k) + V(k). Over a window of neighbouring
lines the response G and the transient (leakage) T are approximated by polynomials of the line number. Both are found
by least squares; the residual is the noise V (Pintelon and Schoukens 2012, ch. 7). In a short record a lightly damped
mode is narrower than any window. For this the rational method gives G and T a common pole, shared by all channels
(McKelvey and Guerin 2012; A Y = B U + C + A V with A = 1 + a r).

The transient's polynomials span the same space in every window, so one fixed projection removes them. Several records
share the response; each has its own transient.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from abrace_core import AbraceError

if TYPE_CHECKING:
    from numpy.typing import NDArray

WINDOWS_AT_ONCE = 128
"""Number of windows that are solved together; their data fit into the processor's cache."""

WEIGHING_WINDOWS = 256
"""Number of windows, evenly spread over the band, from which the channels' noise, and so their weights, are estimated.

The weights apply to the fit of the shared pole.
"""

DEPENDENT = 1e-6
"""An input is linearly dependent if less than this share of it is independent of the other inputs."""


def least_half_width(degree: int, inputs: int = 1, records: int = 1) -> int:
    """The narrowest window, in lines on either side, that leaves residuals for an estimate of the noise.

    Parameters
    ----------
    inputs, records
    degree
        Degree of the polynomials.
    """
    lines = (degree + 1) * (inputs + records) / records
    return int(lines / 2 + 0.5)


def check_window(degree: int, half_width: int, lines: float, inputs: int, records: int, poles: Literal[0, 1]) -> None:
    """Check that windows fit into a band, and have lines enough for their unknowns.

    Parameters
    ----------
    inputs, records
    degree, half_width, poles
        As of `fit_locally`.

    Raises
    ------
    AbraceError
        If not.
    """
    method, window = f"local {'rational' if poles else 'polynomial'} method", 2 * half_width + 1
    least = least_half_width(max(degree, 0), inputs, records) + poles
    if degree < 0 or half_width < least:
        found = f"degree {degree} and half_width {half_width}"
        raise AbraceError(f"{method}: {found}, expected degree >= 0 and half_width >= {least}")
    if lines < window:
        raise AbraceError(f"{method}: {lines:.0f} lines in the band, expected at least {window}")


def fit_locally(
    excitation: NDArray[np.complex128],
    outputs: NDArray[np.complex128],
    degree: int,
    half_width: int,
    poles: Literal[0, 1] = 1,
) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """Fit the response and the transients in a window about every line.

    Parameters
    ----------
    excitation
        (records, lines, inputs) consecutive lines of the inputs' transforms.
    outputs
        (records, lines, channels) the same lines of the outputs' transforms.
    degree
        Degree of the polynomials B and C.
    half_width
        Lines on either side of the centre line; at the ends of the band the windows are shifted inwards.
    poles
        0: polynomial; 1: rational, with one pole shared by the channels.

    Returns
    -------
    response, sigma
        (lines, channels, inputs) estimates and their standard deviations.

    Raises
    ------
    AbraceError
        If the window has too few lines, the band has fewer lines than the window, or the inputs are not independent.
    """
    records, lines, inputs = excitation.shape
    channels = outputs.shape[2]
    check_window(degree, half_width, lines, inputs, records, poles)
    window = 2 * half_width + 1
    grid = _Grid(excitation, outputs, degree, half_width)
    windows = lines - window + 1
    weight = np.zeros(channels)
    if poles:
        some = np.unique(np.linspace(0, windows - 1, min(windows, WEIGHING_WINDOWS)).astype(np.int64))
        variance = np.median(grid.solve(some, weight).variance, axis=0)
        weight = np.divide(1.0, variance, out=weight, where=variance > 0)
    response = np.empty((lines, channels, inputs), dtype=np.complex128)
    sigma = np.empty((lines, channels, inputs))
    for start in range(0, windows, WINDOWS_AT_ONCE):
        stop = min(start + WINDOWS_AT_ONCE, windows)
        solved = grid.solve(np.arange(start, stop), weight)
        # each window gives the estimate at its middle line; the first and last also give those at the band's ends
        own = np.arange(start + half_width if start else 0, stop + half_width if stop < windows else lines)
        serving = np.clip(own - half_width, 0, windows - 1)
        response[own], sigma[own] = solved.at(serving - start, own - serving)
    return response, sigma


class _Grid:
    """All windows of a band, and the polynomials common to them."""

    def __init__(
        self, excitation: NDArray[np.complex128], outputs: NDArray[np.complex128], degree: int, half_width: int
    ) -> None:
        window = 2 * half_width + 1
        self.offset = np.linspace(-1, 1, window)
        basis, _ = np.linalg.qr(np.vander(self.offset, degree + 1, increasing=True), mode="complete")
        self.powers, self.complement = basis[:, : degree + 1], basis[:, degree + 1 :].T
        # an input's window times each polynomial, an output's times 1 and r, both with the transient projected out
        self.of_input = np.concatenate(self.complement * self.powers.T[:, None, :])
        self.of_output = np.concatenate([self.complement, self.complement * self.offset])
        # (window, windows, records x inputs or channels)
        self.excitation = _sliding(excitation, window)
        self.outputs = _sliding(outputs, window)
        self.records, self.inputs, self.channels = len(excitation), excitation.shape[2], outputs.shape[2]

    def solve(self, starts: NDArray[np.int64], weight: NDArray[np.float64]) -> _Solved:
        """Least squares in the windows that begin at the lines `starts`; without a pole if all weights are zero."""
        polynomials, rows = self.powers.shape[1], len(self.complement)
        count, unknowns = len(starts), self.inputs * polynomials
        # (windows, columns, records x rows)
        left = _times(self.of_input, self.excitation[:, starts]).reshape(
            polynomials, rows, count, self.records, self.inputs
        )
        q = np.ascontiguousarray(left.transpose(4, 0, 3, 1, 2)).reshape(unknowns, self.records * rows, count)
        triangle = np.zeros((unknowns, unknowns, count), dtype=np.complex128)
        excited = np.sqrt(_square(q).sum(axis=1))
        for j in range(unknowns):
            length = np.sqrt(_square(q[j]).sum(axis=0))
            if not (length > DEPENDENT * excited[j]).all():
                raise AbraceError("local fits: an input is zero, or repeats another one, within the band")
            q[j] /= length
            triangle[j, j] = length
            for k in range(j + 1, unknowns):
                share = np.sum(q[j].conj() * q[k], axis=0)
                q[k] -= q[j] * share
                triangle[j, k] = share
        directions = np.ascontiguousarray(q.transpose(2, 1, 0))
        pole_sought = bool(weight.any())
        of_output = self.of_output if pole_sought else self.complement
        left = _times(of_output, self.outputs[:, starts])
        left = left.reshape(1 + pole_sought, rows, count, self.records, self.channels)
        measured = np.ascontiguousarray(left.transpose(2, 0, 4, 3, 1)).reshape(count, -1, self.records * rows)
        projected = measured @ directions.conj()
        measured -= projected @ directions.swapaxes(1, 2)
        freedom = self.records * rows - unknowns - pole_sought / self.channels
        pole, pole_variance = np.zeros(count, dtype=np.complex128), np.zeros(count)
        left_over = measured[:, : self.channels]
        if pole_sought:
            by_pole = measured[:, self.channels :]
            curvature = np.sum(_square(by_pole), axis=2) @ weight
            slope = np.einsum("wcr,wcr->wc", by_pole.conj(), left_over) @ weight
            inverse = np.divide(1.0, curvature, out=np.zeros_like(curvature), where=curvature > 0)
            pole = -slope * inverse
            left_over = left_over + pole[:, None, None] * by_pole
            pole_variance = inverse * (np.sum(_square(left_over), axis=2) @ weight) / (freedom * self.channels)
        return _Solved(self, triangle, projected, left_over, pole, pole_variance, freedom)


@dataclass(frozen=True)
class _Solved:
    """Least-squares solution in some windows: R, Q^H [y, r y], the residual of y + a r y, and a."""

    grid: _Grid
    triangle: NDArray[np.complex128]
    projected: NDArray[np.complex128]
    left_over: NDArray[np.complex128]
    pole: NDArray[np.complex128]
    pole_variance: NDArray[np.float64]
    freedom: float

    @property
    def variance(self) -> NDArray[np.float64]:
        """(windows, channels) variance of A V."""
        return np.asarray(np.sum(_square(self.left_over), axis=2) / self.freedom)

    def at(
        self, which: NDArray[np.int64], position: NDArray[np.int64]
    ) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
        """Response and standard deviation (lines, channels, inputs), each line at a position within its window.

        Without a pole, the response is p.T R^-1 Q^H y with p the polynomials' values at the position.
        """
        grid, channels = self.grid, self.grid.channels
        polynomials, unknowns = grid.powers.shape[1], len(self.triangle)
        offset, pole = grid.offset[position][:, None], self.pole[which][:, None]
        response = np.empty((len(which), channels, grid.inputs), dtype=np.complex128)
        sigma = np.empty((len(which), channels, grid.inputs))
        for i in range(grid.inputs):
            values = np.zeros((unknowns, len(which)), dtype=np.complex128)
            values[i * polynomials : (i + 1) * polynomials] = grid.powers[position].T
            row = np.empty_like(values)
            for j in range(unknowns):
                row[j] = values[j] / self.triangle[j, j, which]
                values[j + 1 :] -= self.triangle[j, j + 1 :, which].T * row[j]
            evaluated = np.einsum("ul,lcu->lc", row, self.projected[which])
            variance = _square(row).sum(axis=0)[:, None] * self.variance[which]
            denominator = 1 + pole * offset
            response[:, :, i] = evaluated[:, :channels]
            if evaluated.shape[1] > channels:
                by_pole = evaluated[:, channels:]
                response[:, :, i] = (evaluated[:, :channels] + pole * by_pole) / denominator
                variance += _square(by_pole - response[:, :, i] * offset) * self.pole_variance[which][:, None]
            sigma[:, :, i] = np.sqrt(variance) / np.abs(denominator)
        return response, sigma


def _sliding(lines: NDArray[np.complex128], window: int) -> NDArray[np.complex128]:
    """(window, windows, records x columns) view of (records, lines, columns)."""
    side_by_side = np.concatenate(list(lines), axis=1)
    return sliding_window_view(side_by_side, window, axis=0).transpose(2, 0, 1)


def _times(matrix: NDArray[np.float64], columns: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """A real matrix times complex columns (window, windows, columns), flattened, without making it complex."""
    flat = np.ascontiguousarray(columns).reshape(len(columns), -1).view(np.float64)
    return np.asarray((matrix @ flat).view(np.complex128))


def _square(value: NDArray[np.complex128]) -> NDArray[np.float64]:
    return np.asarray(value.real**2 + value.imag**2)
