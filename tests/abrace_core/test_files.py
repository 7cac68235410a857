# SPDX-License-Identifier: Apache-2.0
"""Files written atomically: whole or not there, whatever happens."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import pytest
from power_loss import Disk, recorded

from abrace_core.errors import AbraceError
from abrace_core.files import make_folder, write_atomically, write_text

if TYPE_CHECKING:
    from pathlib import Path

SAVED = """
from pathlib import Path
from abrace_core.files import make_folder, write_text
for text in ("old " * 10_000, "new " * 20_000):
    write_text(Path("{folder}/results/model/model.json"), text)
"""


def test_a_power_loss_leaves_the_old_file_or_the_new_one_whole(tmp_path: Path) -> None:
    folder = tmp_path / "disk"
    folder.mkdir()
    events = recorded(folder, [sys.executable, "-c", SAVED.format(folder=folder)])
    left = []
    for count in range(len(events) + 1):
        target = tmp_path / f"left_{count}"
        Disk(folder, events[:count]).write(target)
        file = target / "results/model/model.json"
        left.append(file.read_text() if file.exists() else "")
    runs = [text for text, before in zip(left, [None, *left], strict=False) if text != before]
    assert runs == ["", "old " * 10_000, "new " * 20_000]


def test_a_file_that_is_not_finished_leaves_the_old_one(tmp_path: Path) -> None:
    write_text(tmp_path / "model.json", "old")

    def write_half() -> None:
        with write_atomically(tmp_path / "model.json") as temporary:
            temporary.write_text("half")
            raise AbraceError("stopped")

    with pytest.raises(AbraceError, match="stopped"):
        write_half()
    assert [path.name for path in tmp_path.iterdir()] == ["model.json"]
    assert (tmp_path / "model.json").read_text() == "old"


def test_a_folder_that_is_a_file_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "results").write_text("")
    with pytest.raises(AbraceError, match=r"cannot write .*results/model\.json: Not a directory"):
        write_text(tmp_path / "results/model.json", "{}")


def test_a_folder_is_made_with_those_above_it_and_may_have_to_be_new(tmp_path: Path) -> None:
    make_folder(tmp_path / "a/b/c", new=True)
    make_folder(tmp_path / "a/b/c")
    with pytest.raises(FileExistsError):
        make_folder(tmp_path / "a/b/c", new=True)


def test_a_folder_that_is_to_be_new_and_is_there_is_told_from_a_file(tmp_path: Path) -> None:
    make_folder(tmp_path / "bag", new=True)
    with pytest.raises(FileExistsError):
        make_folder(tmp_path / "bag", new=True)
    (tmp_path / "results").write_text("")
    with pytest.raises(FileExistsError):
        make_folder(tmp_path / "results", new=True)
    with pytest.raises(NotADirectoryError):
        make_folder(tmp_path / "results")
