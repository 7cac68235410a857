# SPDX-License-Identifier: Apache-2.0
"""The first example."""

import runpy
import shutil
from pathlib import Path

import pytest


def test_the_top_floor_moves_less(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = shutil.copytree(Path(__file__).parents[1], tmp_path / "example")
    (folder / "picture.png").unlink(missing_ok=True)
    monkeypatch.chdir(folder)
    left = runpy.run_path("five_lines.py")
    assert 0.01 < left["run"].to_pandas()["x3"].abs().max() < 0.03, "0.071 m without control"
    assert len(Path("five_lines.py").read_text().partition("import abrace")[2].strip().splitlines()) + 1 == 5
    assert (folder / "picture.png").stat().st_size > 10_000
