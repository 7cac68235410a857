# SPDX-License-Identifier: Apache-2.0
"""Write docs/nodes.md from the nodes' own parameter tables: `python docs/write_nodes.py`, the workspace sourced."""

from __future__ import annotations

import importlib
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING

from abrace_core.files import write_text
from abrace_core.node import AUTOSTART, AbraceLifecycleNode, Parameter, real_time
from abrace_core.node.brace_commander import RATE_LIMIT, BraceCommander
from abrace_plant.nodes.rig_node import RIG_PARAMETERS, RigNode

if TYPE_CHECKING:
    from types import ModuleType

PAGE = Path(__file__).parent / "nodes.md"

INTRODUCTION = """# Nodes

Written by `python docs/write_nodes.py` from the parameter tables in the nodes' source.
With `--help` a node prints an example and its parameters with their allowed values, with `--version` abrace's version.

Every node publishes its state on `/diagnostics`, once a second and when it changes, where `rqt_robot_monitor` and
`diagnostic_aggregator` expect it. A status has the node's full name (`rig/plant: state`) and the namespace as
hardware ID, so that several rigs can be distinguished. A fault is also logged, when it occurs and when it is cleared,
on the terminal and on `/rosout`, with what to do about it.

All other topic names are relative: they can be remapped and put in a namespace. A wrong parameter ends the node with
one line and exit code 2. Parameters are read once, when the node starts, except those marked *live*. Parameters that
are set together are all accepted or all refused. An empty list is `[]`; for tools that cannot pass one, `['']` is the
same. `duration:=10` is read as `10.0`; numbers in a list must be all of one type, `[1.0, 2.5]`. A life cycle node moves
something, and does so only while it is active. Two nodes of the same name in the same namespace receive each other's
commands: each logs that it is not alone.

In lockstep the rig publishes its time on `clock` in its own namespace, so that no rig changes another's time. Tools
with `use_sim_time` receive it by `-r /clock:=/rig/clock`; if there is only one rig, give `-r clock:=/clock` to the
plant.
"""

NODES = {
    "abrace_plant": {
        "plant": "Takes `brace_command`, `ground_motion`, `emergency_stop`, `/emergency_stop`; publishes `response`, "
        "`joint_states`, `robot_description`, in lockstep `clock` (rosgraph_msgs/Clock). Service `~/clear_fault` "
        "(std_srvs/Trigger).",
        "sensor_bridge": "Takes and publishes the same as `plant`, except `clock`. Services `~/clear_fault`, "
        "`~/zero_sensors` (std_srvs/Trigger): bridge.md.",
        "ground_motion": "Takes `response`; publishes `ground_motion`. Action `play_ground_motion`, service "
        "`~/clear_fault`.",
        "record": "Offline: a record as read and as it would be played, as numbers and a figure.",
        "robot_description": "Offline: prints a rig's robot description (URDF).",
        "check_sensors": "Offline: mean, noise, range use and drift of each channel; names those that are dead, "
        "clipped, noisy, swapped, or have the wrong sign or gain (bridge.md). Ends with code 1 if there is one.",
        "jitter": "Takes `response` of a running rig; writes numbers and a figure: real_time.md.",
        "characterize": "Offline: measures a rig as the paper measured its building; writes numbers and a figure.",
    },
    "abrace_bags": {
        "logger": "Takes the topics that it records. Services `~/start`, `~/stop`, `~/pause`, `~/resume`, `~/split`, "
        "`~/snapshot` (all std_srvs/Trigger): bags.md.",
        "replay": "Publishes the topics of a bag. Services `~/pause` (std_srvs/SetBool), `~/step` (std_srvs/Trigger): "
        "replay.md.",
        "recover": "Offline: writes what can be read of a damaged bag, and reports what is missing, topic by topic: "
        "bags.md.",
    },
    "abrace_sysid": {
        "ambient": "Offline: bags without commands to modes with intervals; reports whether the building has changed "
        "(ambient.md).",
        "excitation": "Takes `response`; publishes `brace_command`. Service `~/clear_fault`.",
        "identify": "Offline: bags, or measured data, to models, poles and figures.",
        "validate": "Offline: a bag against its simulation by a model.",
    },
    "abrace": {
        "supervisor": "Takes `/diagnostics`; configures and activates the rig of a launch: launch.md. Ends with code "
        "1 if nodes did not find each other, there was a fault, or a signal was interrupted.",
    },
    "abrace_bringup": {
        "viewer": "Takes the topics that its clients show, and `/diagnostics`; publishes `markers` for RViz and, "
        "with `operate`, a stop. Serves the topics to Foxglove and Lichtblick, and a page to browsers: viewer.md.",
        "operator": "Takes `response`, `/diagnostics`; publishes `/emergency_stop`, pressed or not, ten times a "
        "second. Calls services of the nodes in its namespace: operator.md.",
    },
    "abrace_lqg": {
        "design": "Offline: a model and weights to a controller file.",
        "controller": "Takes `response`; publishes `brace_command`. Service `~/clear_fault`. Its "
        "parameters are a controller file that `design` wrote.",
        "explore": "Offline: many weight sets tried on an ensemble of records; any of them becomes a controller.",
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


def row(parameter: Parameter) -> str:
    """A parameter as a row of a Markdown table."""
    default = "required" if parameter.required and not parameter.default else f"`{parameter.default!r}`"
    kind = parameter.ros_type.name.lower()
    allowed = ", ".join(f"`{choice}`" for choice in parameter.choices if choice)
    if parameter.minimum is not None:
        most = "or more" if parameter.maximum is None else f"to {parameter.maximum:g}"
        allowed = f"{parameter.minimum:g} {most}"
    description = parameter.description + (" (*live*)" if parameter.live else "")
    return f"| `{parameter.name}` | {kind} | {default} | {allowed} | {description} |"


def parameters(package: str, name: str) -> list[Parameter]:
    """The parameters of a node, those of its kind included."""
    module = importlib.import_module(f"{package}.nodes.{name}")
    found, table = node_class(module), list(module.PARAMETERS)
    if issubclass(found, RigNode):
        table = [*RIG_PARAMETERS, *table]
    if issubclass(found, BraceCommander):
        table.append(RATE_LIMIT)
    return [*table, *real_time.PARAMETERS, AUTOSTART] if issubclass(found, AbraceLifecycleNode) else table


def page() -> str:
    """The whole page."""
    parts = [INTRODUCTION]
    for package, nodes in NODES.items():
        for name, topics in nodes.items():
            module = importlib.import_module(f"{package}.nodes.{name}")
            lifecycle = issubclass(node_class(module), AbraceLifecycleNode)
            summary = (module.__doc__ or "").split("\n\n")[0].partition(": ")[2].replace("\n", " ")
            parts.append(f"## {name}\n")
            parts.append(f"`abrace run {package} {name}`{' (life cycle node)' if lifecycle else ''}: {summary}\n")
            parts.append("\n".join(textwrap.wrap(topics, 120)) + "\n")
            example = next(line for line in (module.__doc__ or "").splitlines() if line.startswith("abrace run "))
            parts.append(f"For example `{example}`\n")
            parts.append("| parameter | type | default | allowed | what it is |\n|---|---|---|---|---|")
            parts.append("\n".join(row(parameter) for parameter in parameters(package, name)) + "\n")
    return "\n".join(parts)


if __name__ == "__main__":
    write_text(PAGE, page())
