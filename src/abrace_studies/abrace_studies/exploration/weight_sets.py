# SPDX-License-Identifier: Apache-2.0
"""Sets of weights to try: a given one and quasi-random ones around it.

Sobol's sequence, scrambled as by Owen (1998), covers the logarithms of the weights evenly. The command's weight is not
varied, as only ratios of weights matter. The first sets are the same however many there are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import qmc

from abrace_core import AbraceError
from abrace_core.files.suggestion import expected_of
from abrace_lqg.weights import Weights

if TYPE_CHECKING:
    from collections.abc import Mapping


def weight_sets(given: Weights, spans: Mapping[str, tuple[float, float]], count: int, seed: int) -> list[Weights]:
    """The given weights, and `count` quasi-random sets around them.

    Parameters
    ----------
    given
        Set number 0.
    spans
        By name of a weight (of `KindWeights`, noise_to_excitation, or `signals.NAME`): lowest and highest power of
        ten that it is multiplied by. Weights that are not named keep their given value.
    count
        Number of further sets.
    seed
        Seed of the scrambling.

    Raises
    ------
    AbraceError
        If a span is of no weight, or its bounds are in the wrong order, all spans are zero, a weight that is given as
        zero has a span, or there are no sets.
    """
    file = given.model_dump()
    by_name = {f"signals.{name}": weight for name, weight in given.signals.items()}
    start = {**file["weights"], "noise_to_excitation": file["noise_to_excitation"], **by_name}
    names = [name for name, span in spans.items() if tuple(span) != (0.0, 0.0)]
    if unknown := [name for name in spans if name not in start]:
        raise AbraceError(f"span of {unknown[0]}: no such weight, {expected_of(unknown[0], start)}")
    if count < 1:
        raise AbraceError(f"sets {count}, expected at least 1")
    for name in names:
        low, high = spans[name]
        if not low <= high:
            raise AbraceError(f"span of {name}: from {low} to {high}, expected the lower power of ten first")
        if not start[name] > 0:
            raise AbraceError(
                f"span of {name}: the weight is given as 0, which no factor changes, expected more than 0"
            )
    if not names:
        raise AbraceError("spans: all are from 0 to 0, expected a weight that differs from set to set")
    low, high = np.array([spans[name] for name in names]).T
    # drawn in powers of two, as the sequence is balanced for these
    drawn = qmc.Sobol(len(names), scramble=True, seed=seed).random_base2((count - 1).bit_length())[:count]
    sets = [given]
    for factors in 10.0 ** (low + (high - low) * drawn):
        values = start | {name: start[name] * float(factor) for name, factor in zip(names, factors, strict=True)}
        noise = values.pop("noise_to_excitation")
        own = {name: values.pop(f"signals.{name}") for name in given.signals}
        changed = {"weights": values, "signals": own, "noise_to_excitation": noise}
        sets.append(Weights.model_validate(file | changed))
    return sets
