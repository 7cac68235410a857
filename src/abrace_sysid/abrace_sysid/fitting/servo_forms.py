# SPDX-License-Identifier: Apache-2.0
"""The modes of a rig's tests, and the form of its servos' model: number, poles and form by likelihood alone.

The modes are searched as in any records (`mode_search`), beside fixed real poles in the place of the servos' own. Forms
of the servos' model are then tried with these modes on a part of the lines, and compared by description length.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from abrace_core import AbraceError
from abrace_sysid.fitting.curve_fit import UnstablePolesError
from abrace_sysid.fitting.maximum_likelihood import fit_again, fit_poles
from abrace_sysid.fitting.mode_search import ALIKE, find_modes
from abrace_sysid.fitting.residual_terms import residual_poles
from abrace_sysid.fitting.vector_fitting import HEAVY_DAMPING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.fitting.observation import Observation
    from abrace_sysid.fitting.pole_estimate import PoleEstimate, PoleInterval

MODE_LINES, LEAST_LINES = 700, 150
"""Approximate number of lines in which modes are searched, of all tests together, and of each at least."""

MOST_MODES = 60
"""Most modes that are searched."""

SERVO_POLES, REACH = 5, (0.5, 4.0)
"""Fixed real poles beside the modes, spread evenly on a logarithmic scale over this range, times the band's edges."""

TRIAL_LINES, TRIAL_ITERATIONS = 1500, 20
"""Approximate number of a test's lines on which forms are tried, and most steps: a right one takes about ten."""

FIRST_DELAY, APART = 0.25, 0.7
"""Starting values: of a servo's delay, in sample periods, and the ratio of several servos' slow poles."""


class ServoForm(NamedTuple):
    """A form of the servos' model.

    Parameters
    ----------
    reals
        Real poles of each servo: 0; 1, a slow one (integral action); 2, and a fast one (its lag).
    servo
        "direct": a command also has direct terms; "lag": it acts only through its servo's lag; "delay": through the lag
        and a delay.
    coupled
        Whether all commands drive each slow pole; otherwise only its own command does, as with equal servos.
    """

    reals: int = 0
    servo: Literal["direct", "lag", "delay"] = "direct"
    coupled: bool = True


