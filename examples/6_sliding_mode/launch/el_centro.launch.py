# SPDX-License-Identifier: Apache-2.0
"""El Centro at 0.1 g under sliding-mode control, in real time.

ros2 launch sliding_mode el_centro.launch.py bag:=bags/one

Every argument of abrace's closed loop may be given, but for the controller.
"""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription


def generate_launch_description() -> LaunchDescription:
    """The closed loop with this law."""
    file = Path(get_package_share_directory("abrace_bringup")) / "launch/closed_loop.launch.py"
    law = {"controller": "sliding_mode/sliding_mode"}
    return LaunchDescription([IncludeLaunchDescription(str(file), launch_arguments=law.items())])
