# SPDX-License-Identifier: Apache-2.0
"""The loss of stiffness is found."""

import runpy
import shutil
from pathlib import Path

import pytest


def test_it_has_changed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = shutil.copytree(Path(__file__).parents[1], tmp_path / "example")
    (folder / "picture.png").unlink(missing_ok=True)
    monkeypatch.chdir(folder)
    left = runpy.run_path("has_it_changed.py")
    assert left["found"].change.changed
    assert (folder / "picture.png").stat().st_size > 10_000
