# SPDX-License-Identifier: Apache-2.0
"""The security policy against the running graph: it allows what the nodes offer and use, or SROS2 would break them."""

from __future__ import annotations

import re
import subprocess

import numpy as np
import pytest
from foxglove_client import FoxgloveClient
from policy import may, permissions

from abrace.processes.group import find_executable
from abrace_core.model.controller_file import Controller, save_controller
from abrace_core.model.linear_model import LinearModel

LAW = LinearModel(np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)), np.zeros((1, 1)), ("a1",), ("U",), 0.002)
SMALL = Controller(
    "small", LAW, np.zeros((1, 1)), np.zeros((1, 2)), np.array([20e3]), model="none", weights="none", margins="none"
)
MARK = "/_action/"
"""Of the topics and services that an action is made of."""


def used(graph, name: str) -> set[tuple[str, str]]:
    """What a node offers and uses: (`publish`, full name), and so on."""
    node, namespace = graph.node, graph.namespace
    if (name, namespace) not in node.get_node_names_and_namespaces():
        return set()
    listed = {
        ("publish", "execute"): node.get_publisher_names_and_types_by_node,
        ("subscribe", "call"): node.get_subscriber_names_and_types_by_node,
        ("reply", "execute"): node.get_service_names_and_types_by_node,
        ("request", "call"): node.get_client_names_and_types_by_node,
    }
    return {
        (of_action, full.partition(MARK)[0]) if MARK in full else (act, full)
        for (act, of_action), names in listed.items()
        for full, _ in names(name, namespace)
    }


def expect_allowed(graph, name: str, act: str, last: str, enclave: str = "") -> None:
    """All that a node offers and uses is in its enclave; `last` comes last."""
    allowed = permissions(graph.namespace)
    expected = (act, f"{graph.namespace}/{last}")
    graph.until(lambda: expected in used(graph, name), f"{name} to {act} {last}")
    found = used(graph, name)
    refused = {(act, full) for act, full in found if not may(allowed[f"/abrace/{enclave or name}"], act, full)}
    assert not refused, f"{name}: {sorted(refused)} is not in its enclave"


def expect_open_to_operators(graph, name: str) -> None:
    """All services of a node are in the operator's enclave."""
    operator = permissions(graph.namespace)["/abrace/operator"]
    served = {full for act, full in used(graph, name) if act == "reply" and not full.endswith("/get_type_description")}
    assert len(served) > 5
    closed = {full for full in served if not may(operator, "request", full)}
    assert not closed, f"{name}: {sorted(closed)} is not in the operator's enclave"


def test_the_policy_allows_what_the_nodes_do(graph, tmp_path):
    enclave = "/abrace/supervisor"
    graph.start("supervisor", "--enclave", enclave, inputs=["brace_command=controller"], patience=120.0)
    expect_allowed(graph, "supervisor_monitor", "request", "plant/change_state", enclave="supervisor")
    expect_allowed(graph, "supervisor", "reply", "supervisor/list_parameters")
    enclaves = graph.node.get_node_names_and_namespaces_with_enclaves()
    found = {name: own for name, namespace, own in enclaves if namespace == graph.namespace}
    assert found == {"test": "/", "supervisor": enclave, "supervisor_monitor": enclave}
    graph.stop("supervisor")
    save_controller(SMALL, tmp_path / "small.yaml")
    graph.start("logger", output=str(tmp_path / "bag"))
    graph.start("operator", port=0)
    graph.start("plant", lockstep=True)
    graph.start("ground_motion")
    graph.start("excitation")
    graph.start("controller", "--params-file", tmp_path / "small.yaml")
    expect_allowed(graph, "plant", "publish", "clock")
    expect_allowed(graph, "ground_motion", "execute", "play_ground_motion")
    expect_allowed(graph, "ground_motion", "publish", "ground_motion")
    expect_allowed(graph, "excitation", "publish", "brace_command")
    expect_allowed(graph, "controller", "publish", "brace_command")
    expect_allowed(graph, "logger", "reply", "logger/stop")
    expect_allowed(graph, "_logger_input", "subscribe", "response", enclave="logger")
    expect_allowed(graph, "operator", "request", "controller/clear_fault")
    for name in ("plant", "ground_motion", "excitation", "controller", "logger"):
        expect_open_to_operators(graph, name)


def test_the_policy_of_the_viewer_allows_what_it_and_a_page_that_only_watches_do(graph):
    graph.start("plant")
    graph.start("viewer", port=0)
    graph.start("operator", port=0, operate=False)
    line = graph.until(lambda: [line for line in graph.output_of("viewer") if "ws://" in line], "its address")
    with FoxgloveClient(int(re.search(r":(\d+)$", line[0])[1])) as client:
        topics = {f"{graph.namespace}/{name}" for name in ("response", "joint_states")}
        graph.until(lambda: topics <= set(client.channels), "the topics of the graph")
        client.subscribe(*(topic for topic in client.channels if topic.startswith(graph.namespace)))
        expect_allowed(graph, "_viewer_input", "subscribe", "response", enclave="viewer")
    expect_allowed(graph, "operator", "subscribe", "response", enclave="viewer")


@pytest.mark.usefixtures("domain")
def test_a_node_without_keys_says_so_and_does_not_start(tmp_path, monkeypatch):
    (tmp_path / "enclaves").mkdir()
    for name, value in (("ENABLE", "true"), ("STRATEGY", "Enforce"), ("KEYSTORE", str(tmp_path))):
        monkeypatch.setenv(f"ROS_SECURITY_{name}", value)
    ran = subprocess.run([find_executable("abrace_plant", "plant")], capture_output=True, text=True, check=False)
    assert ran.returncode == 2
    assert "Traceback" not in ran.stderr
    assert "plant: " in ran.stderr
    assert "security" in ran.stderr.lower()
