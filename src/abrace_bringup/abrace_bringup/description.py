# SPDX-License-Identifier: Apache-2.0
"""The launch description of a test: arguments, nodes, and the consequence of each node's end."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitution import Substitution
from launch.substitutions import Command
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue

from abrace_bringup.arguments import read_arguments
from abrace_bringup.enlarged_description import enlarged
from abrace_bringup.graphs import end_of_node
from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from launch import LaunchContext
    from launch.action import Action
    from launch.events.process import ProcessExited

    from abrace_bringup.arguments import Argument
    from abrace_bringup.graphs import NodeSetup

LIST_TYPES = {str: list[str], float: list[float]}


def describe(
    launch_file: str, table: Sequence[Argument], nodes: Callable[[Mapping[str, Any]], list[NodeSetup]]
) -> LaunchDescription:
    """The description of a launch file.

    Parameters
    ----------
    launch_file
        Its `__file__`.
    table
        Its arguments.
    nodes
        Makes the nodes from the arguments' values.
    """

    def start(context: LaunchContext) -> list[Action]:
        # where another launch file includes this one, the command line has that one's arguments
        direct = any(Path(text).name == Path(launch_file).name for text in sys.argv)
        given = [text.partition(":=")[0] for text in context.argv] if direct else []
        given = [name for name in given if not name.startswith("launch-prefix")]
        try:
            values = read_arguments(table, context.launch_configurations, given)
            return _actions(values, nodes(values))
        except AbraceError as error:
            # launch ends with code 1 and this message
            raise RuntimeError(str(error)) from None

    declared = [
        DeclareLaunchArgument(argument.name, default_value=argument.default, description=argument.description)
        for argument in table
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def _actions(values: Mapping[str, Any], setups: Sequence[NodeSetup]) -> list[Action]:
    actions = [_node(values, setup) for setup in setups]
    if values["robot_state_publisher"]:
        actions.append(_robot_state_publisher(values))
    return actions


def _node(values: Mapping[str, Any], setup: NodeSetup) -> Action:
    """A node without which the launch ends."""

    def on_exit(event: ProcessExited, context: LaunchContext) -> Action | None:
        meaning = end_of_node(setup.executable, event.returncode, context.is_shutdown)
        if meaning:
            # this alone makes launch end with a code that is not 0
            raise RuntimeError(meaning)
        return None if meaning is None else Shutdown(reason="the test is over")

    files = [*setup.files, *([values["parameters"]] if values["parameters"] else [])]
    return Node(
        package=setup.package,
        executable=setup.executable,
        name=setup.executable,
        namespace=values["namespace"],
        output="screen",
        ros_arguments=["--enclave", f"{values['enclaves']}/{setup.executable}"] if values["enclaves"] else [],
        parameters=[
            {name: _typed(value) for name, value in setup.parameters.items()},
            *(ParameterFile(file) for file in files),
        ],
        additional_env={"ABRACE_END_WITH": str(os.getpid())},
        on_exit=on_exit,
    )


def _typed(value: Any) -> ParameterValue:
    """A parameter's value with the type that it has here: launch reads a text as YAML otherwise."""
    return ParameterValue(value, value_type=LIST_TYPES[type(value[0])] if isinstance(value, list) else type(value))


class _Enlarged(Substitution):
    """The robot description that a command prints, enlarged."""

    def __init__(self, description: Command, times: float) -> None:
        super().__init__()
        self._description, self._times = description, times

    def perform(self, context: LaunchContext) -> str:
        """The text."""
        return enlarged(self._description.perform(context), self._times)


def _robot_state_publisher(values: Mapping[str, Any]) -> Action:
    try:
        get_package_prefix("robot_state_publisher")
    except PackageNotFoundError:
        raise AbraceError(
            "robot_state_publisher:=true, expected the package of that name, which is not installed"
        ) from None
    executable = Path(get_package_prefix("abrace_plant")) / "lib/abrace_plant/robot_description"
    description = _Enlarged(Command([str(executable), " --ros-args -p rig:=", values["rig"]]), values["exaggeration"])
    return Node(
        package="robot_state_publisher",
        executable="robot_state_publisher",
        exec_name="robot_state_publisher",
        namespace=values["namespace"],
        parameters=[{"robot_description": ParameterValue(description, value_type=str)}],
        # this node does not support ABRACE_END_WITH
        prefix="setpriv --pdeathsig TERM",
    )
