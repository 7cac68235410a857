# SPDX-License-Identifier: Apache-2.0
"""The graphs that launch files start: arguments, nodes, their parameters, and the consequence of a node's end."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from abrace_bringup.arguments import (
    OWN_NODE,
    Argument,
    band_or_none,
    controller,
    duration,
    enclave_folder,
    exaggeration,
    flag,
    forces,
    namespace,
    new_bag,
    number,
    one_of,
    parameter_file_or_none,
    record,
    rig,
)
from abrace_core.installed import find_file
from abrace_core.yaml_text import read_yaml

if TYPE_CHECKING:
    from collections.abc import Mapping

COMMON = (
    Argument("bag", "", "bag (a new directory) to write; required", new_bag),
    Argument("namespace", "rig", "namespace of all nodes", namespace),
    Argument("rig", "ncree_three_storey", "rig: a name in abrace_plant's configuration or a file", rig),
    Argument("plant", "true", "true: start the simulated rig; false: a real or remote rig is running", flag),
    Argument("free_decay", "5.0", "s that are recorded after the end of the signal", number),
    Argument("patience", "30.0", "s within which the nodes have to start and find each other", number),
    Argument(
        "parameters",
        "",
        "ROS parameter file for all nodes, by their names; overrides the arguments; empty: none",
        parameter_file_or_none,
    ),
    Argument(
        "enclaves",
        "",
        "SROS2: folder of the nodes' enclaves in the keystore, such as /abrace; empty: none are named",
        enclave_folder,
    ),
    Argument("robot_state_publisher", "false", "true: start robot_state_publisher as well, for RViz", flag),
    Argument("exaggeration", "20.0", "factor by which RViz enlarges displacements; 1.0: as measured", exaggeration),
)
CLOSED_LOOP = (
    Argument(
        "controller",
        "",
        "controller file (YAML) that `design` wrote, or PACKAGE/EXECUTABLE of a node of your own; required",
        controller,
    ),
    Argument(
        "record",
        "el_centro",
        "ground motion: a known name or a file; empty: wait for the action play_ground_motion, until stopped",
        record,
    ),
    Argument("peak_acceleration", "0.980665", "m/s^2 that the record is scaled to; 0.0: as recorded", number),
    Argument("duration", "0.0", "s to which the record is cut or padded; 0.0: whole", number),
    *COMMON,
)
IDENTIFICATION = (
    Argument(
        "drive",
        "",
        "what moves the rig: table, command or both; required; both: multisines on odd lines of "
        "the table and even ones of the command",
        one_of("table", "command", "both"),
    ),
    Argument(
        "signal",
        "white_noise",
        "white_noise or multisine, of table or command; both at once are multisines in any case",
        one_of("white_noise", "multisine"),
    ),
    Argument("duration", "300.0", "s of the signal", duration),
    Argument("table_rms", "0.25", "m/s^2, rms of the table's acceleration", duration),
    Argument(
        "table_band",
        "",
        "Hz, band of the table's signal, to above the building's highest mode; empty: to 10 Hz, noise from 0.1 Hz, a "
        "multisine from 0.3 Hz",
        band_or_none,
    ),
    Argument(
        "command_rms",
        "",
        "N, rms of the force of one brace: of all groups, or of each; empty: 7 % of the capacity of each",
        forces,
    ),
    Argument(
        "command_band",
        "",
        "Hz, band of the commands; empty: to 30 Hz, noise from 0 Hz, a multisine from 0.3 Hz",
        band_or_none,
    ),
    *COMMON,
)
SUPERVISOR = "supervisor"
COMMAND_SHARE = 0.07
"""Rms of the commands over the capacity in a test for identification: that of the paper's test, 1.8 of 24.5 kN."""


@dataclass(frozen=True)
class NodeSetup:
    """A node to start: its package and executable, its parameters, and parameter files that go before them."""

    package: str
    executable: str
    parameters: Mapping[str, Any]
    files: tuple[str, ...] = field(default=())


def closed_loop(values: Mapping[str, Any]) -> list[NodeSetup]:
    """The nodes of the closed loop.

    Parameters
    ----------
    values
        Of the arguments `CLOSED_LOOP`.
    """
    motion = {name: values[name] for name in ("rig", "record", "peak_acceleration", "duration")}
    motion |= _sample_rate(_read_rig(values["rig"]))
    given = values["controller"]
    if OWN_NODE.fullmatch(given):
        package, executable = given.split("/")
        commander, files = NodeSetup(package, executable, {}), []
    else:
        commander, files = NodeSetup("abrace_lqg", "controller", {}, (given,)), [given]
    partners = {"brace_command": commander, "ground_motion": NodeSetup("abrace_plant", "ground_motion", motion)}
    signals = ["ground_motion"] if values["record"] else []
    return _test(values, partners, signals, files)


