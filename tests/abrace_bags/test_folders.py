# SPDX-License-Identifier: Apache-2.0
"""Which files of a folder are a bag: named by metadata.yaml, renamed, copied, some of them missing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from mcap_variants import inputs, variant

from abrace_bags import Bag, describe, recover
from abrace_core import AbraceError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

ALL = variant(inputs()["SeveralMessages"], ("ch", "mx", "chx", "rch", "rsh", "st"))


def folder(path: Path, names: Sequence[str], named: Sequence[str] = (), count: int = 8) -> Path:
    """A folder with copies of one file, and if some are `named` a metadata.yaml that does, with a `count`."""
    path.mkdir()
    for name in names:
        (path / name).write_bytes(ALL)
    if named:
        files = "".join(f"\n  - {name}" for name in named)
        topics = f"[{{topic_metadata: {{name: /text}}, message_count: {count}}}]"
        text = f"rosbag2_bagfile_information:\n  relative_file_paths:{files}\n  topics_with_message_count: {topics}\n"
        (path / "metadata.yaml").write_text(text)
    return path


@pytest.mark.parametrize(
    ("names", "named", "read", "warnings"),
    [
        (["bag_0.mcap"], [], 1, []),
        (["other_0.mcap", "other_1.mcap"], [], 2, []),
        (["other_3.mcap", "other_5.mcap"], [], 2, ["other_4.mcap is missing"]),
        (["any.mcap"], [], 1, []),
        (["other_0.mcap", "other_0 (copy).mcap"], [], 1, ["other_0 (copy).mcap: is not read, the bag's own are "]),
        (["bag_0.mcap", "other_0.mcap"], [], 1, ["other_0.mcap: is not read"]),
        (["new.mcap"], ["old.mcap"], 1, ["old.mcap is missing"]),
        (["a.mcap"], ["a.mcap", "b.mcap"], 1, ["b.mcap is missing"]),
        (["a.mcap", "b.mcap"], ["a.mcap"], 1, ["b.mcap: is not read, metadata.yaml does not name it"]),
    ],
)
def test_a_bag_is_its_own_files_and_says_what_is_missing(
    tmp_path: Path, names: list[str], named: list[str], read: int, warnings: list[str]
) -> None:
    path = folder(tmp_path / "bag", names, named)
    for found in (Bag(path).raw().warnings, describe(path).warnings, recover(path, tmp_path / "new").warnings):
        assert len(found) == len(warnings)
        assert all(expected in warning for expected, warning in zip(warnings, found, strict=True)), found
    assert Bag(tmp_path / "new").raw().count == 8 * read


def test_files_of_several_recordings_are_no_bag(tmp_path: Path) -> None:
    for k, names in enumerate((["a_0.mcap", "b_0.mcap"], ["one.mcap", "two.mcap"])):
        path = folder(tmp_path / f"bag{k}", names)
        with pytest.raises(AbraceError, match=rf"several recordings and no metadata.yaml .*{names[0]}, .*{names[1]}"):
            Bag(path)
        assert Bag(path / names[0]).raw().count == 8


def test_messages_that_only_the_metadata_counts_are_missing(tmp_path: Path) -> None:
    path = folder(tmp_path / "bag", ["bag_0.mcap"], ["bag_0.mcap"], count=50)
    expected = f"{path}: metadata.yaml counts 50 messages of /text, 8 are there"
    bag = Bag(path)
    bag.arrays()
    assert bag.warnings == Bag(path).raw().warnings == describe(path, check=True).warnings == (expected,)
