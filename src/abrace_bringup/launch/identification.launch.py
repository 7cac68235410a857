# SPDX-License-Identifier: Apache-2.0
"""A test for identification in real time: rig, logger, and white noise or multisines on the table, as command, or both.

ros2 launch abrace_bringup identification.launch.py drive:=table bag:=bags/table_noise
"""

from launch import LaunchDescription

from abrace_bringup.description import describe
from abrace_bringup.graphs import IDENTIFICATION


def generate_launch_description() -> LaunchDescription:
    """The nodes of the test, with the supervisor that starts and ends it."""
    return describe(IDENTIFICATION)