def rig_modes(observations: Sequence[Observation], given: int = 0) -> NDArray[np.complex128]:
    """(modes,) upper poles [rad/s] of the modes in a rig's tests, lowest first.

    Parameters
    ----------
    observations
        The tests.
    given
        Number of modes; 0: those that pay.

    Raises
    ------
    AbraceError
        If there is none, or fewer than `given`.
    """
    few = [one.thinned(max(LEAST_LINES, MODE_LINES // len(observations))) for one in observations]
    omega = np.concatenate([one.omega for one in few])
    low, high = REACH[0] * omega.min(), REACH[1] * omega.max()
    fixed = np.concatenate([residual_poles(few[0])[:1], -np.geomspace(low, high, SERVO_POLES)])
    found = find_modes(few, fixed, MOST_MODES, given=given)
    poles = found.poles if given else found.poles[found.is_mode]
    if not len(poles):
        raise AbraceError(
            f"{observations[0].source}: no mode from {omega.min():.4g} to {omega.max():.4g} rad/s, expected a longer "
            "or stronger test"
        )
    return poles


def fit_with_form(
    observations: Sequence[Observation], modes: NDArray[np.complex128], form: ServoForm, groups: int = 1
) -> PoleEstimate:
    """The fit of one test, or of repeated ones, with a form of the servos' model, without covariance.

    Parameters
    ----------
    observations
        The tests.
    modes
        Starting poles [rad/s] of the modes, upper ones.
    form
        The form.
    groups
        Number of servos. Each servo's lag, its second real pole, is driven by its own command alone, in the order of
        the inputs. If there is one more input than servos, the first one is the table, which drives all poles except
        lags.

    Raises
    ------
    AbraceError
        As `fit_poles`.
    """
    period = observations[0].samplings[0].sample_period
    ground = len({name for observation in observations for name in observation.inputs}) - groups
    slow = -np.abs(modes).min() * APART ** np.arange(groups)
    fast = np.full(groups, -2 / period)
    poles = np.concatenate([modes, slow, fast])[: len(modes) + form.reals * groups]
    driven = np.ones((len(poles), ground + groups), dtype=np.bool_)
    if form.reals == 2:
        driven[-groups:] = np.eye(ground + groups)[ground:]
    if form.reals and not form.coupled:
        driven[len(modes) : len(modes) + groups, ground:] = np.eye(groups)
    first = {"direct": np.nan, "lag": 0.0, "delay": FIRST_DELAY * period}
    delays = np.append([np.nan] * ground, np.full(groups, first[form.servo]))
    return fit_poles(observations, poles, driven, None, TRIAL_ITERATIONS, "none", delays)


def fit_rig(
    observations: Sequence[Observation], forms: Sequence[ServoForm], groups: int = 1, given: int = 0
) -> PoleEstimate:
    """The modes of a rig's tests, with the form of the servos' model of the least description length.

    Parameters
    ----------
    observations, groups
        As for `fit_with_form`.
    forms
        Forms that are tried, those with more real poles first.
    given
        Number of modes; 0: those that pay.

    Returns
    -------
    PoleEstimate
        The fit to all lines, without covariance.

    Raises
    ------
    AbraceError
        If no mode is found, or no form can be fitted.
    """
    modes = rig_modes(observations, given)
    few = [observation.thinned(TRIAL_LINES) for observation in observations]
    best, reasons, left = _best_form(few, modes, forms, groups, given)
    while best is None and 0 < len(left) < len(modes):
        # a mode just above the lines was found as a heavy pair: the others are those of the test
        modes = left
        best, reasons, left = _best_form(few, modes, forms, groups, given)
    if best is None:
        raise AbraceError(
            f"{observations[0].source}: no form of the servos could be fitted with {len(modes)} modes: "
            f"{'; '.join(reasons)}"
        )
    return (fit_poles if given else fit_again)(observations, best, spread="none")


def _best_form(
    few: Sequence[Observation], modes: NDArray[np.complex128], forms: Sequence[ServoForm], groups: int, given: int
) -> tuple[PoleEstimate | None, list[str], NDArray[np.complex128]]:
    """The fit of least description length, reasons against the others, and the modes without pairs that are none."""
    best, best_form, reasons, left = None, ServoForm(), [], modes
    for form in forms:
        # a form with fewer poles than one that was already worse is not tried
        if best is not None and form.reals < best_form.reals - 1:
            continue
        try:
            trial = _stable_fit(few, modes, form, groups)
        except AbraceError as error:
            reasons.append(f"{form.reals} real poles: {error}")
            continue
        # a pair that is no mode is accepted only if the user has given the number
        if wrong := [] if given else no_modes(trial, few[0].omega):
            reasons.append(f"{form.reals} real poles: a pair becomes one that is no mode")
            upper = trial.poles[trial.poles.imag > 0]
            far = ~np.isclose(np.abs(upper)[:, None], [pair.frequency for pair in wrong], rtol=1e-9).any(axis=1)
            left = min(left, upper[far], key=len)
        elif best is None or trial.mdl < best.mdl:
            best, best_form = trial, form
    return best, reasons, left


def _stable_fit(
    observations: Sequence[Observation], modes: NDArray[np.complex128], form: ServoForm, groups: int
) -> PoleEstimate:
    """As `fit_with_form`, without the modes that become unstable, and one of two that the fit cannot tell apart.

    Friction can look like a second copy of a mode, and a mode just above the lines like two heavy ones.
    """
    while True:
        try:
            return fit_with_form(observations, modes, form, groups)
        except UnstablePolesError as error:
            kept = ~error.unstable[: len(modes)]
            if kept.all() or not kept.any():
                raise
        except AbraceError:
            apart = np.abs(modes[:, None] - modes) / -np.minimum(modes.real[:, None], modes.real)
            nearest = np.where(np.eye(len(modes), dtype=np.bool_), np.inf, np.abs(apart)).min(axis=1, initial=np.inf)
            kept = np.arange(len(modes)) != np.argmin(nearest)
            if nearest.min(initial=np.inf) > ALIKE:
                raise
        modes = modes[kept]


def no_modes(estimate: PoleEstimate, lines: NDArray[np.float64]) -> list[PoleInterval]:
    """The pairs of an `estimate` that are no modes: outside the band of its `lines` [rad/s], or damped too much."""
    low, high = lines[0], lines[-1]
    return [pair for pair in estimate.pairs() if pair.damping > HEAVY_DAMPING or not low < pair.frequency < high]
