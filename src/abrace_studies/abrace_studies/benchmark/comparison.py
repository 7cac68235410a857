# SPDX-License-Identifier: Apache-2.0
"""Controllers side by side on a benchmark: criteria of every case, and margins."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True)
class Evaluation:
    """What a controller reached: the criteria of each case, and margins as of `margins_of`; none: it is not stable."""

    name: str
    cases: Mapping[str, Mapping[str, float]]
    margins: Mapping[str, float] = field(default_factory=dict)

    def worst(self) -> dict[str, float]:
        """The greatest of each criterion over the cases; NaN if one of them is."""
        cases = list(self.cases.values())
        return {name: float(np.max([case[name] for case in cases])) for name in cases[0]}
