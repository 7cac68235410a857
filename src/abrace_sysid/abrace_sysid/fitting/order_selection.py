# SPDX-License-Identifier: Apache-2.0
"""The number of poles from data: that of vector fitting, and those next to it, compared by description length.

Orders are tried on a part of the lines, for which the model is the same; the chosen order is then fitted to all lines.
"""

from __future__ import annotations

from operator import attrgetter
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from abrace_core import AbraceError
from abrace_sysid.fitting.maximum_likelihood import fit_again, fit_poles
from abrace_sysid.fitting.vector_fitting import HEAVY_DAMPING, WITHIN, FitsByOrder

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.observation import Observation
    from abrace_sysid.fitting.pole_estimate import PoleEstimate, PoleInterval
    from abrace_sysid.spectra.frequency_response import FrequencyResponse

SEARCH_LINES = 1500
"""Approximate number of a test's lines on which orders are tried."""

TRIAL_ITERATIONS = 20
"""Most steps of a trial: a correct order takes about ten."""

FORM_ITERATIONS = 15
"""Most steps of a trial with another form of the servos and a number of pairs that is known to fit."""

IN_VAIN = 1
"""Number of orders in a row without improvement that ends the search."""

MOST_FAILURES = 3
"""Number of first orders that cannot be fitted that ends the search."""

MOST_MORE = 12
"""Pairs that are tried beyond the first order, at most."""

FIRST_DELAY = 0.25
"""Starting value of a servo's delay, in sample periods."""


class Order(NamedTuple):
    """A number of poles, and the form of the servos' model.

    Parameters
    ----------
    pairs
        Oscillating poles.
    reals
        Real poles of each servo: 0; 1, a slow one (integral action); 2, and a fast one (its lag).
    servo
        "direct": a command also has direct terms; "lag": it acts only through its servo's lag; "delay": through the lag
        and a delay.
    coupled
        Whether all commands drive each slow pole; otherwise only its own command does, as with equal servos.
    """

    pairs: int
    reals: int = 0
    servo: Literal["direct", "lag", "delay"] = "direct"
    coupled: bool = True


class OrderTrial(NamedTuple):
    """One order tried: the fitted poles, or None and the reason why the fit failed."""

    order: Order
    estimate: PoleEstimate | None
    reason: str = ""

    @property
    def description(self) -> float:
        """The fit's description length; infinite: it failed."""
        return self.estimate.mdl if self.estimate else np.inf


def try_order(
    observations: Sequence[Observation],
    fits: Sequence[FitsByOrder],
    order: Order,
    groups: int = 1,
    most: int = TRIAL_ITERATIONS,
) -> OrderTrial:
    """The fit of one test, or of repeated ones, with an `order`.

    Parameters
    ----------
    observations, fits
        The tests, and fits of their transfer functions, for starting poles; the first is used that leads to a fit.
    groups
        Number of servos. Each servo's lag, its second real pole, is driven by its own command alone, in the order of
        the inputs. If there is one more input than servos, the first one is the table, which drives all poles except
        lags.
    most
        Greatest number of iterations of a fit.
    """
    ground = len({name for observation in observations for name in observation.inputs}) - groups
    reason = ""
    for of in fits:
        try:
            poles = of.starting_poles(order.pairs, order.reals, groups)
            driven = np.ones((len(poles), ground + groups), dtype=np.bool_)
            if order.reals == 2:
                driven[-groups:] = np.eye(ground + groups)[ground:]
            if order.reals and not order.coupled:
                driven[order.pairs : order.pairs + groups, ground:] = np.eye(groups)
            first = {"direct": np.nan, "lag": 0.0, "delay": FIRST_DELAY * of.measured.sample_period}
            delays = np.append([np.nan] * ground, np.full(groups, first[order.servo]))
            return OrderTrial(order, fit_poles(observations, poles, driven, None, most, "none", delays))
        except AbraceError as error:
            reason = str(error)
    return OrderTrial(order, None, reason)


def best_order(trials: Sequence[OrderTrial]) -> PoleEstimate:
    """The estimate with the least description length (MDL) of all `trials`.

    Raises
    ------
    AbraceError
        If no trial has an estimate, with each one's reason.
    """
    estimates = [trial.estimate for trial in trials if trial.estimate is not None]
    if not estimates:
        reasons = "; ".join(
            f"{trial.order.pairs} pairs and {trial.order.reals} real poles: {trial.reason}" for trial in trials
        )
        raise AbraceError(f"no order could be fitted: {reasons or 'none was tried'}")
    return min(estimates, key=lambda estimate: estimate.mdl)


