# SPDX-License-Identifier: Apache-2.0
"""Lines of tests weighted by what a fit leaves around them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import uniform_filter1d

from abrace_sysid.fitting.curve_fit import stacked
from abrace_sysid.fitting.pole_basis import combined, sides_of, transients

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.observation import Observation
    from abrace_sysid.fitting.pole_estimate import PoleEstimate


def prediction(estimate: PoleEstimate, observation: Observation) -> tuple[float, NDArray[np.complex128]]:
    """The error of the prediction of a test; only its transient is fitted.

    Parameters
    ----------
    estimate
        Modes from another test, or from another part of this one.
    observation
        The test to predict.

    Returns
    -------
    cost, residual
        -2 log likelihood, less a constant; (lines, channels) in units of each channel's noise.
    """
    z = observation.z
    named = [estimate.inputs.index(name) for name in observation.inputs]
    simulated = observation.excitation @ estimate.direct[:, named].T
    delays = np.nan_to_num(estimate.delays)[named]
    for mode, pole in enumerate(estimate.poles):
        sides = sides_of(pole)
        states = [
            np.column_stack(
                [
                    excitation * sampling.response(side, z, delay)[0]
                    for sampling, excitation, delay in zip(
                        observation.samplings, observation.excitation.T, delays, strict=True
                    )
                ]
            )
            for side in sides
        ]
        parts = (estimate.shapes[:, mode].real, estimate.shapes[:, mode].imag)
        for state, part in zip(combined(states, estimate.drive[mode, named]), parts, strict=False):
            simulated = simulated + np.outer(state, part)
    weight = 1 / observation.noise_level[:, None]
    left = stacked((observation.measured - simulated) * weight)
    if observation.transient:
        leaks = transients(list(dict.fromkeys(estimate.poles)), z, observation.samplings[0])
        q, _ = np.linalg.qr(stacked(np.column_stack(leaks) * weight))
        left = left - q @ (q.T @ left)
    power = np.maximum(np.mean(left**2, axis=0), np.finfo(float).tiny)
    scaled = left / np.sqrt(power)
    return float(len(left) * np.sum(np.log(power))), scaled[: len(z)] + 1j * scaled[len(z) :]


def weighed(observations: Sequence[Observation], estimate: PoleEstimate, neighbours: int) -> list[Observation]:
    """Tests whose lines are weighted by the residual of a fit around them, in all channels and tests.

    The residual is larger at a resonance: noise of the measured inputs passes through the structure, and peaks are
    never exactly linear.

    Parameters
    ----------
    estimate
    observations
        Tests of one kind.
    neighbours
        Number of lines over which the level of the residual is averaged.
    """
    powers = []
    for one in observations:
        _, residual = prediction(estimate, one)
        powers.append(np.mean(np.abs(residual) ** 2, axis=1))
    power, angle = np.concatenate(powers), np.concatenate([np.angle(one.z) for one in observations])
    order = np.argsort(angle, kind="stable")
    more = np.empty(len(power))
    # without the line itself, whose own error must not reduce its weight
    level = neighbours * uniform_filter1d(power[order], neighbours) - power[order]
    more[order] = np.sqrt(level / (neighbours - 1))
    ends = np.cumsum([len(one.z) for one in observations])[:-1]
    parts = np.split(more, ends)
    levels = [one.noise_level * part for one, part in zip(observations, parts, strict=True)]
    return [one.with_noise(level / np.median(level)) for one, level in zip(observations, levels, strict=True)]
