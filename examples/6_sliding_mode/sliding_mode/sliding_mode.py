# SPDX-License-Identifier: Apache-2.0
"""Sliding-mode control with a boundary layer (Utkin 1977; Slotine and Sastry 1983), of the floors' velocities alone.

The law drives s = w1 v1 + w2 v2 + ..., a weighted mean of the floors' absolute velocities, to zero with as much of a
fixed force as that takes: the full force outside the layer |s| < boundary, in proportion inside it. It needs no model,
never asks for more than the force it is given, and damps all modes in which the mean moves.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import numpy as np

from abrace_node.law_node import run_law

if TYPE_CHECKING:
    from abrace_core.model.own_law import LawSample


class SlidingMode:
    """Force [N] = - force sat(s / boundary) for each brace group.

    Parameters
    ----------
    force
        Greatest force of one brace of each group [N].
    boundary
        Half the width of the layer [m/s]; narrower is stiffer, and chatters sooner.
    weights
        Of the floors' velocities in s, first floor first; with several groups those of each, one after the other.
    corner
        Velocities are accelerations integrated; below this [rad/s] drift of the sensors is not followed.
    """

    def __init__(
        self,
        force: float = 15.0e3,
        boundary: float = 0.11,
        weights: list[float] = [0.3, 0.4, 0.3],  # noqa: B006
        corner: float = 0.6,
    ) -> None:
        if not (force > 0 and boundary > 0 and corner > 0):
            raise ValueError(f"force {force:g}, boundary {boundary:g}, corner {corner:g}, expected more than 0")
        self.greatest, self.boundary, self.weights, self.corner = force, boundary, np.array(weights), corner

    def begin(self, floors: int, groups: int, sample_period: float) -> None:
        """Start from rest."""
        if self.weights.size != floors * groups:
            raise ValueError(f"weights {self.weights.tolist()}, expected {groups} times {floors}, one for each floor")
        self.surface = self.weights.reshape(groups, floors)
        self.period, self.velocity = sample_period, np.zeros(floors)

    def force(self, sample: LawSample) -> np.ndarray:
        """The force of one brace of each group [N]."""
        steps = 1 + sample.lost
        self.velocity += steps * self.period * (sample.acceleration - self.corner * self.velocity)
        s = self.surface @ self.velocity
        return -self.greatest * np.clip(s / self.boundary, -1.0, 1.0)


def main() -> int:
    """Entry point."""
    return run_law(SlidingMode)


if __name__ == "__main__":
    sys.exit(main())