def search_order(
    observations: Sequence[Observation],
    measured: Sequence[FrequencyResponse],
    forms: Sequence[Order],
    groups: int = 1,
    given: int = 0,
) -> PoleEstimate:
    """The fit with the number of pairs, and the form of the servos, of the least description length.

    Parameters
    ----------
    observations, groups
        As for `try_order`.
    measured
        Their transfer functions.
    forms
        Forms of the servos: the number of pairs is found with the first form that can be fitted, then the others are
        tried with that number.
    given
        Number of pairs; 0: that of vector fitting, more if they are better, fewer if none can be fitted.

    Returns
    -------
    PoleEstimate
        The fit to all lines, without covariance.

    Raises
    ------
    AbraceError
        If no order can be fitted.
    """
    lines = measured[0].omega
    few = [observation.thinned(SEARCH_LINES) for observation in observations]
    fits = [FitsByOrder(one) for one in measured]
    pairs, needed = given, True
    if not given:
        orders = [one.order() for one in fits]
        pairs = max(1, *(len(one.modes(order)) for one, order in zip(fits, orders, strict=True)))
        # fewer poles would leave errors beyond the uncertainty
        needed = all(one.of_order(order).misfit <= WITHIN for one, order in zip(fits, orders, strict=True))
    tried: list[OrderTrial] = []
    found = None
    for first in (pairs,) if given else range(pairs, 0, -1):
        for form in forms:
            fixed = bool(given) or first < pairs
            trials = _pairs_with(few, fits, form._replace(pairs=first), groups, fixed, needed, lines)
            tried += trials
            # an order with a pair that is no mode is accepted only if the user has given that order
            fit = [one for one in trials if one.estimate and (given or not no_modes(one.estimate, lines))]
            if fit:
                found = min(fit, key=attrgetter("description"))
                break
        if found is not None:
            break
    if found is None:
        best_order(tried)
        raise AbraceError(
            f"{observations[0].source}: every order has pairs that are no modes, expected a longer or stronger test"
        )
    best = found
    for form in forms:
        # a form with fewer poles than one that was already worse is not tried
        if form[1:] == found.order[1:] or form.reals < best.order.reals - 1:
            continue
        trial = try_order(few, fits, form._replace(pairs=found.order.pairs), groups, FORM_ITERATIONS)
        if trial.description < best.description and (given or not no_modes(trial.estimate, lines)):
            best = trial
    assert best.estimate is not None
    return (fit_poles if given else fit_again)(observations, best.estimate, spread="none")


def no_modes(estimate: PoleEstimate | None, lines: NDArray[np.float64]) -> list[PoleInterval]:
    """The pairs of an `estimate` that are no modes: outside the band of its `lines` [rad/s], or damped too much."""
    pairs = estimate.pairs() if estimate else []
    low, high = lines[0], lines[-1]
    return [pair for pair in pairs if pair.damping > HEAVY_DAMPING or not low < pair.frequency < high]


def _pairs_with(
    observations: Sequence[Observation],
    fits: Sequence[FitsByOrder],
    first: Order,
    groups: int,
    fixed: bool,
    needed: bool,
    lines: NDArray[np.float64],
) -> list[OrderTrial]:
    """Trials with rising numbers of pairs until there is no improvement; if the first is the best, with fewer pairs.

    `fixed`: only the first; `needed`: not with fewer.
    """
    if fixed:
        return [try_order(observations, fits, first, groups)]
    trials: list[OrderTrial] = []
    best, least = 0, np.inf
    more, fewer = range(first.pairs, first.pairs + MOST_MORE), range(0 if needed else first.pairs - 1, 0, -1)
    for numbers, vain in ((more, IN_VAIN), (fewer, 1)):
        in_vain = 0
        for pairs in numbers if best in (0, first.pairs) else ():
            trial = try_order(observations, fits, first._replace(pairs=pairs), groups)
            if trial.estimate is None and first.reals == 2:
                # of its fast poles one represents lags, filters and delays together
                simpler = first._replace(pairs=pairs, reals=1, servo="direct")
                trial = try_order(observations, fits, simpler, groups)
            trials.append(trial)
            if trial.description < least and not no_modes(trial.estimate, lines):
                best, least, in_vain = pairs, trial.description, 0
            else:
                in_vain += 1
            if in_vain == (vain if best else MOST_FAILURES):
                break
        if not best:
            break
    return trials
