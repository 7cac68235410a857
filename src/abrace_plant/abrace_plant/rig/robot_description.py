# SPDX-License-Identifier: Apache-2.0
"""The rig as a robot description (URDF) for RViz and Foxglove: a table, and each floor sliding along x above it.

Displacements are recorded relative to the table, so every floor is joined to the table directly and its joint's
position is its displacement.
"""

from __future__ import annotations

from typing import TYPE_CHECKING
from xml.etree import ElementTree

if TYPE_CHECKING:
    from abrace_plant.rig.model import Rig

PLATE = (4.5, 3.0, 0.2)
"""Length, width and thickness of a floor as drawn [m]; the plan is that of the paper's building."""
TABLE = (5.0, 5.0, 0.4)
"""The same of the shake table."""
DRAWN = 0.05
"""Share of a storey's height."""
FLOOR_COLOUR, TABLE_COLOUR = "0.55 0.65 0.75 1", "0.35 0.35 0.35 1"


def joint_names(rig: Rig) -> tuple[str, ...]:
    """Names of the joints in JointState messages, of each floor whose displacement is measured, the lowest first.

    Parameters
    ----------
    rig
        The rig to draw.
    """
    return tuple(_joint(i) for i in range(1, rig.floors + 1) if f"x{i}" in rig.channel_names)


def _joint(floor: int) -> str:
    return f"floor_{floor}"


def urdf(rig: Rig) -> str:
    """The rig as URDF.

    The links are `table` (the root, at its top) and `floor_1_link`, `floor_2_link`, ...; the joints are `floor_1`,
    `floor_2`, ..., limited to the range of the displacement sensors, or to DRAWN of the storey's height without any.

    Parameters
    ----------
    rig
        The rig to draw.

    Returns
    -------
    str
        An XML document.
    """
    robot = ElementTree.Element("robot", name=rig.name)
    table = ElementTree.SubElement(robot, "link", name="table")
    _box(table, TABLE, -TABLE[2] / 2, TABLE_COLOUR)
    sensor = rig.sensors.displacement
    reach = sensor.range if sensor else DRAWN * rig.storey_height
    frequencies, _ = rig.building.modes()
    limit = {"lower": f"{-reach:g}", "upper": f"{reach:g}", "effort": "0", "velocity": f"{reach * frequencies[-1]:g}"}
    for i in range(rig.floors):
        name = _joint(i + 1)
        link = ElementTree.SubElement(robot, "link", name=f"{name}_link")
        _box(link, PLATE, 0.0, FLOOR_COLOUR)
        joint = ElementTree.SubElement(robot, "joint", name=name, type="prismatic")
        ElementTree.SubElement(joint, "parent", link="table")
        ElementTree.SubElement(joint, "child", link=f"{name}_link")
        ElementTree.SubElement(joint, "origin", xyz=f"0 0 {rig.storey_heights[: i + 1].sum():g}")
        ElementTree.SubElement(joint, "axis", xyz="1 0 0")
        ElementTree.SubElement(joint, "limit", limit)
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _box(link: ElementTree.Element, size: tuple[float, float, float], height: float, colour: str) -> None:
    """Give a link a box, its middle at this height."""
    visual = ElementTree.SubElement(link, "visual")
    ElementTree.SubElement(visual, "origin", xyz=f"0 0 {height:g}")
    geometry = ElementTree.SubElement(visual, "geometry")
    ElementTree.SubElement(geometry, "box", size=" ".join(f"{edge:g}" for edge in size))
    # a name of its own: parsers refuse one material defined twice
    material = ElementTree.SubElement(visual, "material", name=f"{link.get('name')}_colour")
    ElementTree.SubElement(material, "color", rgba=colour)
