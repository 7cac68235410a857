# SPDX-License-Identifier: Apache-2.0
"""The node `controller`: Eq. (13) at the rig's sample rate or a part of it, from a parameter file that `design` wrote.

abrace run abrace_lqg controller --ros-args --params-file results/lqg3.yaml
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from abrace_core import AbraceError
from abrace_core.model.controller_file import ControllerParameters, controller_from_parameters, load_controller
from abrace_core.model.signals import command_names, response_names
from abrace_core.safety.sample_watch import LONGEST_GAP
from abrace_lqg.active_controller import ActiveController
from abrace_node.commander import BraceCommander
from abrace_node.parameters import Parameter
from abrace_node.process import run

FILE = "--params-file FILE, the controller file (YAML) that `design` wrote"

PARAMETERS = [
    Parameter("name", "", "name of the controller", required=True, source=FILE),
    Parameter("model", "", "model that it was designed with"),
    Parameter("weights", "", "weights that it was designed with"),
    Parameter("margins", "", "predicted stability margins"),
    Parameter("sample_period", 0.002, "s, sample period of the law", minimum=1e-6),
    Parameter(
        "rig_period",
        0.0,
        "s, sample period of the rig, of which the law's is a whole multiple; 0: the law's",
        minimum=0.0,
    ),
    Parameter(
        "measured", [], "names of the measured quantities, the law's inputs", element=str, required=True, source=FILE
    ),
    Parameter("commands", [], "names of the commands, the law's outputs", element=str, required=True, source=FILE),
    Parameter("states", 1, "number of states", minimum=1),
    Parameter(
        "force_limit",
        [],
        "N, greatest force of one brace of each group",
        element=float,
        minimum=1.0,
        required=True,
        source=FILE,
    ),
    Parameter("a_d", [], "A_d of Eq. (13), row by row", element=float, required=True, source=FILE),
    Parameter("b_d", [], "B_d of Eq. (13), row by row", element=float, required=True, source=FILE),
    Parameter("c_d", [], "C_d of Eq. (13), row by row", element=float, required=True, source=FILE),
    Parameter("d_d", [], "D_d of Eq. (13), row by row", element=float, required=True, source=FILE),
    Parameter(
        "g_d",
        [],
        "G_d: state correction per newton of applied minus law's command",
        element=float,
        required=True,
        source=FILE,
    ),
    Parameter(
        "p_d",
        [],
        "P_d: prediction of measured values from states and applied command",
        element=float,
        required=True,
        source=FILE,
    ),
    Parameter(
        "units",
        [],
        "NAME=UNIT of measured quantities and commands that are no rig's, SI units",
        element=str,
        source=FILE,
    ),
    Parameter(
        "ramp_time", 0.5, "s, duration of the force's fade-in, and of a change to the next controller", minimum=0.0
    ),
    Parameter(
        "max_lost", LONGEST_GAP, "lost samples in a row that are bridged; more are a fault", minimum=0, maximum=50
    ),
    Parameter("next", "", "controller file to change to without a jump in force", live=True),
]


class ControllerNode(BraceCommander):
    """Answers each sample with the control law's force."""

    def __init__(self) -> None:
        super().__init__("controller", PARAMETERS)

    def configure(self) -> None:
        """Check the controller of the parameters, or that of the file `next` where one is given."""
        given = self.parameters
        parameters = {key: getattr(given, key) for key in ControllerParameters.model_fields}
        controller = controller_from_parameters(parameters, "controller parameters")
        if given.next:
            controller = load_controller(given.next)
        self.active_controller = ActiveController(controller, given.ramp_time, given.rig_period)
        self.create_topics(self.active_controller.rig_period, controller.force_limit.tolist(), given.max_lost)

    def prepare_change(self, name: str, value: str) -> Callable[[], None]:
        """The change over to the controller of the file `next`; an empty one that was empty before changes nothing."""
        if not value and not self.parameters.next:
            return super().prepare_change(name, value)
        if not self.active:
            raise AbraceError(f"parameter {name}: {value}: the node is not active, expected a controller in use")
        if not value:
            raise AbraceError(f"parameter {name}: empty, expected a controller file")
        return self.active_controller.prepare_change(load_controller(value))

    def restart(self, sequence: int, floors: int, groups: int) -> None:
        """Reset the estimate; the force fades in from this sample on."""
        try:
            self.active_controller.reset(
                response_names(floors, groups), command_names(groups), np.array(self.guard.value)
            )
        except AbraceError as error:
            self.safety.fault(str(error))

    def force(self, sequence: int, z: tuple[float, ...], lost: int) -> np.ndarray:
        """The law's command, faded where it comes in; a measured value that is not finite is a fault."""
        try:
            self.active_controller.require_finite(sequence, z)
        except AbraceError as error:
            self.safety.fault(str(error))
            return np.zeros(len(self.guard.value))
        return self.active_controller.force(z, lost)

    def acted(self, force: list[float]) -> None:
        """Advance the estimate with the limited force."""
        self.active_controller.advance(force)

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `/diagnostics`, with the innovation of each measured quantity."""
        fault, message, values = super().diagnose()
        if self.configured:
            used = self.active_controller
            values.update(controller=used.controller.name, controller_state=used.state)
            values.update((f"innovation_rms {name}", f"{rms:.6g}") for name, rms in used.innovation_rms().items())
        return fault, message, values


def main() -> int:
    """Entry point."""
    return run(ControllerNode)
