# SPDX-License-Identifier: Apache-2.0
"""The robot description of a rig for RViz: its floors move further than measured, as in the viewer.

robot_state_publisher makes frames of joint states as they are. Here each floor that is drawn has a joint of its own,
which mimics the measured one with a multiplier. Joint states stay as measured, and so do the frames `floor_1_measured`,
`floor_2_measured`, ...

Launch files use this module: it needs only the standard library.
"""

from __future__ import annotations

from xml.etree import ElementTree

DRAWN, MEASURED = "_drawn", "_measured"
"""After the name of a measured joint: the joint of the floor as drawn, and the link that moves as measured."""


def enlarged(description: str, times: float) -> str:
    """A description whose links move further than its joint states have it.

    Parameters
    ----------
    description
        URDF, as `abrace_plant.rig.robot_description` makes it.
    times
        Factor by which the links' displacements are enlarged; 1: the description is unchanged.

    Returns
    -------
    str
        URDF with the same links and joints, and a joint for each link that is drawn.
    """
    if times == 1:
        return description
    robot = ElementTree.fromstring(description)
    for joint in robot.findall("joint"):
        drawn = ElementTree.fromstring(ElementTree.tostring(joint))
        drawn.set("name", f"{joint.get('name')}{DRAWN}")
        ElementTree.SubElement(drawn, "mimic", joint=str(joint.get("name")), multiplier=f"{times:g}")
        for limit in drawn.iter("limit"):
            for end in ("lower", "upper", "velocity"):
                limit.set(end, f"{times * float(limit.get(end, '0')):g}")
        robot.append(drawn)
        measured = f"{joint.get('name')}{MEASURED}"
        ElementTree.SubElement(robot, "link", name=measured)
        for child in joint.iter("child"):
            child.set("link", measured)
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"
