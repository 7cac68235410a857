# SPDX-License-Identifier: Apache-2.0
"""The hydraulic actuator under force control, with its natural velocity feedback.

    tau f' = (U - f) + omega_i g - c v,     g' = U - f

f is the force in the load cell [N], U the command [N], v the velocity at which the actuator extends [m/s]. With its end
held (the bench of Fig. 2) it has unity gain and a lag of tau. In a building the term c v makes the structure's poles
the zeros of f/U: the control-structure interaction of Fig. 3 (Dyke et al. 1995).

The servo demands the rate s = (U - f + omega_i g) / tau. The valve gives less: zero within its deadband, the overlap of
its spool; at most its flow limit; scaled by the square root of the relative pressure drop, which falls as the oil's
force rises towards the supply pressure (Merritt 1967, chapter 5):

    rate = clip(s less the deadband) sqrt(1 - sign(s) f_oil / stall_force)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pydantic

from abrace_core.files.quantity import Quantity
from abrace_core.model.linear_model import LinearModel
from abrace_plant.rig.checks import (  # noqa: TC001, as pydantic reads the annotations
    Force,
    ForceRate,
    Length,
    NotNegative,
    Positive,
    SomeForce,
    Stiffness,
)


@dataclass(frozen=True)
class Actuator:
    """A force-controlled actuator.

    Parameters
    ----------
    capacity
        Greatest force of one actuator [N]; forces are cut to it.
    rate_limit
        Greatest rate of the command [N/s].
    lag
        tau [s].
    integral_rate
        omega_i [1/s].
    velocity_feedback
        c [N s/m]; c / tau is the stiffness of the oil column [N/m].
    flow_limit
        Greatest rate [N/s] at which the valve's flow changes the force with the rod blocked: the oil column's stiffness
        times the velocity without load.
    stroke_limit
        Travel to each side [m], at whose ends the piston meets the stops.
    stop_stiffness
        Of a stop with the parts in series [N/m].
    command_delay
        Between a command and the valve [s].
    friction
        Of the piston's seals [N], Coulomb's; between oil and load cell.
    deadband
        Force error of either sign to which the valve does not respond, because of its overlap [N].
    stall_force
        Supply pressure times the piston's area [N], at which the valve has no flow left.
    command_limit
        Greatest command [N] that the rig lets act, if that is less than the capacity.
    """

    capacity: Force
    rate_limit: ForceRate
    lag: Annotated[float, pydantic.Field(ge=1e-5, le=0.05), Quantity("s")]
    integral_rate: Annotated[Positive, Quantity("1/s")]
    velocity_feedback: Annotated[NotNegative, Quantity("N s/m")]
    flow_limit: ForceRate
    stroke_limit: Length
    stop_stiffness: Stiffness
    command_delay: Annotated[float, pydantic.Field(ge=0, le=0.1), Quantity("s")] = 0.0
    friction: SomeForce = 0.0
    deadband: SomeForce = 0.0
    stall_force: Force = np.inf
    command_limit: Force = np.inf

    def bench_model(self) -> LinearModel:
        """U to f with the rod blocked, as on the bench (Fig. 2)."""
        a = np.array([[-1.0, self.integral_rate], [-self.lag, 0.0]]) / self.lag
        b = np.array([[1.0], [self.lag]]) / self.lag
        return LinearModel(a, b, np.array([[1.0, 0.0]]), np.zeros((1, 1)), ("U",), ("f",))
