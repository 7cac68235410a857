"""A white-noise test for identification in real time: rig, logger, and noise on the table or as command.

ros2 launch abrace_bringup identification.launch.py drive:=table bag:=bags/table_noise
ros2 launch abrace_bringup identification.launch.py drive:=command bag:=bags/command_noise
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.conditions import IfCondition
from launch.substitutions import EqualsSubstitution, LaunchConfiguration, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    "namespace": ("rig", "namespace of all nodes"),
    "rig": ("ncree_three_storey", "rig: a name in abrace_plant's configuration or a file"),
    "drive": (None, "table: white noise on the table; command: white noise as brace commands"),
    "duration": ("300.0", "s of noise; the test ends five seconds later"),
    "bag": (None, "bag (a new directory) to write"),
}


def generate_launch_description() -> LaunchDescription:
    """Three nodes in one namespace."""
    given = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    namespace = given["namespace"]
    duration = ParameterValue(given["duration"], value_type=float)
    rig_duration = ParameterValue(PythonExpression([given["duration"], " + 5.0"]), value_type=float)
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(
                    name,
                    default_value=default,
                    description=description,
                    choices=["table", "command"] if name == "drive" else None,
                )
                for name, (default, description) in ARGUMENTS.items()
            ),
            Node(
                package="abrace_plant",
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
                parameters=[{"record": "white_noise", "duration": duration}],
                condition=IfCondition(EqualsSubstitution(given["drive"], "table")),
            ),
            Node(
                package="abrace_sysid",
                executable="excitation",
                namespace=namespace,
                output="screen",
                parameters=[{"duration": duration}],
                condition=IfCondition(EqualsSubstitution(given["drive"], "command")),
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
