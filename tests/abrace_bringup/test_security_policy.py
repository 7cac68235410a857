# SPDX-License-Identifier: Apache-2.0
"""The security policy: of the form that SROS2 takes, and with nothing allowed that could do harm."""

from __future__ import annotations

import os
import stat
import subprocess
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from policy import KINDS, may, read_policy

ROOT = Path(__file__).parents[2]
POLICY = ROOT / "src/abrace_bringup/config/security_policy.xml"
SCRIPT = ROOT / "src/abrace_bringup/scripts/make_keystore"
RIGS = {"plant", "sensor_bridge"}
COMMANDERS = {"controller", "excitation"}
STOPPERS = {"operator", "operating_viewer"}
"""A person's: the viewer's is for one with `operate:=true` alone."""
DRIVEN = sorted(RIGS | COMMANDERS | {"ground_motion"})


def who(act: str, name: str) -> set[str]:
    return {path.rpartition("/")[2] for path, rules in read_policy(POLICY).items() if may(rules, act, name)}


def test_the_policy_is_of_the_form_that_sros2_takes():
    """Its schema is `policy.xsd` of sros2 0.13."""
    policy = ElementTree.parse(POLICY).getroot()
    assert (policy.tag, policy.attrib) == ("policy", {"version": "0.2.0"})
    assert [child.tag for child in policy] == ["enclaves"]
    assert len({enclave.attrib["path"] for enclave in policy[0]}) == len(policy[0]) > 0
    for enclave in policy[0]:
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


def test_only_operators_stop_the_whole_laboratory_and_viewers_that_may_operate():
    assert who("publish", "/emergency_stop") == STOPPERS
    assert who("subscribe", "/emergency_stop") >= RIGS
    assert who("subscribe", "/rig/emergency_stop") >= RIGS


@pytest.mark.parametrize("node", DRIVEN)
def test_only_operators_clear_faults_and_change_parameters_and_only_the_supervisor_changes_states_too(node):
    for service in ("clear_fault", "set_parameters"):
        assert who("request", f"/rig/{node}/{service}") == STOPPERS
    assert who("request", f"/rig/{node}/set_parameters_atomically") == {"operator"}
    assert who("request", f"/rig/{node}/change_state") == {"operator", "supervisor"}
    for service in ("clear_fault", "change_state", "set_parameters"):
        assert who("reply", f"/rig/{node}/{service}") == {node}, "nobody answers in another's place"


def test_a_viewer_that_does_not_operate_changes_nothing_and_one_that_does_can_do_all_that_it_shows():
    policy = read_policy(POLICY)
    looking, operating = (set(policy[f"/abrace/{name}"]) for name in ("viewer", "operating_viewer"))
    assert looking < operating
    outward = {(act, name) for act, name in looking if act in ("publish", "request", "call", "execute")}
    readings = ("get_state", "list_parameters", "get_parameters", "describe_parameters")
    assert {name.rpartition("/")[2] for act, name in outward if act == "request"} == set(readings)
    reports = {"/rosout", "/parameter_events", "/diagnostics", "/rig/markers"}
    assert {name for act, name in outward if act != "request"} == reports


def test_only_operators_start_motions():
    assert who("call", "/rig/play_ground_motion") == {"operator"}
    assert who("execute", "/rig/play_ground_motion") == {"ground_motion"}


def keystore_with(folder: Path, ros2: str, *arguments: str) -> subprocess.CompletedProcess:
    """Run the script with a program `ros2` that does as this shell text says."""
    (folder / "ros2").write_text(f"#!/bin/sh\n{ros2}\n")
    (folder / "ros2").chmod(0o755)
    environment = {"PATH": f"{folder}:/usr/bin:/bin"}
    return subprocess.run([SCRIPT, *arguments], env=environment, capture_output=True, text=True, check=False)


CREATES = """
case "$2" in
  create_keystore) mkdir -p "$3/enclaves" && touch "$3/enclaves/governance.p7s" ;;
  create_enclave) mkdir -p "$3/enclaves$4" && touch "$3/enclaves$4/key.pem" ;;
  create_permission) cp "$5" "$3/enclaves$4/policy.xml" ;;
esac
echo "$@" >> "$(dirname "$0")/calls"
"""


def test_the_keystore_has_every_enclave_for_the_namespace_and_is_for_its_owner_alone(tmp_path):
    keystore = tmp_path / "keys"
    ran = keystore_with(tmp_path, CREATES, str(keystore), "/left/rig_2")
    assert (ran.returncode, ran.stderr) == (0, "")
    for enclave in read_policy(POLICY):
        expected = read_policy(POLICY, "/left/rig_2")[enclave]
        assert read_policy(keystore / f"enclaves{enclave}/policy.xml", "/rig")[enclave] == expected
        key = keystore / f"enclaves{enclave}/key.pem"
        assert not stat.S_IMODE(key.stat().st_mode) & 0o077, "a private key is nobody else's"
    calls = len((tmp_path / "calls").read_text().splitlines())
    keystore_with(tmp_path, CREATES, str(keystore), "/left/rig_2")
    again = (tmp_path / "calls").read_text().splitlines()[calls:]
    assert {call.split()[1] for call in again} == {"create_permission", "--help"}, "keys are kept"


@pytest.mark.parametrize(
    ("ros2", "arguments", "message"),
    [
        ("exit 1", ["keys"], "no 'ros2 security', expected ROS 2 with sros2"),
        (CREATES, [], "0 arguments; expected: make_keystore KEYSTORE"),
        (CREATES, ["keys", "rig"], "namespace rig, which begins with /"),
        (CREATES, ["keys", "/rig|x"], "namespace /rig|x, which begins with /"),
        (CREATES, ["keys", "/rig", "none.xml"], "none.xml: no such policy"),
    ],
)
def test_what_it_cannot_do_is_one_line(tmp_path, ros2, arguments, message):
    ran = keystore_with(tmp_path, ros2, *arguments)
    assert ran.returncode == 2
    assert ran.stderr.startswith(f"make_keystore: {message}")
    assert ran.stderr.count("\n") == 1
    assert not os.path.lexists(tmp_path / "keys")
