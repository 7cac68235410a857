"""The node `controller`: Eq. (13) at the rig's sample rate, from a parameter file that `design` wrote.

ros2 run abrace_lqg controller --ros-args --params-file lqg3.yaml
"""

from __future__ import annotations

import numpy as np

from abrace_core.brace_commander import BraceCommander
from abrace_core.controller_file import ControllerParameters, controller_from_parameters
from abrace_core.node import Parameter, run
from abrace_core.signals import command_names, response_names
from abrace_lqg.controller import ControlLaw

PARAMETERS = [
    Parameter("name", "", "what the controller is called", required=True),
    Parameter("model", "", "what it was designed from"),
    Parameter("weights", "", "what was asked for"),
    Parameter("margins", "", "stability margins that were predicted"),
    Parameter("sample_period", 0.002, "s, of the law and the rig", minimum=1e-6),
    Parameter("measured", [], "names of the quantities that it takes", element=str, required=True),
    Parameter("commands", [], "names of the commands that it gives", element=str, required=True),
    Parameter("states", 1, "number of states", minimum=1),
    Parameter("force_limit", [], "N, of one brace of each group", element=float, minimum=1.0, required=True),
    Parameter("a_d", [], "A_d of Eq. (13), row by row", element=float, required=True),
    Parameter("b_d", [], "B_d of Eq. (13), row by row", element=float, required=True),
    Parameter("c_d", [], "C_d of Eq. (13), row by row", element=float, required=True),
    Parameter("d_d", [], "D_d of Eq. (13), row by row", element=float, required=True),
]


class Controller(BraceCommander):
    """Answers each sample with the control law's force."""

    def __init__(self) -> None:
        super().__init__("controller", PARAMETERS)

    def configure(self) -> None:
        """Check the law."""
        given = {key: getattr(self.parameters, key) for key in ControllerParameters.model_fields}
        self.controller = controller_from_parameters(given, "controller parameters")
        law = self.controller.law
        self.law = ControlLaw(law.a, law.b, law.c, law.d, self.controller.force_limit)
        self.open_loop(law.sample_period, self.controller.force_limit.tolist())

    def restart(self, sequence: int, floors: int, groups: int) -> None:
        """Forget the past; find the measured quantities in this rig's responses."""
        self.law.reset()
        names = response_names(floors, groups)
        law = self.controller.law
        missing = [name for name in law.inputs if name not in names]
        if missing or law.outputs != command_names(groups):
            self.guard.fault(
                f"controller {self.controller.name} is for another rig: it takes {', '.join(law.inputs)} and gives "
                f"{', '.join(law.outputs)}; this rig has {', '.join(names)} and {', '.join(command_names(groups))}"
            )
            return
        self.measured = [names.index(name) for name in law.inputs]
        self.last = [0.0] * len(self.measured)

    def force(self, sequence: int, z: tuple[float, ...], lost: int) -> np.ndarray:
        """The law's answer; over lost samples its state goes on with the last measured values."""
        for _ in range(lost):
            self.law.update(self.last)
        self.last = [z[index] for index in self.measured]
        return self.law.update(self.last)


def main() -> int:
    """Entry point."""
    return run(Controller)
