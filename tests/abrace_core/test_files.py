# SPDX-License-Identifier: Apache-2.0
"""Files written atomically: whole or not there, whatever happens."""

from __future__ import annotations

import os
import sys
import threading
from typing import TYPE_CHECKING

import pytest
from power_loss import Disk, recorded

from abrace_core import AbraceError
from abrace_core.files.writing import make_folder, write_atomically, write_text

if TYPE_CHECKING:
    from pathlib import Path

SAVED = """
from pathlib import Path
from abrace_core.files.writing import make_folder, write_text
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


def test_a_folder_that_is_to_be_new_and_is_there_is_told_from_a_file(tmp_path: Path) -> None:
    make_folder(tmp_path / "bag", new=True)
    with pytest.raises(FileExistsError):
        make_folder(tmp_path / "bag", new=True)
    (tmp_path / "results").write_text("")
    with pytest.raises(FileExistsError):
        make_folder(tmp_path / "results", new=True)
    with pytest.raises(NotADirectoryError):
        make_folder(tmp_path / "results")


def test_writers_of_one_path_at_once_all_succeed_and_leave_one_whole_text(tmp_path: Path) -> None:
    path, failed = tmp_path / "model.json", []

    def write(letter: str) -> None:
        for _ in range(50):
            try:
                write_text(path, letter * 5000)
                assert path.read_text() in {"a" * 5000, "b" * 5000, "c" * 5000}
            except (AbraceError, AssertionError) as error:
                failed.append(error)

    writers = [threading.Thread(target=write, args=(letter,)) for letter in "abc"]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert not failed
    assert [each.name for each in tmp_path.iterdir()] == ["model.json"]


def test_a_link_stays_a_link_and_a_file_keeps_its_mode(tmp_path: Path) -> None:
    (tmp_path / "shared").mkdir()
    target, link = tmp_path / "shared/calibration.yaml", tmp_path / "calibration.yaml"
    target.write_text("old")
    target.chmod(0o600)
    link.symlink_to("shared/calibration.yaml")
    write_text(link, "new")
    assert link.is_symlink()
    assert target.read_text() == "new"
    assert target.stat().st_mode & 0o777 == 0o600
    umask = os.umask(0o022)
    try:
        write_text(tmp_path / "other.yaml", "new")
    finally:
        os.umask(umask)
    assert (tmp_path / "other.yaml").stat().st_mode & 0o777 == 0o644


def test_an_error_within_the_block_is_told_as_what_it_is(tmp_path: Path) -> None:
    def write(error: OSError) -> None:
        with write_atomically(tmp_path / "report.png") as temporary:
            temporary.write_text("half")
            raise error

    with pytest.raises(AbraceError, match=r"cannot write .*report\.png: encoder error -2 when writing image file$"):
        write(OSError("encoder error -2\nwhen writing image file"))
    with pytest.raises(AbraceError, match=r"cannot write .*report\.png: /data/other\.csv: No such file or directory$"):
        write(FileNotFoundError(2, "No such file or directory", "/data/other.csv"))
    with pytest.raises(AbraceError, match=r"cannot write .*report\.png: No space left on device$"):
        write(OSError(28, "No space left on device"))
    assert not list(tmp_path.iterdir())