def identification(values: Mapping[str, Any]) -> list[NodeSetup]:
    """The nodes of a test for identification.

    Parameters
    ----------
    values
        Of the arguments `IDENTIFICATION`.
    """
    both = values["drive"] == "both"
    signal = "multisine" if both else values["signal"]
    # the table not from 0 Hz: its displacement grows with 1 / frequency^2
    lowest, lowest_command = (0.3, 0.3) if signal == "multisine" else (0.1, 0.0)
    rig = _read_rig(values["rig"])
    drive = {"duration": values["duration"], **_sample_rate(rig)}
    partners = {}
    if both or values["drive"] == "table":
        band = values["table_band"] or [lowest, 10.0]
        motion = {"rig": values["rig"], "record": signal, "rms": values["table_rms"], "band": band, **drive}
        partners["ground_motion"] = NodeSetup("abrace_plant", "ground_motion", motion)
    if both or values["drive"] == "command":
        lines = "even" if both else "odd"
        limits = _capacities(rig)
        rms = values["command_rms"] or [round(COMMAND_SHARE * limit, 1) for limit in limits]
        band = values["command_band"] or [lowest_command, 30.0]
        command = {"signal": signal, "rms": rms, "band": band, "lines": lines, "force_limit": limits, **drive}
        partners["brace_command"] = NodeSetup("abrace_sysid", "excitation", command)
    return _test(values, partners, [partner.executable for partner in partners.values()], [])


def _test(
    values: Mapping[str, Any], partners: Mapping[str, NodeSetup], signals: list[str], attachments: list[str]
) -> list[NodeSetup]:
    """Logger, the rig's partners by the topic that they publish, the rig, and the supervisor that begins and ends."""
    plant = values["plant"]
    files = [file for file in (*attachments, values["parameters"], *_rig_files(values["rig"])) if file]
    supervision = {
        "inputs": [f"{topic}={partner.executable}" for topic, partner in partners.items()],
        "plant": plant,
        "signals": signals,
        "free_decay": values["free_decay"],
        "patience": values["patience"],
    }
    setups = [
        NodeSetup("abrace_bags", "logger", {"output": values["bag"], "attachments": files}),
        *(
            NodeSetup(each.package, each.executable, {**each.parameters, "autostart": plant}, each.files)
            for each in partners.values()
        ),
        *([NodeSetup("abrace_plant", "plant", {"rig": values["rig"], "autostart": False})] if plant else []),
        NodeSetup("abrace", SUPERVISOR, supervision),
    ]
    # an empty list has no type in ROS, and is what those parameters are without it
    return [
        NodeSetup(each.package, each.executable, {k: v for k, v in each.parameters.items() if v != []}, each.files)
        for each in setups
    ]


def _read_rig(rig: str) -> dict[str, Any]:
    """The content of the file of a `rig`, which the plant checks."""
    content = read_yaml(find_file(rig, "abrace_plant", "config", ".yaml", "rig"), "rig")
    return content if isinstance(content, dict) else {}


def _sample_rate(rig: Mapping[str, Any]) -> dict[str, float]:
    """The parameter `sample_rate` of a node that answers a `rig`, from the content of its file."""
    try:
        return {"sample_rate": float(rig["sample_rate"])}
    except (TypeError, ValueError, KeyError):
        return {}


def _capacities(rig: Mapping[str, Any]) -> list[float]:
    """Capacity of one brace of each group [N] in the content of a `rig` file; empty if it has none or is wrong."""
    groups = rig.get("braces")
    try:
        return [float(group["actuator"]["capacity"]) for group in groups or []]
    except (TypeError, ValueError, KeyError):
        return []


def _rig_files(rig: str) -> list[str]:
    """The file of a `rig` and the frame file that it names; none of an installed rig. The plant checks them."""
    if not rig.endswith(".yaml"):
        return []
    building = _read_rig(rig).get("building")
    frame = building.get("frame") if isinstance(building, dict) else None
    if not isinstance(frame, str):
        return [rig]
    return [rig, str(find_file(frame, "abrace_plant", "config/frames", ".yaml", "frame"))]


def end_of_node(executable: str, returncode: int, shutting_down: bool) -> str | None:
    """The consequence of the end of a required node for the launch.

    Parameters
    ----------
    executable
        Which node it was.
    returncode
        Its exit code, or minus the signal that ended it.
    shutting_down
        Whether the launch is being shut down.

    Returns
    -------
    str or None
        What went wrong; empty: the test is over; None: nothing.
    """
    if shutting_down and returncode in (0, -2):
        return None
    if returncode == 0 and executable in (SUPERVISOR, "plant"):
        return ""
    how = f"exit code {returncode}" if returncode >= 0 else f"signal {-returncode}"
    return f"{executable} has ended with {how}, the test is incomplete"
