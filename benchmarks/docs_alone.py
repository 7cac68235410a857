"""What a new user reaches from docs/first_building.md alone: five storeys, a record, a law, a report."""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path
from typing import Any

from claims import Claim
from first_building import follow


def verify_docs() -> tuple[dict[str, Any], list[Claim]]:
    """Values for verify.json, and claims."""
    with tempfile.TemporaryDirectory() as folder:
        begin = time.monotonic()
        follow(Path(folder))
        seconds = time.monotonic() - begin
        results = Path(folder) / "results/my_day"
        found = json.loads((results / "comparison/comparison.json").read_text(encoding="utf-8"))
        megabytes = 1e-6 * (results / "report.html").stat().st_size
    left = {name: found["measured"][name]["rms"] / found["uncontrolled"][name]["rms"] for name in ("x5", "a5")}
    claims = [
        *(Claim(f"docs alone: rms of {name} left by the law", value, 0.5, "-") for name, value in left.items()),
        Claim("docs alone: report.html, MB", megabytes, 5.0, "-"),
    ]
    return {"seconds": seconds, "left": left, "report_megabytes": megabytes}, claims
