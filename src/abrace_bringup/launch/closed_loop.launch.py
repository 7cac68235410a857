"""The closed loop in real time: rig, controller, ground motion, logger.

ros2 launch abrace_bringup closed_loop.launch.py controller:=lqg3.yaml record:=el_centro bag:=bags/run_1
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    "namespace": ("rig", "namespace of all nodes"),
    "rig": ("ncree_three_storey", "rig: a name in abrace_plant's configuration or a file"),
    "controller": (None, "controller file (YAML) that `design` wrote"),
    "record": ("el_centro", "ground motion: a known name or a file; empty: wait for the action play_ground_motion"),
    "peak_acceleration": ("0.980665", "m/s^2 that the record is scaled to; 0.0: as recorded"),
    "duration": ("0.0", "s until the rig ends, and the test with it; 0.0: until stopped"),
    "bag": (None, "bag (a new directory) to write"),
}


def generate_launch_description() -> LaunchDescription:
    """Four nodes in one namespace."""
    given = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    namespace = given["namespace"]

    def text(name: str) -> ParameterValue:
        return ParameterValue(given[name], value_type=str)

    def number(name: str) -> ParameterValue:
        return ParameterValue(given[name], value_type=float)

    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=default, description=description)
                for name, (default, description) in ARGUMENTS.items()
            ),
            Node(
                package="abrace_bags",
                executable="logger",
                namespace=namespace,
                output="screen",
                parameters=[{"output": text("bag"), "attachments": [[given["controller"]]]}],
            ),
            Node(
                package="abrace_lqg",
                executable="controller",
                namespace=namespace,
                output="screen",
                parameters=[given["controller"]],
            ),
            Node(
                package="abrace_plant",
                executable="ground_motion",
                namespace=namespace,
                output="screen",
                parameters=[{"record": text("record"), "peak_acceleration": number("peak_acceleration")}],
            ),
            Node(
                package="abrace_plant",
                executable="plant",
                namespace=namespace,
                output="screen",
                parameters=[{"rig": text("rig"), "duration": number("duration")}],
                on_exit=Shutdown(reason="the rig has ended"),
            ),
        ]
    )
