# SPDX-License-Identifier: Apache-2.0
"""The noise of every line, estimated from what a fit leaves: smooth over frequency, and what passes through the model.

The variance of an output's line is a sum of parts that cannot be negative, each smooth over frequency or a constant:

    sensors                  a(f)
    noise of the inputs      b(f) |G(f)|^2
    errors in proportion     c(f) |G(f) U(f)|^2, of nonlinearity and aliasing
    forces not measured      d_i |1 / (i w - p_i)|^2

A peak of the last three is as narrow as a mode and is none. Their sizes are those of maximum likelihood of |E|^2, which
is distributed exponentially, by multiplicative steps (Itakura and Saito 1968; Févotte and Idier 2011).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.line_fit import LineFit

SMOOTH, SMOOTH_OF_INPUT = (60, 0.2), (100, 0.3)
"""Least distance of the knots [lines] and as a share of the line's number: of a; of b and c."""

FLOOR = 1e-10
"""Least variance, as a share of the mean power measured: 100 dB."""

PAYS = 20.0
"""By so much for each output -2 log likelihood must fall for the parts that pass through the model."""

FIRST_STEPS, STEPS, LAST_STEPS = 30, 40, 150
"""Multiplicative steps: of a alone, of all parts, and at the end of a search."""


class LineNoise(NamedTuple):
    """The noise after a fit.

    Parameters
    ----------
    variance
        (lines, outputs).
    cost
        -2 log likelihood of what the fit leaves, less a constant.
    passes_through
        Whether noise of the inputs, errors in proportion or unmeasured forces are part of it.
    """

    variance: NDArray[np.float64]
    cost: float
    passes_through: bool


def noise_of(fit: LineFit, steps: int = STEPS) -> LineNoise:
    """The noise of every line of every output.

    Parameters
    ----------
    fit
        Whose residual it is.
    steps
        Number of multiplicative steps.
    """
    lines, error, response = fit.lines, fit.errors(), fit.responses()
    forced = np.einsum("kpm,km->kp", response, lines.excitation)
    variance, cost, through = np.ones(error.shape), 0.0, False
    tiny = np.finfo(float).tiny
    for rows, present in zip(lines.rows, lines.present, strict=True):
        groups = [group for group in lines.groups if present[group[0]]]
        count = rows.stop - rows.start
        left = count - fit.coefficients.shape[0] / 2 / len(lines.rows)
        power = np.abs(error[rows]) ** 2 * (count / max(left, count / 4)) + tiny
        through_it = np.sum(np.abs(response[rows]) ** 2, axis=2), np.abs(forced[rows]) ** 2
        floor = FLOOR * (np.mean(np.abs(lines.measured[rows]) ** 2, axis=0) + through_it[1])
        # outputs with one spectrum are one, the mean of theirs in units of their levels
        levels = np.exp(np.mean(np.log(power), axis=0))
        of_group, floors, *shapes = (
            np.column_stack([(each[:, group] / levels[group]).mean(axis=1) for group in groups])
            for each in (power, floor, *through_it)
        )
        number = np.array([len(group) for group in groups])
        shapes = [np.ones(of_group.shape), *shapes]
        smooth = [_hats(count, *SMOOTH), _hats(count, *SMOOTH_OF_INPUT), _hats(count, *SMOOTH_OF_INPUT)]
        start = of_group.mean(axis=0)
        best = _climbed(of_group, floors, number, shapes[:1], smooth[:1], [start], FIRST_STEPS)
        if len(fit.poles):
            for pole in fit.poles:
                peak = np.abs(1 / (1j * lines.omega[rows] - pole)) ** 2
                shapes.append(np.repeat(peak[:, None], len(number), axis=1))
                smooth.append(np.ones((count, 1)))
            shapes = [shape / (shape.mean(axis=0) + tiny) + 1e-12 for shape in shapes]
            shares = [0.5, 0.1, 0.1, *([0.01] * len(fit.poles))]
            more = _climbed(of_group, floors, number, shapes, smooth, [share * start for share in shares], steps)
            if more[1] < best[1] - PAYS * number.sum():
                best, through = more, True
        for group, shape in zip(groups, best[0].T, strict=True):
            own = np.mean(power[:, group] / shape[:, None], axis=0) if len(group) > 1 else levels[group]
            variance[rows, group] = shape[:, None] * own
        cost += 2 * float(np.sum((np.log(variance[rows]) + power / variance[rows])[:, present]))
    return LineNoise(variance, cost, through)


def _climbed(
    power: NDArray[np.float64],
    floor: NDArray[np.float64],
    number: NDArray[np.int64],
    shapes: Sequence[NDArray[np.float64]],
    smooth: Sequence[NDArray[np.float64]],
    start: Sequence[NDArray[np.float64]],
    steps: int,
) -> tuple[NDArray[np.float64], float]:
    """Variance and cost after so many steps of the sizes of all parts, from a constant size of each.

    `number`: of the outputs of each column.
    """
    sizes = [np.tile(each, (hats.shape[1], 1)) for each, hats in zip(start, smooth, strict=True)]
    parts = [shape * (hats @ size) for shape, hats, size in zip(shapes, smooth, sizes, strict=True)]
    for _ in range(steps):
        variance = sum(parts) + floor
        for j, (hats, shape) in enumerate(zip(smooth, shapes, strict=True)):
            up, down = hats.T @ (shape * power / variance**2), hats.T @ (shape / variance)
            sizes[j] = sizes[j] * (up / (down + np.finfo(float).tiny)) ** 0.7
            before, parts[j] = parts[j], shape * (hats @ sizes[j])
            variance = np.maximum(variance + parts[j] - before, floor)
    variance = sum(parts) + floor
    return variance, 2 * float(np.sum(number * (np.log(variance) + power / variance)))


def _hats(count: int, least: float, share: float) -> NDArray[np.float64]:
    """(count, knots) linear B-splines over the numbers of lines, knots apart by `least` or a `share` of the number."""
    knots = [0.0]
    while knots[-1] < count:
        knots.append(knots[-1] + max(least, share * knots[-1]))
    places = np.array(knots) * count / knots[-1]
    return np.column_stack([np.interp(np.arange(count), places, row) for row in np.eye(len(places))])
