# SPDX-License-Identifier: Apache-2.0
"""What a new user reaches from the tutorials alone: each is followed, line by line, in an empty folder."""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path
from typing import Any

from claims import Claim
from tutorials import follow

TOGETHER = (("ten_minutes", "paper"), ("first_building",), ("own_record",), ("own_device",))
"""Tutorials that are followed in one folder: what one has made, the next one uses."""
ONCE = "abrace demo"
NEEDS_A_PACKAGE = "abrace run abrace_plant sensor_bridge --ros-args -p rig:=ncree_three_storey -p device:=my_daq.yaml"
"""Names a device that only a package of the reader's own brings."""


def verify_docs() -> tuple[dict[str, Any], list[Claim]]:
    """Values for verify.json, and claims."""
    begin = time.monotonic()
    with tempfile.TemporaryDirectory() as name:
        for number, tutorials in enumerate(TOGETHER):
            folder = Path(name) / str(number)
            folder.mkdir()
            for tutorial in tutorials:
                again = [ONCE] if (folder / "results/demo").is_dir() else []
                follow(tutorial, folder, without=[*again, NEEDS_A_PACKAGE])
        seconds = time.monotonic() - begin
        results = Path(name) / "1/results/my_day"
        found = json.loads((results / "comparison/comparison.json").read_text(encoding="utf-8"))
        megabytes = 1e-6 * (results / "report.html").stat().st_size
        first_test = (Path(name) / "0/first.gif").stat().st_size
    left = {name: found["measured"][name]["rms"] / found["uncontrolled"][name]["rms"] for name in ("x5", "a5")}
    claims = [
        *(Claim(f"docs alone: rms of {name} left by the law", value, 0.5, "-") for name, value in left.items()),
        Claim("docs alone: report.html, MB", megabytes, 5.0, "-"),
    ]
    followed = [tutorial for tutorials in TOGETHER for tutorial in tutorials]
    values = {"followed": followed, "seconds": seconds, "left": left, "report_megabytes": megabytes}
    return {**values, "first_gif_bytes": first_test}, claims
