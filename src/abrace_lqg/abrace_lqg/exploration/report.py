# SPDX-License-Identifier: Apache-2.0
"""Text report of an exploration: the Pareto-optimal sets, and the reasons why others gave no controller."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_lqg.exploration.study import Outcome

LISTED_SETS = 12
"""Sets of the Pareto front that are listed, spread evenly over it."""

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


def report(outcomes: Sequence[Outcome]) -> list[str]:
    """Lines with some sets of the Pareto front, the given weights, and the reasons of sets without a controller.

    Parameters
    ----------
    outcomes
        Of all sets, the given weights first.
    """
    found = [outcome for outcome in outcomes if not outcome.refused]
    lines = []
    if found:
        force = np.array([outcome.command.rms if outcome.command else np.nan for outcome in found])
        response = np.array([outcome.response("acceleration") for outcome in found])
        front = pareto_front(force, response)
        chosen = front[np.unique(np.linspace(0, len(front) - 1, LISTED_SETS).round().astype(int))]
        lines += [
            "response: rms over that with zero command; margins with the simulation model",
            "  set  command rms, peak (N)  saturated  displacement  acceleration  gain dB  phase deg  delay ms",
            *(_row(found[index], "") for index in chosen),
        ]
        if not outcomes[0].refused:
            lines.append(_row(outcomes[0], "  (the given weights)"))
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
    return (
        f"{outcome.number:5d}  {command.rms:11.0f}  {command.peak:8.0f}  {outcome.saturated:9d}"
        f"  {outcome.response('displacement'):12.3f}  {outcome.response('acceleration'):12.3f}"
        f"  {margins.gain:7.1f}  {margins.phase:9.1f}  {1e3 * margins.delay:8.1f}{note}"
    )
