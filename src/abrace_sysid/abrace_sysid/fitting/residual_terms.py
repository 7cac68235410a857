# SPDX-License-Identifier: Apache-2.0
"""Fits of measured data with terms for the modes above the band."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np

from abrace_sysid.fitting.maximum_likelihood import ITERATIONS, fit_poles

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.observation import Observation
    from abrace_sysid.fitting.pole_estimate import PoleEstimate

ABOVE, ABOVE_DAMPING = 1.4, 0.01
"""Frequency, divided by the band's upper edge, and damping ratio of the pairs that represent the modes above it."""


def residual_poles(observation: Observation) -> NDArray[np.complex128]:
    """The fixed poles [rad/s] that represent modes above the band of an `observation`, one for each input."""
    sampling = observation.samplings[0]
    highest = float(np.angle(observation.z[-1])) / sampling.sample_period
    # a held input says nothing of poles beyond half the sample rate
    above_it = sampling.hold == "band" or ABOVE * highest * sampling.sample_period < np.pi
    return np.full(len(observation.inputs) if above_it else 0, ABOVE * highest * complex(-ABOVE_DAMPING, 1))


def fit_with_residual_terms(
    observations: Sequence[Observation],
    poles: NDArray[np.complex128],
    iterations: int = ITERATIONS,
    spread: Literal["none", "modes"] = "modes",
    with_above: bool = True,
) -> PoleEstimate:
    """As `fit_poles`, with residual terms of the modes above the band: one pair with a fixed pole for each input.

    Parameters
    ----------
    observations
        The records.
    poles
        Starting poles [rad/s].
    iterations
        Greatest number of steps.
    spread
        As for `fit_poles`.
    with_above
        Whether there are such terms.
    """
    above, inputs = residual_poles(observations[0])[: None if with_above else 0], len(observations[0].inputs)
    fixed = np.arange(len(poles) + len(above)) >= len(poles)
    driven = np.ones((len(poles) + len(above), inputs), dtype=np.bool_)
    driven[len(poles) :] = np.eye(len(above), inputs, dtype=np.bool_)
    return fit_poles(observations, np.concatenate([poles, above]), driven, fixed, iterations, spread)
