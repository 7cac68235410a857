# SPDX-License-Identifier: Apache-2.0
"""Definitions of installed message types: full text, type hash, and clear words where something is missing."""

from __future__ import annotations

import json
import os
from typing import TYPE_CHECKING

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from abrace_bags import message_definition
from abrace_core import AbraceError

if TYPE_CHECKING:
    from pathlib import Path


def install(prefix: Path, name: str, text: str, type_hash: str = "RIHS01_00") -> None:
    package, short = name.split("/")
    folder = prefix / "share" / package / "msg"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{short}.msg").write_text(text)
    hashes = [{"type_name": f"{package}/msg/{short}", "hash_string": type_hash}]
    (folder / f"{short}.json").write_text(json.dumps({"type_hashes": hashes}))


@pytest.fixture
def prefix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'first'}{os.pathsep}{tmp_path / 'second'}")
    return tmp_path / "second"


def test_text_has_every_type_used_once_below_a_separator(prefix: Path) -> None:
    install(prefix, "a_msgs/Top", "Part[] parts\nb_msgs/Leaf leaf\nHeader header", "RIHS01_ab")
    install(prefix, "a_msgs/Part", "b_msgs/Leaf leaf  # shared\n")
    install(prefix, "b_msgs/Leaf", "float64 x\n")
    install(prefix, "std_msgs/Header", "string frame_id\n")
    line = "=" * 80
    found = message_definition("a_msgs/msg/Top")
    assert found.text == (
        "Part[] parts\nb_msgs/Leaf leaf\nHeader header\n"
        f"\n{line}\nMSG: a_msgs/Part\nb_msgs/Leaf leaf  # shared\n"
        f"\n{line}\nMSG: b_msgs/Leaf\nfloat64 x\n"
        f"\n{line}\nMSG: std_msgs/Header\nstring frame_id\n"
    )
    assert found.type_hash == "RIHS01_ab"


def test_first_prefix_wins(prefix: Path) -> None:
    install(prefix, "a_msgs/Leaf", "float64 x\n")
    install(prefix.parent / "first", "a_msgs/Leaf", "int8 x\n")
    assert message_definition("a_msgs/msg/Leaf").text == "int8 x\n"


def test_type_that_is_not_installed_is_named(prefix: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(prefix, "a_msgs/Top", "b_msgs/Leaf leaf\n")
    with pytest.raises(
        AbraceError, match=r"b_msgs/Leaf is not installed: no share/b_msgs/msg/Leaf.msg in the 2 folders"
    ):
        message_definition("a_msgs/msg/Top")
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    with pytest.raises(AbraceError, match="AMENT_PREFIX_PATH, which is empty"):
        message_definition("a_msgs/msg/Top")


@pytest.mark.parametrize("name", ["Response", "a_msgs/Top", "a_msgs/srv/Top", "../msg/Top", ""])
def test_name_that_is_no_message_type_is_refused(name: str) -> None:
    with pytest.raises(AbraceError, match="expected package/msg/Type"):
        message_definition(name)


def test_missing_or_odd_hash_file_is_reported(prefix: Path) -> None:
    install(prefix, "a_msgs/Leaf", "float64 x\n")
    path = prefix / "share/a_msgs/msg/Leaf.json"
    path.write_text("{}")
    with pytest.raises(AbraceError, match=r"Leaf.json: expected `type_hashes` with an entry for a_msgs/msg/Leaf"):
        message_definition("a_msgs/msg/Leaf")
    path.unlink()
    with pytest.raises(AbraceError, match=r"Leaf.json: No such file"):
        message_definition("a_msgs/msg/Leaf")


def test_malformed_definition_names_file_and_line(prefix: Path) -> None:
    install(prefix, "a_msgs/Leaf", "float64 x\nfloat64[ y\n")
    with pytest.raises(AbraceError, match=r"Leaf.msg: message definition, line 2"):
        message_definition("a_msgs/msg/Leaf")


@pytest.mark.skipif("abrace_interfaces" not in os.environ.get("AMENT_PREFIX_PATH", ""), reason="no sourced workspace")
@pytest.mark.parametrize(
    "name",
    [
        "abrace_interfaces/msg/Response",
        "abrace_interfaces/msg/BraceCommand",
        "abrace_interfaces/action/PlayGroundMotion_FeedbackMessage",
    ],
)
def test_installed_interfaces_have_the_hash_that_rosbags_computes(name: str) -> None:
    found = message_definition(name)
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register({k: v for k, v in get_types_from_msg(found.text, name).items() if k not in store.types})
    assert store.hash_rihs01(name) == found.type_hash
