# SPDX-License-Identifier: Apache-2.0
"""Estimation of nonlinear elements from the residual of the linear model in its tests.

The residual of the linear model, driven by the inputs of the test, is the response to the elements' forces n:

    y - y_linear = H n,    n = slope r - limit s.

r is the motion of each element and s its sign (between -1 and 1 while it sticks; of joints minus their slip). H is the
model's response to the element's force. r and s are taken from a simulation of the test. The limits follow from a
linear regression over the frequency lines of all tests and channels. Then the tests are simulated again with the
elements found, and the regression is repeated.

An identified model has errors of its own, and friction changes the stiffness and damping that fit a test best. So every
test has its own stiffness and damping of each storey in the regression: an element shows only in what no linear storey
explains. The slopes follow in a second regression, with these limits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

from abrace_core.discretization import discretize
from abrace_core.linear_model import takes_models
from abrace_core.simulation import simulate
from abrace_sysid.nonlinear.elements import IMPULSES, OF_STOREYS, Element, Nonlinearity, with_elements
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

LEFT_OVER = 0.03
"""Share of the surest element's certainty (limit over its deviation) that another one must have to be kept. Elements
are known to a few percent, and what is left over of the surest one looks like others."""

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
        parts = [_Regressors.of(model, run, band, found) for run, band in tests]
        residual = np.concatenate([part.residual for part in parts])
        limited, sloped = (np.vstack([getattr(part, name) for part in parts]) for name in ("limited", "sloped"))
        of_groups = [i for i, one in enumerate(found.elements) if one.kind not in OF_STOREYS]
        linear = [sloped[:, of_groups], linalg.block_diag(*(part.storeys for part in parts))]
        values, deviations = regression(residual, np.column_stack([limited, *linear]))
        certainty = values[: len(found.elements)] / deviations[: len(found.elements)]
        kept = np.flatnonzero(certainty > max(CERTAIN, LEFT_OVER * certainty.max()))
        rest = np.asarray(residual - limited[:, kept] @ values[kept], dtype=np.complex128)
        slopes = regression(rest, sloped[:, kept])[0] if len(kept) else kept
        elements = [
            replace(found.elements[i], limit=float(values[i]), deviation=float(deviations[i]), slope=float(slope))
            for i, slope in zip(kept, slopes, strict=True)
        ]
        found = replace(found, elements=tuple(elements))
    return found


@dataclass(frozen=True)
class _Regressors:
    """The linear model's residual in a test, (lines * outputs,), channel after channel, and its regressors.

    `limited` and `sloped` (lines * outputs, elements) are the responses to each element's force for a limit and for a
    slope of 1. `storeys` (lines * outputs, 2 storeys) are those to a force in proportion to each storey's drift and to
    its rate.
    """

    residual: NDArray[np.complex128]
    limited: NDArray[np.complex128]
    sloped: NDArray[np.complex128]
    storeys: NDArray[np.complex128]

    @classmethod
    def of(cls, model: LinearModel, run: Run, band: tuple[float, float], found: Nonlinearity) -> _Regressors:
        names, period, storeys = list(model.outputs), run.sample_period, range(1, run.floors + 1)
        inputs = np.column_stack([held_input(run, name) for name in model.inputs])
        sampled = discretize(with_elements(model, found), period)
        motion = simulate_nonlinear(model, found, period, inputs[:, 0], inputs[:, 1:])
        lines, _ = lines_within(run, len(inputs), band)

        def behind(series: NDArray[np.float64]) -> NDArray[np.complex128]:
            return transform(series)[lines].T.ravel()

        limited: list[NDArray[np.complex128]] = []
        sloped: list[NDArray[np.complex128]] = []
        for one, moved, held in zip(found.elements, motion.motions.T, motion.held.T, strict=True):
            response = sampled.select(names, [one.name])
            against = held if one.kind == "joints" else -held / one.limit if one.limit else -np.sign(moved)
            for series, columns in ((against, limited), (moved, sloped)):
                force = np.diff(series, prepend=0.0) / period if one.kind in IMPULSES else series
                columns.append(behind(simulate(response, force[:, None])))
        every = [Element(kind, storey) for kind in OF_STOREYS for storey in storeys]
        sampled = discretize(with_elements(model, replace(found, elements=tuple(every))), period)
        moved = simulate(sampled, np.column_stack([inputs, np.zeros((len(inputs), len(every)))]))
        linear, moved = np.split(moved, [len(names)], axis=1)
        own = [
            behind(simulate(sampled.select(names, [one.name]), series[:, None]))
            for one, series in zip(every, moved.T, strict=True)
        ]
        return cls(behind(run.channels(names) - linear), *(np.column_stack(each) for each in (limited, sloped, own)))
