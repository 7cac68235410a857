# SPDX-License-Identifier: Apache-2.0
"""The graphs of nodes that run a test: arguments, nodes with their parameters, and the meaning of a node's end.

`ros2 launch` starts them (`description`), and `abrace run` where there is none (`without_launch`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from abrace_bringup.arguments import (
    NAMESPACE,
    OWN_NODE,
    RECORD_FILES,
    Argument,
    band,
    controller,
    flag,
    matching,
    name_or_file,
    new_bag,
    number,
    numbers,
    one_of,
    parameter_file,
    positive,
    read_arguments,
)
from abrace_core.files.installed import find_file
from abrace_core.files.reading import read_yaml
from abrace_core.files.units import number_in

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

SUPERVISOR = "supervisor"
COMMAND_SHARE = 0.07
"""Rms of the commands over the capacity in a test for identification: that of the paper's test, 1.8 of 24.5 kN."""


@dataclass(frozen=True)
class NodeSetup:
    """A node to start.

    Parameters
    ----------
    package, executable
        Of the node, which has the executable's name.
    parameters
        By name.
    files
        Parameter files, of which the later ones go before, and all go before `parameters`.
    namespace
        With its slash.
    enclave
        Of SROS2; empty: none is named.
    """

    package: str
    executable: str
    parameters: Mapping[str, Any]
    files: tuple[str, ...] = field(default=())
    namespace: str = "/"
    enclave: str = ""


@dataclass(frozen=True)
class Graph:
    """A graph that can be launched.

    Parameters
    ----------
    name
        Of its launch file and its executable.
    about
        What it runs.
    example
        Arguments of a first run.
    own
        Its arguments besides `COMMON`.
    make
        Makes the nodes of the values of all arguments.
    """

    name: str
    about: str
    example: str
    own: tuple[Argument, ...]
    make: Callable[[Mapping[str, Any]], list[NodeSetup]]

    @property
    def arguments(self) -> tuple[Argument, ...]:
        """All its arguments."""
        return (*self.own, *COMMON)

    def nodes(self, texts: Mapping[str, str], given: Collection[str] = ()) -> list[NodeSetup]:
        """The nodes in the order in which they are started, by the `texts` of arguments; `given` as `read_arguments`.

        Raises
        ------
        AbraceError
            If an argument is wrong.
        """
        values = read_arguments(self.arguments, texts, given)
        further = (values["parameters"],) if values["parameters"] else ()
        return [
            replace(
                each,
                # an empty list has no type in ROS, and is what those parameters are without it
                parameters={name: value for name, value in each.parameters.items() if value != []},
                files=(*each.files, *further),
                namespace="/" + values["namespace"].lstrip("/"),
                enclave=f"{values['enclaves']}/{each.executable}" if values["enclaves"] else "",
            )
            for each in self.make(values)
        ]


def _closed_loop(values: Mapping[str, Any]) -> list[NodeSetup]:
    motion = {name: values[name] for name in ("rig", "record", "peak_acceleration", "duration")}
    given = values["controller"]
    if OWN_NODE.fullmatch(given):
        package, executable = given.split("/")
        commander, files = NodeSetup(package, executable, {}), []
    else:
        commander, files = NodeSetup("abrace_lqg", "controller", {}, (given,)), [given]
    partners = {"brace_command": commander, "ground_motion": NodeSetup("abrace_plant", "ground_motion", motion)}
    signals = ["ground_motion"] if values["record"] else []
    return _test(values, partners, signals, files)


def _identification(values: Mapping[str, Any]) -> list[NodeSetup]:
    both = values["drive"] == "both"
    signal = "multisine" if both else values["signal"]
    # the table not from 0 Hz: its displacement grows with 1 / frequency^2
    lowest, lowest_command = (0.3, 0.3) if signal == "multisine" else (0.1, 0.0)
    drive = {"duration": values["duration"]}
    partners = {}
    if both or values["drive"] == "table":
        limits = values["table_band"] or [lowest, 10.0]
        motion = {"rig": values["rig"], "record": signal, "rms": values["table_rms"], "band": limits, **drive}
        partners["ground_motion"] = NodeSetup("abrace_plant", "ground_motion", motion)
    if both or values["drive"] == "command":
        lines = "even" if both else "odd"
        rig = _read_rig(values["rig"])
        capacity = _capacities(rig)
        rms = values["command_rms"] or [round(COMMAND_SHARE * each, 1) for each in capacity]
        limits = values["command_band"] or [lowest_command, 30.0]
        command = {"signal": signal, "rms": rms, "band": limits, "lines": lines, "force_limit": capacity}
        command |= drive | _sample_rate(rig)
        partners["brace_command"] = NodeSetup("abrace_sysid", "excitation", command)
    return _test(values, partners, [partner.executable for partner in partners.values()], [])


def _test(
    values: Mapping[str, Any], partners: Mapping[str, NodeSetup], signals: list[str], attachments: list[str]
) -> list[NodeSetup]:
    """Logger, the rig's partners by the topic that they publish, the rig, and the supervisor that begins and ends."""
    plant = values["plant"]
    find_file(values["rig"], "abrace_plant", "config", ".yaml", "rig")  # an unknown name is refused here
    own_rig = [values["rig"]] if values["rig"].endswith(".yaml") else []
    files = [file for file in (*attachments, values["parameters"], *own_rig) if file]
    supervision = {
        "inputs": [f"{topic}={partner.executable}" for topic, partner in partners.items()],
        "plant": plant,
        "signals": signals,
        "free_decay": values["free_decay"],
        "patience": values["patience"],
    }
    return [
        NodeSetup("abrace_bags", "logger", {"output": values["bag"], "attachments": files}),
        *(replace(each, parameters={**each.parameters, "autostart": plant}) for each in partners.values()),
        *([NodeSetup("abrace_plant", "plant", {"rig": values["rig"], "autostart": False})] if plant else []),
        NodeSetup("abrace", SUPERVISOR, supervision),
    ]


