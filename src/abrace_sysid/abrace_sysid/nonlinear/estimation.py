# SPDX-License-Identifier: Apache-2.0
"""Estimation of nonlinear elements from the residual of the linear model in its tests.

The residual of the linear model, driven by the inputs of the test, is the response to the elements' forces n:

    y - y_linear = H n,    n = slope r - limit s.

r is the motion of each element and s its sign (between -1 and 1 while it sticks; of joints minus their slip). H is the
model's response to the element's force. r and s are taken from a simulation of the test. Limit and slope follow from a
linear regression over the frequency lines of all tests and channels. Then the tests are simulated again with the
elements found, and the regression is repeated.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.discretization import discretize
from abrace_core.linear_model import takes_models
from abrace_core.simulation import simulate
from abrace_sysid.nonlinear.elements import IMPULSES, Nonlinearity, with_elements
from abrace_sysid.nonlinear.motion import simulate_nonlinear
from abrace_sysid.spectra.fourier import held_input, lines_within, transform
from abrace_sysid.validity.regression import regression

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel
    from abrace_core.run import Run

ROUNDS = 3
"""Number of rounds, each a simulation of the tests and a regression."""

CERTAIN = 5.0
"""An element is kept if its limit is above zero by more than this many standard deviations."""

YIELD = 5.0
"""Assumed yield drift of joints over the greatest drift in the tests. As far beyond the tests' drifts as this, only the
ratio of yielding stiffness to yield drift affects the force."""


@takes_models
def find_elements(
    model: LinearModel, tests: Sequence[tuple[Run, tuple[float, float]]], candidates: Nonlinearity
) -> Nonlinearity:
    """The elements that are significant in the tests, with their limits and slopes.

    Parameters
    ----------
    model
        Continuous, identified from the tests.
    tests
        Each test with the band [Hz] that was excited; without gaps, beginning at rest.
    candidates
        The elements that are considered; their limits and slopes are not used.
    """
    drifts = [np.diff(run.channels(run.names[: run.floors]), axis=1, prepend=0.0) for run, _ in tests]
    far = YIELD * max(float(np.abs(one).max()) for one in drifts)
    fresh = [
        replace(one, limit=0.0, slope=0.0, yield_drift=far if one.kind == "joints" else 0.0)
        for one in candidates.elements
    ]
    found = replace(candidates, elements=tuple(fresh))
    for _ in range(ROUNDS):
        if not found.elements:
            break
        parts = [_regressors(model, run, band, found) for run, band in tests]
        values, deviations = regression(*(np.concatenate(each) for each in zip(*parts, strict=True)))
        numbers = zip(found.elements, values[::2], deviations[::2], values[1::2], strict=True)
        elements = [
            replace(one, limit=float(limit), deviation=float(deviation), slope=float(slope))
            for one, limit, deviation, slope in numbers
            if limit > CERTAIN * deviation
        ]
        found = replace(found, elements=tuple(elements))
    return found


def _regressors(
    model: LinearModel, run: Run, band: tuple[float, float], found: Nonlinearity
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """The linear model's residual in a test, channel after channel, and the regressors of the elements.

    Shapes (lines * outputs,) and (lines * outputs, 2 elements).
    """
    names, period = list(model.outputs), run.sample_period
    inputs = np.column_stack([held_input(run, name) for name in model.inputs])
    sampled = discretize(with_elements(model, found), period)
    motion = simulate_nonlinear(model, found, period, inputs[:, 0], inputs[:, 1:])
    linear = simulate(sampled.select(names, list(model.inputs)), inputs)
    lines, _ = lines_within(run, len(inputs), band)

    def behind(series: NDArray[np.float64]) -> NDArray[np.complex128]:
        return transform(series)[lines].T.ravel()

    columns = []
    for one, moved, held in zip(found.elements, motion.motions.T, motion.held.T, strict=True):
        response = sampled.select(names, [one.name])
        against = held if one.kind == "joints" else -held / one.limit if one.limit else -np.sign(moved)
        for series in (against, moved):
            force = np.diff(series, prepend=0.0) / period if one.kind in IMPULSES else series
            columns.append(behind(simulate(response, force[:, None])))
    return behind(run.channels(names) - linear), np.column_stack(columns)
