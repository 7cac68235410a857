# SPDX-License-Identifier: Apache-2.0
"""A graph as `ros2 launch` runs it: its arguments, its nodes, and the end of them all with the end of one.

Where another launch file includes this one, also twice under namespaces, the end of the test ends its own nodes alone.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, Shutdown
from launch.events import matches_action
from launch.events.process import ShutdownProcess
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterFile, ParameterValue

from abrace_bringup.graphs import end_of_node, has_end
from abrace_core import AbraceError

if TYPE_CHECKING:
    from launch import LaunchContext
    from launch.action import Action
    from launch.events.process import ProcessExited

    from abrace_bringup.graphs import Graph, NodeSetup

LIFECYCLE = {
    ("abrace_plant", "plant"),
    ("abrace_plant", "ground_motion"),
    ("abrace_lqg", "controller"),
    ("abrace_sysid", "excitation"),
}
"""Package and executable of the life cycle nodes."""
LIST_TYPES = {str: list[str], float: list[float]}


def describe(graph: Graph) -> LaunchDescription:
    """The launch description of a `graph`."""

    def start(context: LaunchContext) -> list[Action]:
        # where another launch file includes this one, the command line has that one's arguments
        direct = f"{graph.name}.launch.py" in [Path(text).name for text in sys.argv]
        test = _Test(direct)
        given = [text.partition(":=")[0] for text in context.argv] if direct else []
        given = [name for name in given if not name.startswith("launch-prefix")]
        try:
            return [test.node(setup) for setup in graph.nodes(context.launch_configurations, given)]
        except AbraceError as error:
            # launch ends with code 1 and this message
            raise RuntimeError(str(error)) from None

    declared = [
        DeclareLaunchArgument(argument.name, default_value=argument.default, description=argument.description)
        for argument in graph.arguments
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


class _Test:
    """The nodes of one test; `direct`: the launch ends with it."""

    def __init__(self, direct: bool) -> None:
        self._direct, self._over = direct, False
        self._nodes: list[Node] = []

    def node(self, setup: NodeSetup) -> Node:
        """A node without which the test ends."""

        def on_exit(event: ProcessExited, context: LaunchContext) -> list[Action]:
            over = context.is_shutdown or self._over
            meaning = end_of_node(setup.executable, event.returncode, over, has_end(setup))
            if meaning:
                # this alone makes launch end with a code that is not 0
                raise RuntimeError(meaning)
            return [] if meaning is None else self._end()

        lifecycle = (setup.package, setup.executable) in LIFECYCLE  # of which launch tells and takes events
        made = (LifecycleNode if lifecycle else Node)(
            package=setup.package,
            executable=setup.executable,
            name=setup.executable,
            # relative: it goes into the namespace that an including file pushes
            namespace=setup.namespace.lstrip("/"),
            output="both",
            ros_arguments=["--enclave", setup.enclave] if setup.enclave else [],
            parameters=[
                {name: _typed(value) for name, value in setup.parameters.items()},
                *map(ParameterFile, setup.files),
            ],
            additional_env={"ABRACE_END_WITH": str(os.getpid())},
            on_exit=on_exit,
        )
        self._nodes.append(made)
        return made

    def _end(self) -> list[Action]:
        """End the launch or, where another file includes this one, the other nodes of this test."""
        self._over = True
        if self._direct:
            return [Shutdown(reason="the test is over")]
        return [EmitEvent(event=ShutdownProcess(process_matcher=matches_action(node))) for node in self._nodes]


def _typed(value: Any) -> ParameterValue:
    """A parameter's value with the type that it has here: launch reads a text as YAML otherwise."""
    return ParameterValue(value, value_type=LIST_TYPES[type(value[0])] if isinstance(value, list) else type(value))
