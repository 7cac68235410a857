# SPDX-License-Identifier: Apache-2.0
"""Skyhook damping: each brace group pushes against the velocity of its floor (Karnopp, Crosby and Harwood 1974)."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import numpy as np

from abrace_node.law_node import run_law

if TYPE_CHECKING:
    from abrace_core.model.own_law import LawSample


class Skyhook:
    """Force [N] = - damping [N s/m] times the floor's absolute velocity, which is its acceleration integrated.

    `floors` are those of the brace groups, 1 the lowest; below `corner` [rad/s] drift of the sensors is not followed.
    """

    def __init__(self, damping: float = 120.0e3, corner: float = 0.6, floors: list[int] = [1]) -> None:  # noqa: B006
        self.damping, self.corner, self.floors = damping, corner, np.array(floors) - 1

    def begin(self, floors: int, groups: int, sample_period: float) -> None:
        """Start from rest."""
        if len(self.floors) != groups or self.floors.max() >= floors or self.floors.min() < 0:
            raise ValueError(f"floors {(self.floors + 1).tolist()}, expected {groups} out of 1 to {floors}")
        self.period, self.velocity = sample_period, np.zeros(groups)

    def force(self, sample: LawSample) -> np.ndarray:
        """The force of one brace of each group [N]."""
        steps = 1 + sample.lost
        self.velocity += steps * self.period * (sample.acceleration[self.floors] - self.corner * self.velocity)
        return -self.damping * self.velocity


def main() -> int:
    """Entry point."""
    return run_law(Skyhook)


if __name__ == "__main__":
    sys.exit(main())
