# SPDX-License-Identifier: Apache-2.0
"""The SROS2 policy: what each enclave may publish, subscribe to, serve and call.

Only what is named is allowed. The tests compare it with what the nodes' source creates, and with the running graph.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from xml.etree import ElementTree

from abrace_core.files.command_line import OneLineParser

STOPS = ("/emergency_stop", "emergency_stop")
OF_RIG = ("response", "joint_states", "robot_description", "clock")
"""Published by a rig alone."""
ALL = ("/diagnostics", *OF_RIG, "brace_command", "ground_motion", *STOPS)
"""What a test records by default, and a viewer shows."""
RIGS, COMMANDERS, MOTION = ("plant", "sensor_bridge"), ("controller", "excitation"), "ground_motion"
MOVING = (*RIGS, *COMMANDERS, MOTION)
"""Nodes with a life cycle, which move something, and with a fault that a person clears."""
LIFE_CYCLE = (
    *("change_state", "get_state", "get_available_states", "get_available_transitions"),
    "get_transition_graph",
)
PARAMETERS = (
    *("describe_parameters", "get_parameter_types", "get_parameters", "list_parameters"),
    *("set_parameters", "set_parameters_atomically"),
)
PLAYING = ("excitation/play", f"{MOTION}/play")
RECORDING = ("start", "stop")


def _of(nodes: tuple[str, ...], names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{node}/{name}" for node in nodes for name in names)


@dataclass(frozen=True)
class Node:
    """A node of an enclave: its name, and what it may do besides serving its own services and writing logs."""

    name: str
    publish: tuple[str, ...] = ()
    subscribe: tuple[str, ...] = ()
    request: tuple[str, ...] = ()
    execute: tuple[str, ...] = ()
    call: tuple[str, ...] = ()


REPORT, TRANSITIONS = ("/diagnostics",), _of(MOVING, ("transition_event",))
OWN = (*REPORT, "~/transition_event")
OPERATED = (
    *_of(MOVING, ("clear_fault", *LIFE_CYCLE)),
    "sensor_bridge/zero_sensors",
    *_of((*MOVING, "logger", "supervisor"), PARAMETERS),
    *_of(("logger",), RECORDING),
    *PLAYING,
)
ENCLAVES: dict[str, tuple[Node, ...]] = {
    **{rig: (Node(rig, (*OWN, *OF_RIG), ("brace_command", MOTION, *STOPS)),) for rig in RIGS},
    **{node: (Node(node, (*OWN, "brace_command"), ("response",)),) for node in COMMANDERS},
    MOTION: (Node(MOTION, (*OWN, MOTION), ("response",), execute=("play_ground_motion",)),),
    "logger": (Node("logger", REPORT), Node("_logger_input", (), ALL)),
    "supervisor": (
        Node("supervisor", REPORT),
        Node("supervisor_monitor", (), REPORT, (*_of(MOVING, ("change_state",)), *PLAYING)),
    ),
    "operator": (Node("operator", (*REPORT, *STOPS), (*ALL, *TRANSITIONS), OPERATED, call=("play_ground_motion",)),),
    # looks, and does nothing else; so does a page with operate:=false
    "viewer": (
        Node("viewer", REPORT, REPORT),
        Node("_viewer_input", (), (*ALL, *TRANSITIONS)),
        Node("operator", REPORT, ("/diagnostics", "response")),
    ),
}
"""By its name: the nodes that an enclave is for. Nodes without an enclave: docs/computers.md."""


def policy(namespace: str = "/rig") -> bytes:
    """The policy, an XML file as sros2 reads it, for nodes in a `namespace`."""
    root = ElementTree.Element("policy", version="0.2.0")
    enclaves = ElementTree.SubElement(root, "enclaves")
    for name, nodes in ENCLAVES.items():
        enclave = ElementTree.SubElement(enclaves, "enclave", path=f"/abrace/{name}")
        profiles = ElementTree.SubElement(enclave, "profiles")
        for node in nodes:
            profile = ElementTree.SubElement(profiles, "profile", ns=namespace, node=node.name)
            for kind, act, names in (
                ("topic", "publish", ("/rosout", "/parameter_events", *node.publish)),
                ("topic", "subscribe", node.subscribe),
                ("service", "reply", ("~/*",)),
                ("service", "request", node.request),
                ("action", "execute", node.execute),
                ("action", "call", node.call),
            ):
                entries = ElementTree.SubElement(profile, f"{kind}s", {act: "ALLOW"}) if names else profile
                for each in names:
                    ElementTree.SubElement(entries, kind).text = each
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"


def main() -> int:
    """Entry point of `policy`: prints the policy, from which `ros2 security generate_artifacts` makes a keystore."""
    parser = OneLineParser(
        prog="policy",
        description="Print the SROS2 policy, which has an enclave for each kind of node.",
        example="policy /rig > policy.xml && ros2 security generate_artifacts -k keystore -p policy.xml",
    )
    parser.add_argument("namespace", nargs="?", default="/rig", help="of the nodes")
    namespace = parser.parse_args().namespace
    if not re.fullmatch(r"/([A-Za-z_]\w*(/[A-Za-z_]\w*)*)?", namespace, re.ASCII):
        expected = "expected one such as /rig, of letters, digits and underscores"
        print(f"policy: namespace {namespace}, {expected}", file=sys.stderr)
        return 2
    sys.stdout.buffer.write(policy(namespace))
    return 0
