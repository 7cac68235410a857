# SPDX-License-Identifier: Apache-2.0
"""A building of one's own."""

import runpy
import shutil
from pathlib import Path

import pytest

from abrace.campaign.plan import check_campaign


def test_the_building_is_looked_at(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = shutil.copytree(Path(__file__).parents[1], tmp_path / "example")
    (folder / "picture.png").unlink(missing_ok=True)
    monkeypatch.chdir(folder)
    left = runpy.run_path("look.py")
    assert left["rig"].to_pandas()["frequency [Hz]"].iloc[0] == pytest.approx(1.81, abs=0.01)
    assert check_campaign(folder / "campaign.yaml").text()
    assert (folder / "picture.png").stat().st_size > 10_000
