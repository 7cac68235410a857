# SPDX-License-Identifier: Apache-2.0
"""Storeys that yield: a Bouc-Wen spring in place of a part of a storey's stiffness (Bouc 1967, Wen 1976).

    force = k z,     z' = (1 - |z / d|^n (beta sign(z d') + 1 - beta)) d'

with d the storey's drift [m], d' its velocity, z the spring's elastic part, which stays within the yield drift. While
the drift is small the spring is the linear one that it replaces; the rig's linear model is the rig before it yields.
The law is independent of the rate: z depends on the path of the drift alone, and is advanced along it in each substep
by the midpoint rule. Over a closed loop the spring takes more work than it gives where beta is at least 0.5 (Erlicher
and Point 2004).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import pydantic

from abrace_plant.rig.checks import Length, Stiffness  # noqa: TC001, as pydantic reads the annotations


@dataclass(frozen=True)
class Hysteresis:
    """A Bouc-Wen spring between a floor and the one below.

    Parameters
    ----------
    storey
        1 the lowest.
    stiffness
        k, of the part of the storey's stiffness that yields [N/m]; the rest stays linear.
    yield_drift
        d, at which its force is greatest: k d [m].
    exponent
        n: 1 yields gradually, 10 nearly at once.
    beta
        0.5 to 1: from 0.5 on, unloading is linear; with 1 a loop encloses most.
    """

    storey: Annotated[int, pydantic.Field(ge=1)]
    stiffness: Stiffness
    yield_drift: Length
    exponent: Annotated[float, pydantic.Field(ge=1, le=20)] = 2.0
    beta: Annotated[float, pydantic.Field(ge=0.5, le=1)] = 0.5
