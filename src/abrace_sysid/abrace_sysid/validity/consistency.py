# SPDX-License-Identifier: Apache-2.0
"""Agreement of two estimates of the same modes: Wald's test, mode by mode."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import stats

from abrace_core.errors import AbraceError
from abrace_sysid.fitting.maximum_likelihood import fit_poles
from abrace_sysid.fitting.observation import Observation
from abrace_sysid.spectra.fourier import spectra_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_core.run import Run
    from abrace_sysid.fitting.pole_estimate import PoleInterval
    from abrace_sysid.spectra.measured_tests import TestData

SAME = 0.1
"""Two frequencies can belong to the same mode if their relative difference is at most this."""

LEAST_SECONDS = 30.0
"""Pieces of a test shorter than this are not fitted."""


@dataclass(frozen=True)
class Difference:
    """The difference of one mode between two estimates.

    Parameters
    ----------
    frequency
        Frequency in the first estimate [rad/s].
    frequency_change, damping_change
        Relative change from the first estimate to the second.
    probability
        Probability that noise alone causes such a difference (chi-square, two degrees of freedom).
    """

    frequency: float
    frequency_change: float
    damping_change: float
    probability: float


def differences(one: Sequence[PoleInterval], other: Sequence[PoleInterval]) -> list[Difference]:
    """The differences of the modes that two independent estimates have in common.

    Parameters
    ----------
    one, other
        Pole pairs with their standard deviations.
    """
    found = []
    for pair in one:
        near = min(other, key=lambda each: abs(each.frequency / pair.frequency - 1), default=None)
        if near is None or abs(near.frequency / pair.frequency - 1) > SAME:
            continue
        deviations = (
            np.hypot(pair.frequency_deviation, near.frequency_deviation),
            np.hypot(pair.damping_deviation, near.damping_deviation),
        )
        steps = (near.frequency - pair.frequency, near.damping - pair.damping)
        statistic = sum((step / deviation) ** 2 for step, deviation in zip(steps, deviations, strict=True))
        found.append(
            Difference(
                pair.frequency,
                near.frequency / pair.frequency - 1,
                near.damping / pair.damping - 1,
                float(stats.chi2.sf(statistic, 2)),
            )
        )
    return found


def pieces_of(data: TestData, poles: NDArray[np.complex128]) -> list[tuple[str, tuple[PoleInterval, ...]]]:
    """The modes of each repeated test, or of both halves of a single test, with the name of the test or half.

    Parameters
    ----------
    data
        Tests of one input. A single periodic test has no pieces.
    poles
        Poles of all tests together, as initial values: the real ones, and of each pair the one above the real axis.
    """
    runs = [(run.source, run) for run in data.runs]
    if data.periodic:
        return _of_periodic(data, poles) if len(runs) > 1 else []
    if len(runs) == 1:
        middle = len(runs[0][1].outputs) // 2
        whole = runs[0][1]
        runs = [
            (f"the first half of {whole.source}", _part(whole, 0, middle)),
            ("the second half", _part(whole, middle, len(whole.outputs))),
        ]
    omega = data.responses[0].omega / (2 * np.pi)
    band = float(omega[0]), float(omega[-1])
    found = []
    for name, run in runs:
        if len(run.outputs) * run.sample_period >= LEAST_SECONDS:
            try:
                spectra = spectra_of(run, data.together, band).select(data.outputs)
                estimate = fit_poles([Observation.of_spectra(spectra, run.source)], poles)
            except AbraceError:
                continue
            found.append((name, tuple(estimate.pairs())))
    return found


def _of_periodic(data: TestData, poles: NDArray[np.complex128]) -> list[tuple[str, tuple[PoleInterval, ...]]]:
    """The modes of each periodic test, with its name."""
    found = []
    for run, response in zip(data.runs, data.responses, strict=True):
        try:
            estimate = fit_poles([Observation.of_response(response, run.source)], poles)
        except AbraceError:
            continue
        found.append((run.source, tuple(estimate.pairs())))
    return found


def _part(run: Run, begin: int, end: int) -> Run:
    kept = slice(begin, end)
    return replace(
        run,
        sequence=run.sequence[kept],
        outputs=run.outputs[kept],
        ground_acceleration=run.ground_acceleration[kept],
        command=run.command[kept],
        clipped=None,
        forces=None,
    )
