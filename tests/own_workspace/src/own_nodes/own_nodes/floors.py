# SPDX-License-Identifier: Apache-2.0
"""A node of a user's own, on abrace's libraries: reports the samples in a bag and the floors of a rig."""

import sys

import rclpy

from abrace_bags import read_run
from abrace_core.files.installed import find_file
from abrace_interfaces.msg import Response
from abrace_plant.rig.file import load_rig


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("floors")
    node.create_subscription(Response, "response", lambda _: None, 10)
    rig = load_rig(find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig"))
    node.get_logger().info(f"{len(read_run(sys.argv[1]).sequence)} samples, {rig.floors} floors")
    node.destroy_node()
    rclpy.shutdown()
