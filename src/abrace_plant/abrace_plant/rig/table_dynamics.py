# SPDX-License-Identifier: Apache-2.0
"""The shake table as it follows its command, with the building on it.

The model follows Blondet and Esparza (1988) and Conte and Trombetti (2000).

The table, of mass m, is held by the oil columns of its actuators, of stiffness k and damping c, at the displacement y_c
that is commanded. With e = y - y_c the following error, w_c = y_c'' the commanded acceleration and w = y'' that of the
table, which its accelerometer measures:

    m w = -c e' - k e - sum over the floors of mass times absolute acceleration,     e'' = w - w_c

Without payload w / w_c = (c s + k) / (m s^2 + c s + k). The building's base shear, and the horizontal force of braces
that stand on the table, move it too: near the building's frequencies w / w_c has a notch and a peak, and braces shake a
table that is not commanded to move.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import pydantic

from abrace_core.files.quantity import Quantity
from abrace_plant.rig.checks import Mass  # noqa: TC001, as pydantic reads the annotations


@dataclass(frozen=True)
class TableDynamics:
    """A table that does not follow exactly.

    Parameters
    ----------
    mass
        Of the table without payload [kg].
    frequency, damping_ratio
        Of the table without payload on the oil columns of its actuators [rad/s].
    """

    mass: Mass
    frequency: Annotated[float, pydantic.Field(ge=20, le=1000), Quantity("rad/s")]
    damping_ratio: Annotated[float, pydantic.Field(ge=0.005, lt=2), Quantity("1")]
