# SPDX-License-Identifier: Apache-2.0
"""Text report of an exploration: Pareto-optimal sets, the most robust ones, and why others gave no controller."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.model.verdict import nan_last
from abrace_lqg.proof.limits import Limits

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_studies.exploration.study import Outcome

LISTED_SETS = 12
"""Sets of the Pareto front that are listed, spread evenly over it."""

HEADING = ("  set", "command rms, peak", "saturated"), ("gain dB", "phase deg", "delay ms")
"""Titles of the columns before and behind those of the responses."""
LISTED_ROBUST = 5
"""Most robust sets that are listed."""

LISTED_REASONS = 3
"""Most frequent reasons that are listed."""


def pareto_front(force: NDArray[np.float64], response: NDArray[np.float64]) -> NDArray[np.intp]:
    """Indices of the Pareto-optimal points, by increasing force: no other point has both less force and less response.

    Parameters
    ----------
    force, response
        (points,).

    >>> pareto_front(np.array([1.0, 2.0, 3.0, 4.0]), np.array([0.9, 0.5, 0.6, 0.4])).tolist()
    [0, 1, 3]
    """
    order = np.lexsort((response, force))
    least = np.minimum.accumulate(response[order])
    return order[np.append(True, least[1:] < least[:-1])[: len(order)]]


def ranked(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Sets that take no more force than the given weights, by their robust response, the least first.

    The given weights are the first of the `outcomes`; where they give no controller any force is allowed. Those are
    left out whose gain, phase or delay margin is less than `design` requires (the defaults of `Limits`).
    """
    given = outcomes[0].command
    allowed = [one for one in outcomes if one.command and (given is None or one.command.rms <= given.rms)]
    return sorted(filter(_suffices, allowed), key=lambda one: nan_last(one.robust_response))


def _suffices(outcome: Outcome) -> bool:
    found, least = outcome.margins, Limits()
    assert found is not None
    return (
        found.gain_db >= least.gain_margin
        and found.phase_deg >= least.phase_margin
        and found.delay >= least.delay_margin
    )


def report(outcomes: Sequence[Outcome], quantile: float) -> list[str]:
    """Lines with some sets of the Pareto front, the most robust ones, and why other sets gave no controller.

    `outcomes`: of all sets, the given weights first; `quantile`: of the robust responses.
    """
    found = [outcome for outcome in outcomes if not outcome.refused]
    lines = []
    if found:
        force = np.array([outcome.command.rms if outcome.command else np.nan for outcome in found])
        kinds = found[0].ranked_kinds
        response = np.array([outcome.response(kinds[-1]) for outcome in found])
        front = pareto_front(force, response)
        chosen = front[np.unique(np.linspace(0, len(front) - 1, LISTED_SETS).round().astype(int))]
        lines += [
            "response: rms over that with zero command; margins with the simulation model",
            f"robust: {quantile:g} of {found[0].loops} loops respond no more",
            "  ".join([*HEADING[0], *(f"{kind:>12}  robust" for kind in kinds), *HEADING[1]]),
            *(_row(found[index], "") for index in chosen),
        ]
        if not outcomes[0].refused:
            lines.append(_row(outcomes[0], "  (the given weights)"))
        best = ranked(outcomes)[:LISTED_ROBUST]
        force_of_given = "" if outcomes[0].refused else ", with no more command rms than the given weights"
        lines += [
            f"most robust{force_of_given} and the margins that design requires{':' if best else ': none'}",
            *(_row(outcome, "") for outcome in best),
        ]
    refused = Counter(outcome.refused for outcome in outcomes if outcome.refused)
    if refused:
        lines.append(f"{refused.total()} of {len(outcomes)} sets gave no controller:")
        lines += [f"  {count} x {reason}" for reason, count in refused.most_common(LISTED_REASONS)]
        if len(refused) > LISTED_REASONS:
            lines.append(f"  and {len(refused) - LISTED_REASONS} further reasons, in exploration.csv")
    return lines


def _row(outcome: Outcome, note: str) -> str:
    command, margins = outcome.command, outcome.margins
    assert command is not None
    assert margins is not None
    responses = "".join(
        f"  {outcome.response(kind):{max(12, len(kind))}.3f}  {outcome.robust[kind]:6.3f}"
        for kind in outcome.ranked_kinds
    )
    return (
        f"{outcome.number:5d}  {command.rms:8.4g}  {command.peak:7.4g}  {outcome.saturated:9d}{responses}"
        f"  {margins.gain_db:7.1f}  {margins.phase_deg:9.1f}  {1e3 * margins.delay:8.1f}{note}"
    )
