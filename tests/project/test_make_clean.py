# SPDX-License-Identifier: Apache-2.0
"""`make clean` removes what `make setup` built, and nothing that a person made."""

import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]
BUILT = [".venv/bin/python", ".sourced/.made", "ros2_ws/build/x", "ros2_ws/install/.built", "ros2_ws/log/x"]
MADE = [
    "results/my_day/summary.json",
    "results/demo/report.html",
    "bags/first/first.mcap",
    "my_rig.yaml",
    "src/my_law/my_law.py",
    "ros2_ws/my_notes.txt",
    "quake.csv",
]


def test_make_clean_leaves_what_a_person_made(tmp_path):
    shutil.copy(ROOT / "Makefile", tmp_path)
    for name in (*BUILT, *MADE):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    subprocess.run(["make", "clean"], cwd=tmp_path, check=True, capture_output=True, timeout=60)
    assert [name for name in MADE if not (tmp_path / name).exists()] == []
    assert [name for name in BUILT if (tmp_path / name).exists()] == []
