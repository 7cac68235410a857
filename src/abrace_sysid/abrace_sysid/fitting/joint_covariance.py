# SPDX-License-Identifier: Apache-2.0
"""The covariance of a fit's model: poles, drives, shapes, direct terms and delays."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace_sysid.fitting.condensed_lines import direct_terms
from abrace_sysid.fitting.pole_estimate import columns_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.likelihood import Likelihood


def inflation(likelihood: Likelihood, covariance: NDArray[np.float64]) -> float:
    """Greatest ratio, over the pairs, of a pair's variance to its variance if channels and lines were independent.

    Parameters
    ----------
    likelihood
        The likelihood at its maximum.
    covariance
        Covariance of its parameters.
    """
    modes, free = likelihood.modes, likelihood.free
    independent = np.diag(likelihood.inverse())
    ratio = np.ones(len(free))
    ratio[free] = np.diag(covariance)[free] / independent[free]
    places = columns_of(modes.poles)
    pairs = np.flatnonzero((modes.poles.imag > 0) & ~modes.fixed)
    return max((float(np.mean(ratio[places[pair]])) for pair in pairs), default=1.0)


def of_entries(
    likelihood: Likelihood, covariance: NDArray[np.float64], inputs: Sequence[str], unit: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The covariance `joint` of `PoleEstimate`.

    Parameters
    ----------
    likelihood
        The likelihood at its maximum.
    covariance
        Covariance of its parameters and of each channel's coefficients, without those of transients.
    inputs, unit
        Names of all inputs, and (inputs,) their units in the likelihood.
    """
    modes, channels = likelihood.modes, len(likelihood.channels)
    places, count, first = columns_of(modes.poles), len(inputs), len(likelihood.gradient)
    states, size = places[-1].stop, (len(covariance) - first) // channels
    end = states * (1 + count)
    entries = np.zeros((end + channels * (states + count) + count, len(covariance)))
    entries[:states, :states] = np.eye(states)
    for mode, direction, columns in modes.parameters():
        if direction is None:
            continue
        turned = modes.directions[mode][:, direction] / unit
        for factor, column in zip((1, 1j), range(columns.start, columns.stop), strict=False):
            parts = (factor * turned).real, (factor * turned).imag
            for place, part in zip(range(places[mode].start, places[mode].stop), parts, strict=False):
                entries[states + place * count : states + (place + 1) * count, column] = part
    at: dict[str, int] = {}
    groups, _ = direct_terms([test.observation for test in likelihood.tests], inputs, modes)
    for (names, _), place in sorted(groups.items(), key=lambda item: len(item[0][1])):
        direct = [name for name in names if modes.direct[inputs.index(name)]]
        at.update({name: place + i for i, name in enumerate(direct)})
    for c in range(channels):
        own = first + c * size
        entries[end + c * states + np.arange(states), own + np.arange(states)] = 1
        for name, place in at.items():
            j = inputs.index(name)
            entries[end + channels * states + c * count + j, own + place] = 1 / unit[j]
    for i, column in modes.delay_columns().items():
        entries[i - count, column] = 1
    return np.asarray(entries @ covariance @ entries.T)
