# SPDX-License-Identifier: Apache-2.0
"""What a person can have done on the page, and which nodes it is done to, in which order."""

from __future__ import annotations

from typing import TYPE_CHECKING

from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

NEEDS = {
    "arm": "change_state",
    "disarm": "change_state",
    "clear": "clear_fault",
    "play": "play",
    "zero": "zero_sensors",
    "record": "start",
    "end_record": "stop",
}
"""Service by which each action is done. Stop and its release need none: they are a topic."""
RECORDER = frozenset({"start", "stop"})
"""Services by which a logger is known."""
OFFERED = frozenset(NEEDS.values())
WORDS = {
    "arm": "arm the rig",
    "disarm": "disarm the rig",
    "clear": "clear faults",
    "play": "play a signal",
    "zero": "zero the sensors",
    "record": "start recording",
    "end_record": "stop recording",
}


def offers(services: Sequence[str]) -> dict[str, frozenset[str]]:
    """By full name of a node which services in OFFERED it has, by the full names of all `services`."""
    found: dict[str, set[str]] = {}
    for full in services:
        node, _, service = full.rpartition("/")
        if service in OFFERED and node:
            found.setdefault(node, set()).add(service)
    return {node: frozenset(names) for node, names in found.items()}


def recorders(offered: Mapping[str, frozenset[str]], namespace: str) -> list[str]:
    """Full names of the loggers in a `namespace`, by what is `offered`."""
    return [node for node, names in sorted(offered.items()) if names >= RECORDER and _within(node, namespace)]


def targets(
    action: str,
    node: str,
    offered: Mapping[str, frozenset[str]],
    namespace: str,
    rigs: Sequence[str],
    failed: Sequence[str],
) -> list[str]:
    """Full names of the nodes to which an action is done, in order.

    Parameters
    ----------
    action
        A key of NEEDS.
    node
        The one that was asked for; empty: those of the page's rig.
    offered
        What each node offers.
    namespace
        Of the page.
    rigs
        Nodes that obey the stop button.
    failed
        Nodes that report a fault.

    Raises
    ------
    AbraceError
        If there is none.
    """
    if action not in NEEDS:
        raise AbraceError(f"action {action!r}: unknown, expected one of {', '.join(NEEDS)}")
    able = [name for name, names in sorted(offered.items()) if NEEDS[action] in names and _within(name, namespace)]
    if node:
        found = [name for name in able if name == node]
    elif action in ("record", "end_record"):
        found = recorders(offered, namespace)
    elif action == "clear":
        # a rig refuses while whoever commands it reports a fault of its own
        found = sorted((name for name in able if name in failed), key=lambda name: (name in rigs, name))
    elif action in ("arm", "disarm"):
        found = [name for name in able if name in rigs]
    else:
        found = able
    if not found:
        raise AbraceError(_none(action, node, namespace))
    return found


def _within(node: str, namespace: str) -> bool:
    return node.rpartition("/")[0] == namespace.rstrip("/")


def _none(action: str, node: str, namespace: str) -> str:
    if node:
        return f"{node} in namespace {namespace}: not there, or it cannot {action}"
    if action == "clear":
        return f"no node in namespace {namespace} reports a fault"
    kinds = {"zero": "a rig with zero_sensors", "play": "a signal", "record": "a logger", "end_record": "a logger"}
    kind = kinds.get(action, "a rig")
    return f"no node in namespace {namespace} to {WORDS[action]}, expected {kind}"
