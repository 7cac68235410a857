# SPDX-License-Identifier: Apache-2.0
"""A record of one's own."""

import runpy
import shutil
from pathlib import Path

import pytest


def test_it_is_played_after_treatment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = shutil.copytree(Path(__file__).parents[1], tmp_path / "example")
    (folder / "picture.png").unlink(missing_ok=True)
    monkeypatch.chdir(folder)
    left = runpy.run_path("own_record.py")
    assert abs(left["run"].to_pandas()["w"]).max() == pytest.approx(0.5, abs=0.02)
    assert (folder / "picture.png").stat().st_size > 10_000
