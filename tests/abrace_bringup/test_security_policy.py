# SPDX-License-Identifier: Apache-2.0
"""The security policy: of the form that SROS2 takes, whole, and with nothing allowed that could do harm."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from importlib import import_module

import pytest
from policy import KINDS, may, permissions
from write_nodes import NODES, node_class
from write_topics import all_endpoints

from abrace_bringup.policy import main, policy

POLICY = permissions()
RIGS = {"plant", "sensor_bridge"}
COMMANDERS = {"controller", "excitation"}
NO_ENCLAVE = {"replay"}
"""The node for which docs/computers.md says that there is none."""
DRIVEN = sorted(RIGS | COMMANDERS | {"ground_motion"})


def who(act: str, name: str) -> set[str]:
    return {path.rpartition("/")[2] for path, rules in POLICY.items() if may(rules, act, name)}


def test_the_policy_is_of_the_form_that_sros2_takes():
    """Its schema is `policy.xsd` of sros2 0.13."""
    root = ElementTree.fromstring(policy())
    assert (root.tag, root.attrib) == ("policy", {"version": "0.2.0"})
    assert [child.tag for child in root] == ["enclaves"]
    assert len({enclave.attrib["path"] for enclave in root[0]}) == len(root[0]) > 0
    for enclave in root[0]:
        assert (enclave.tag, set(enclave.attrib)) == ("enclave", {"path"})
        assert [child.tag for child in enclave] == ["profiles"]
        for profile in enclave[0]:
            assert (profile.tag, set(profile.attrib)) == ("profile", {"ns", "node"})
            for entries in profile:
                entry, acts = KINDS[entries.tag]
                assert entries.attrib
                assert set(entries.attrib) <= set(acts)
                assert set(entries.attrib.values()) == {"ALLOW"}, "what is not allowed is denied"
                assert len(entries) > 0
                assert {child.tag for child in entries} == {entry}
                names = [child.text for child in entries]
                assert len(set(names)) == len(names)
                assert all(names)


ACTS = {"publishes": "publish", "subscribes": "subscribe", "serves": "reply", "acts": "execute"}


def test_all_that_the_source_of_the_nodes_creates_is_allowed_to_the_node():
    modules = {name: import_module(f"{package}.nodes.{name}") for package, names in NODES.items() for name in names}
    offline = {name for name, module in modules.items() if hasattr(node_class(module), "work")} - {"supervisor"}
    running = modules.keys() - offline - NO_ENCLAVE
    assert running == {path.rpartition("/")[2] for path in POLICY}, "an enclave for each node that runs in a graph"
    for node in running:
        for each in all_endpoints()[node]:
            name = each.name if each.name[0] == "/" else f"/rig/{each.name}".replace("/~", f"/{node}")
            assert may(POLICY[f"/abrace/{node}"], ACTS[each.act], name), (node, each.act, name)


@pytest.mark.parametrize(
    ("name", "allowed"),
    [
        ("brace_command", COMMANDERS),
        ("ground_motion", {"ground_motion"}),
        ("response", RIGS),
        ("clock", RIGS),
        ("emergency_stop", {"operator"}),
    ],
)
def test_only_those_write_a_topic_who_have_to(name, allowed):
    assert who("publish", f"/rig/{name}") == allowed
    assert not who("publish", f"/{name}") or name == "emergency_stop"


def test_only_operators_stop_the_whole_laboratory():
    assert who("publish", "/emergency_stop") == {"operator"}
    assert who("subscribe", "/emergency_stop") >= RIGS
    assert who("subscribe", "/rig/emergency_stop") >= RIGS


@pytest.mark.parametrize("node", DRIVEN)
def test_only_operators_clear_faults_and_change_parameters_and_only_the_supervisor_changes_states_too(node):
    for service in ("clear_fault", "set_parameters", "set_parameters_atomically"):
        assert who("request", f"/rig/{node}/{service}") == {"operator"}
    assert who("request", f"/rig/{node}/change_state") == {"operator", "supervisor"}
    for service in ("clear_fault", "change_state", "set_parameters"):
        assert who("reply", f"/rig/{node}/{service}") == {node}, "nobody answers in another's place"


def test_a_viewer_reads_and_does_nothing_else():
    outward = {
        (act, name) for act, name in POLICY["/abrace/viewer"] if act in ("publish", "request", "call", "execute")
    }
    assert outward == {("publish", name) for name in ("/rosout", "/parameter_events", "/diagnostics")}


def test_only_operators_start_motions():
    assert who("call", "/rig/play_ground_motion") == {"operator"}
    assert who("execute", "/rig/play_ground_motion") == {"ground_motion"}


def test_the_policy_is_printed_for_a_namespace(monkeypatch, capfdbinary):
    for words, code, printed in (
        ([], 0, policy("/rig")),
        (["/left/rig_2"], 0, policy("/left/rig_2")),
        (["rig"], 2, b""),
        (["/rig|x"], 2, b""),
    ):
        monkeypatch.setattr("sys.argv", ["policy", *words])
        assert main() == code
        out, err = capfdbinary.readouterr()
        assert out == printed
        assert err.startswith(b"policy: namespace ") == bool(code)
    assert ("publish", "/left/rig_2/brace_command") in permissions("/left/rig_2")["/abrace/controller"]
