# SPDX-License-Identifier: Apache-2.0
"""Write docs/nodes.md from the nodes' own parameter tables: `python docs/write_nodes.py`, the workspace sourced."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

import pages

from abrace_node import real_time
from abrace_node.commander import RATE_LIMIT, BraceCommander
from abrace_node.lifecycle import AUTOSTART, AbraceLifecycleNode
from abrace_plant.nodes.rig_node import RIG_PARAMETERS, RigNode

if TYPE_CHECKING:
    from types import ModuleType

    from abrace_node.parameters import Parameter

INTRODUCTION = """# Nodes

    abrace run PACKAGE NODE --ros-args -p PARAMETER:=VALUE

A node with `--help` prints an example and its parameters.

- **Parameters** are read once, when the node starts, except those marked *live*. A wrong one ends the node with one
  line and exit code 2. `duration:=10` is read as `10.0`; the numbers of a list must be of one type, `[1.0, 2.5]`. An
  empty list is `[]`, or `['']` for tools that cannot pass it.
- **Topics** are relative names unless they begin with a slash: they can be remapped and put in a namespace.
- **State**: every node publishes it on `/diagnostics` once a second and when it changes, under its full name
  (`rig/plant: state`), the namespace as hardware ID. A fault is also logged, with what to do about it.
- A **life cycle node** moves something, and only while it is active.
- In **lockstep** the rig publishes its time on `clock` in its own namespace. A tool with `use_sim_time` receives it by
  `-r /clock:=/rig/clock`.

In the tables a parameter without a default is required. *Made from the nodes' tables by `docs/write_nodes.py`.*
"""

NODES = {
    "abrace_plant": {
        "plant": "Takes `brace_command`, `ground_motion`, `emergency_stop`, `/emergency_stop`; publishes `response`, "
        "`joint_states`, `robot_description`, in lockstep `clock` (rosgraph_msgs/Clock). Service `~/clear_fault` "
        "(std_srvs/Trigger).",
        "sensor_bridge": "Takes and publishes the same as `plant`, except `clock`. Services `~/clear_fault`, "
        "`~/zero_sensors` (std_srvs/Trigger).",
        "ground_motion": "Takes `response`; publishes `ground_motion`. Action `play_ground_motion`, services "
        "`~/play` (std_srvs/Trigger), `~/clear_fault`.",
        "record": "Offline.",
        "check_sensors": "Offline. Ends with code 1 if a channel is wrong.",
        "characterize": "Offline.",
    },
    "abrace_bags": {
        "logger": "Takes the topics that it records. Services `~/start`, `~/stop` (std_srvs/Trigger).",
        "replay": "Publishes the topics of a bag.",
        "recover": "Offline; reports what is missing, topic by topic.",
    },
    "abrace_sysid": {
        "ambient": "Offline.",
        "excitation": "Takes `response`; publishes `brace_command`. Services `~/play` (std_srvs/Trigger), "
        "`~/clear_fault`.",
        "identify": "Offline.",
        "identify_data": "Offline.",
        "validate": "Offline.",
    },
    "abrace": {
        "supervisor": "Takes `/diagnostics`; configures and activates the rig of a launch. Ends with code "
        "1 if nodes did not find each other, there was a fault, or a signal was interrupted.",
    },
    "abrace_bringup": {
        "viewer": "Takes the topics that its clients show, and serves them to Foxglove and Lichtblick.",
        "operator": "Takes `response`, `/diagnostics`; serves the page to browsers. With `operate` it publishes "
        "`/emergency_stop`, pressed or not, ten times a second, and calls services of the nodes in its "
        "namespace.",
    },
    "abrace_lqg": {
        "design": "Offline.",
        "controller": "Takes `response`; publishes `brace_command`. Service `~/clear_fault`.",
    },
}


def node_class(module: ModuleType) -> type:
    """The node class that a node's module defines."""
    (found,) = (
        value
        for value in vars(module).values()
        if isinstance(value, type) and value.__module__ == module.__name__ and hasattr(value, "publish_diagnostics")
    )
    return found


def row(parameter: Parameter) -> tuple[str, str, str]:
    """A parameter as a row of a table: name, default, and what it is with its range or choices."""
    default = "" if parameter.required and not parameter.default else f"`{parameter.default!r}`"
    if isinstance(parameter.default, list) and not parameter.default:
        default = f"`[]` ({parameter.ros_type.name.lower().removesuffix('_array')})"
    allowed = ", ".join(f"`{choice}`" for choice in parameter.choices if choice)
    if parameter.minimum or parameter.maximum is not None:  # 0 or more goes without saying
        most = "or more" if parameter.maximum is None else f"to {parameter.maximum:g}"
        allowed = f"{parameter.minimum or 0:g} {most}"
    live = " (*live*)" if parameter.live else ""
    return f"`{parameter.name}`", default, parameter.description + (f"; {allowed}" if allowed else "") + live


def parameters(package: str, name: str) -> list[Parameter]:
    """The parameters of a node, those of its kind included."""
    module = importlib.import_module(f"{package}.nodes.{name}")
    found, table = node_class(module), list(module.PARAMETERS)
    if issubclass(found, RigNode):
        table = [*RIG_PARAMETERS, *table]
    if issubclass(found, BraceCommander):
        table.append(RATE_LIMIT)
    return [*table, *real_time.PARAMETERS, AUTOSTART] if issubclass(found, AbraceLifecycleNode) else table


SHARED = (*real_time.PARAMETERS, AUTOSTART)
"""Every life cycle node has them: they are listed once."""


COLUMNS = ("parameter", "default", "what it is")
SEVERAL = 3
"""So many parameters or more that a node has in common with one before it are named, and described there alone."""


def section(package: str, name: str, about: str, before: dict[str, set[tuple[str, str, str]]]) -> str:
    """A node: what it does, an example, its parameters; it is added to the nodes `before` it."""
    module = importlib.import_module(f"{package}.nodes.{name}")
    lifecycle = issubclass(node_class(module), AbraceLifecycleNode)
    text = module.__doc__ or ""
    summary = text.split("\n\n")[0].partition(": ")[2].replace("\n", " ")
    example = next(line for line in text.splitlines() if line.startswith("abrace run "))
    kind = f"In {package}{', life cycle node' if lifecycle else ''}: {summary} {about}"
    own, rest = [each for each in parameters(package, name) if each not in SHARED], ""
    for other, known in before.items():
        common = [each for each in own if row(each) in known]
        if len(common) >= SEVERAL:
            own = [each for each in own if each not in common]
            rest = pages.paragraph(f"As [{other}](#{other}) it has {', '.join(f'`{each.name}`' for each in common)}.")
    before[name] = set(map(row, own))
    table = pages.table(COLUMNS, map(row, own))
    return "\n".join([f"## {name}\n", pages.paragraph(kind), f"    {example}\n", table, *([rest] if rest else [])])


def page() -> str:
    """The whole page."""
    before: dict[str, set[tuple[str, str, str]]] = {}
    nodes = [
        section(package, name, about, before) for package, inside in NODES.items() for name, about in inside.items()
    ]
    shared = f"## Every life cycle node\n\n{pages.table(COLUMNS, map(row, SHARED))}"
    return "\n".join([INTRODUCTION, shared, *nodes])


if __name__ == "__main__":
    pages.write(__file__, page)
