"""A test for identification in real time: rig, logger, and white noise or multisines on the table, as command, or both.

ros2 launch abrace_bringup identification.launch.py drive:=table bag:=bags/table_noise
ros2 launch abrace_bringup identification.launch.py drive:=command bag:=bags/command_noise
ros2 launch abrace_bringup identification.launch.py drive:=both bag:=bags/multisines
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.conditions import IfCondition
from launch.substitution import Substitution
from launch.substitutions import (
    EqualsSubstitution,
    IfElseSubstitution,
    LaunchConfiguration,
    OrSubstitution,
    PythonExpression,
)
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    "namespace": ("rig", "namespace of all nodes"),
    "rig": ("ncree_three_storey", "rig: a name in abrace_plant's configuration or a file"),
    "drive": (None, "what moves the rig; both: multisines on odd lines of the table and even ones of the command"),
    "signal": ("white_noise", "of table or command; both at once are multisines in any case"),
    "duration": ("300.0", "s of the signal; the test ends five seconds later"),
    "bag": (None, "bag (a new directory) to write"),
}


CHOICES = {"drive": ["table", "command", "both"], "signal": ["white_noise", "multisine"]}


def _band(lowest: Substitution, highest: str) -> ParameterValue:
    return ParameterValue(["[", lowest, ", ", highest, "]"], value_type=list[float])


def generate_launch_description() -> LaunchDescription:
    """Three or four nodes in one namespace."""
    given = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    namespace, drive = given["namespace"], given["drive"]
    is_both = EqualsSubstitution(drive, "both")
    signal = IfElseSubstitution(is_both, "multisine", given["signal"])
    # a multisine must not begin at 0 Hz: the table's stroke grows with 1 / frequency^2
    lowest = IfElseSubstitution(EqualsSubstitution(signal, "multisine"), "0.3", "0.0")
    duration = ParameterValue(given["duration"], value_type=float)
    rig_duration = ParameterValue(PythonExpression([given["duration"], " + 5.0"]), value_type=float)
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(
                    name,
                    default_value=default,
                    description=description,
                    choices=CHOICES.get(name),
                )
                for name, (default, description) in ARGUMENTS.items()
            ),
            Node(
                package="abrace_bags",
                executable="logger",
                namespace=namespace,
                output="screen",
                parameters=[{"output": ParameterValue(given["bag"], value_type=str)}],
            ),
            Node(
                package="abrace_plant",
                executable="ground_motion",
                namespace=namespace,
                output="screen",
                parameters=[{"record": signal, "duration": duration, "band": _band(lowest, "10.0")}],
                condition=IfCondition(OrSubstitution(is_both, EqualsSubstitution(drive, "table"))),
            ),
            Node(
                package="abrace_sysid",
                executable="excitation",
                namespace=namespace,
                output="screen",
                parameters=[
                    {
                        "signal": signal,
                        "duration": duration,
                        "band": _band(lowest, "30.0"),
                        "lines": IfElseSubstitution(is_both, "even", "odd"),
                    }
                ],
                condition=IfCondition(OrSubstitution(is_both, EqualsSubstitution(drive, "command"))),
            ),
            Node(
                package="abrace_plant",
                executable="plant",
                namespace=namespace,
                output="screen",
                parameters=[{"rig": ParameterValue(given["rig"], value_type=str), "duration": rig_duration}],
                on_exit=Shutdown(reason="the test is over"),
            ),
        ]
    )
