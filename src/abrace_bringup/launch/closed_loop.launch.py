# SPDX-License-Identifier: Apache-2.0
"""The closed loop in real time: rig, controller, ground motion, logger.

ros2 launch abrace_bringup closed_loop.launch.py controller:=lqg3.yaml record:=el_centro bag:=bags/run_1
"""

from launch import LaunchDescription

from abrace_bringup.description import describe
from abrace_bringup.graphs import CLOSED_LOOP


def generate_launch_description() -> LaunchDescription:
    """The nodes of the test, with the supervisor that starts and ends it."""
    return describe(CLOSED_LOOP)
