# SPDX-License-Identifier: Apache-2.0
"""The node `robot_description`: prints a rig's robot description (URDF), as robot_state_publisher takes it.

abrace run abrace_plant robot_description --ros-args -p rig:=my_rig.yaml
"""

from __future__ import annotations

from abrace_core.node import AbraceNode, Parameter, find_file, run
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.robot_description import urdf

PARAMETERS = [
    Parameter("rig", "ncree_three_storey", "rig: a name in the package's configuration or a file", required=True)
]


class RobotDescription(AbraceNode):
    """Prints one rig's description and ends."""

    def __init__(self) -> None:
        super().__init__("robot_description", PARAMETERS)

    def work(self) -> None:
        """Load and print."""
        print(urdf(load_rig(find_file(self.parameters.rig, "abrace_plant", "config", ".yaml", "rig"))), end="")


def main() -> int:
    """Entry point."""
    return run(RobotDescription)