def _read_rig(rig: str) -> dict[str, Any]:
    """The content of the file of a `rig`, which the plant checks."""
    content = read_yaml(find_file(rig, "abrace_plant", "config", ".yaml", "rig"), "rig")
    return content if isinstance(content, dict) else {}


def _sample_rate(rig: Mapping[str, Any]) -> dict[str, float]:
    """The parameter `sample_rate` of a node that answers a `rig`, from the content of its file."""
    try:
        return {"sample_rate": float(number_in("Hz", rig["sample_rate"]))}
    except (TypeError, ValueError, KeyError):
        return {}


def _capacities(rig: Mapping[str, Any]) -> list[float]:
    """Capacity of one brace of each group [N] in the content of a `rig` file; empty if it has none or is wrong."""
    groups = rig.get("braces")
    try:
        return [float(number_in("N", group["actuator"]["capacity"])) for group in groups or []]
    except (TypeError, ValueError, KeyError):
        return []


COMMON = (
    Argument("bag", "", "bag (a new directory) to write; required", new_bag),
    Argument("namespace", "rig", "namespace of all nodes", matching(NAMESPACE, "a ROS namespace such as rig")),
    Argument(
        "rig",
        "ncree_three_storey",
        "rig: a name in abrace_plant's configuration or a file",
        name_or_file("the name of a rig or a file", ".yaml"),
    ),
    Argument("plant", "true", "true: start the simulated rig; false: a real or remote rig is running", flag),
    Argument("free_decay", "5.0", "s that are recorded after the end of the signal", number),
    Argument("patience", "30.0", "s within which the nodes have to start and find each other", number),
    Argument(
        "parameters",
        "",
        "ROS parameter file for all nodes, by their names; overrides the arguments; empty: none",
        parameter_file,
    ),
    Argument(
        "enclaves",
        "",
        "SROS2: folder of the nodes' enclaves in the keystore, such as /abrace; empty: none are named",
        matching(f"(/{NAMESPACE.removeprefix('/?')})?", "a folder of enclaves such as /abrace"),
    ),
)
CLOSED_LOOP = Graph(
    "closed_loop",
    "The closed loop in real time: rig, controller, ground motion, logger",
    "controller:=lqg3.yaml record:=el_centro bag:=bags/run_1",
    (
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
            name_or_file("", *RECORD_FILES),
        ),
        Argument("peak_acceleration", "0.980665", "m/s^2 that the record is scaled to; 0.0: as recorded", number),
        Argument("duration", "0.0", "s to which the record is cut or padded; 0.0: whole", number),
    ),
    _closed_loop,
)
IDENTIFICATION = Graph(
    "identification",
    "A test for identification in real time: rig, logger, and noise or multisines on the table, as command, or both",
    "drive:=table bag:=bags/table_noise",
    (
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
        Argument("duration", "300.0", "s of the signal", positive),
        Argument("table_rms", "0.25", "m/s^2, rms of the table's acceleration", positive),
        Argument(
            "table_band",
            "",
            "Hz, band of the table's signal, to above the building's highest mode; empty: to 10 Hz, noise from 0.1 Hz, "
            "a multisine from 0.3 Hz",
            band,
        ),
        Argument(
            "command_rms",
            "",
            "N, rms of the force of one brace: of all groups, or of each; empty: 7 % of the capacity of each",
            numbers,
        ),
        Argument(
            "command_band",
            "",
            "Hz, band of the commands; empty: to 30 Hz, noise from 0 Hz, a multisine from 0.3 Hz",
            band,
        ),
    ),
    _identification,
)
GRAPHS = {graph.name: graph for graph in (CLOSED_LOOP, IDENTIFICATION)}


STOPPED = "the test was stopped before it was done"


def has_end(setup: NodeSetup) -> bool:
    """Whether a node is the supervisor of a test with a signal, at whose end it ends; others go on until stopped."""
    return setup.executable == SUPERVISOR and bool(setup.parameters.get("signals"))


def end_of_node(executable: str, returncode: int, shutting_down: bool, ends_the_test: bool = False) -> str | None:
    """The meaning of the end of a node for the test.

    Parameters
    ----------
    executable
        Which node it was.
    returncode
        Its exit code, or minus the signal that ended it.
    shutting_down
        Whether the test is being ended.
    ends_the_test
        Whether this is the supervisor of a test that has an end (`has_end`).

    Returns
    -------
    str or None
        What went wrong; empty: the test is over; None: nothing.
    """
    if ends_the_test and returncode == 130:
        return STOPPED
    if shutting_down and returncode in (0, -2):
        return STOPPED if ends_the_test else None
    if returncode == 0 and executable in (SUPERVISOR, "plant"):
        return ""
    how = f"exit code {returncode}" if returncode >= 0 else f"signal {-returncode}"
    return f"{executable} has ended with {how}, the test is incomplete"
