# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from abrace_plant.rig.building import Building
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.robot_description import joint_names, urdf

RIG = load_rig(Path(__file__).parents[2] / "src/abrace_plant/config/ncree_three_storey.yaml")
FIVE_STOREYS = replace(
    RIG.bare_frame(), building=Building(np.full(5, 8000.0), 1e6 * np.eye(5), np.zeros((5, 5))), storey_height=3.2
)


@pytest.mark.parametrize("rig", [RIG, RIG.bare_frame(), FIVE_STOREYS])
def test_each_floor_slides_along_x_at_its_height_above_the_table(rig):
    robot = ElementTree.fromstring(urdf(rig))
    joints = robot.findall("joint")
    assert tuple(joint.get("name") for joint in joints) == joint_names(rig)
    for i, joint in enumerate(joints):
        assert joint.get("type") == "prismatic"
        assert joint.find("parent").get("link") == "table"
        assert joint.find("child").get("link") == f"floor_{i + 1}_link"
        assert joint.find("axis").get("xyz") == "1 0 0"
        height = [float(word) for word in joint.find("origin").get("xyz").split()]
        assert height == pytest.approx([0.0, 0.0, (i + 1) * rig.storey_height])
        limit = {key: float(value) for key, value in joint.find("limit").attrib.items()}
        assert limit["upper"] == -limit["lower"] == rig.sensors.displacement.range
        assert limit["velocity"] > 0


def test_every_link_is_drawn_in_a_colour_of_its_own():
    robot = ElementTree.fromstring(urdf(RIG))
    links = {link.get("name"): link for link in robot.findall("link")}
    assert list(links) == ["table", "floor_1_link", "floor_2_link", "floor_3_link"]
    assert all(link.find("visual/geometry/box") is not None for link in links.values())
    materials = [material.get("name") for material in robot.iter("material")]
    assert len(set(materials)) == len(materials)


def test_a_name_with_markup_characters_stays_well_formed():
    assert ElementTree.fromstring(urdf(replace(RIG, name='a "rig" <1> & 2'))).get("name") == 'a "rig" <1> & 2'
