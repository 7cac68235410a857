"""The number of poles from data: fits of several orders compared by description length."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError
from abrace_sysid.fitting.maximum_likelihood import fit_poles
from abrace_sysid.fitting.vector_fitting import starting_poles

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.observation import Observation
    from abrace_sysid.fitting.pole_estimate import PoleEstimate
    from abrace_sysid.spectra.frequency_response import FrequencyResponse


@dataclass(frozen=True)
class OrderTrial:
    """One order tried.

    Parameters
    ----------
    pairs, reals
        Of poles.
    estimate
        Of the poles; None if the fit failed.
    reason
        Why it failed.
    """

    pairs: int
    reals: int
    estimate: PoleEstimate | None
    reason: str = ""


def try_orders(
    observations: Sequence[Observation],
    measured: FrequencyResponse,
    orders: Sequence[tuple[int, int]],
    groups: int = 1,
) -> list[OrderTrial]:
    """Fits of one test, or of repeated ones, with each order.

    Parameters
    ----------
    observations
        The tests.
    measured
        Its transfer functions, for starting poles.
    orders
        (pairs, real poles of each servo) to try.
    groups
        Servos; the lag of each, its second real pole, is driven by its own command alone, in the order of the inputs.
    """
    most = max((reals for _, reals in orders), default=0)

    @functools.cache
    def start(pairs: int) -> NDArray[np.complex128]:
        return starting_poles(measured, pairs, most, groups)

    trials = []
    for pairs, reals in orders:
        try:
            poles = start(pairs)[: pairs + reals * groups]
            driven = np.ones((len(poles), groups), dtype=np.bool_)
            if reals == 2:
                driven[-groups:] = np.eye(groups)
            estimate = fit_poles(observations, poles, driven)
        except AbraceError as error:
            trials.append(OrderTrial(pairs, reals, None, str(error)))
        else:
            trials.append(OrderTrial(pairs, reals, estimate))
    return trials


def best_order(trials: Sequence[OrderTrial]) -> PoleEstimate:
    """The estimate with the least description length (MDL) of all `trials`.

    Raises
    ------
    AbraceError
        If no trial has an estimate, with each one's reason.
    """
    estimates = [trial.estimate for trial in trials if trial.estimate is not None]
    if not estimates:
        reasons = "; ".join(f"{trial.pairs} pairs and {trial.reals} real poles: {trial.reason}" for trial in trials)
        raise AbraceError(f"no order could be fitted: {reasons or 'none was tried'}")
    return min(estimates, key=lambda estimate: estimate.mdl)
