# SPDX-License-Identifier: Apache-2.0
"""The origin of a campaign's results, origin.json: campaign file, command, and versions."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shlex
from datetime import UTC, datetime
from importlib.metadata import version
from typing import TYPE_CHECKING

from abrace_core.files import write_text

if TYPE_CHECKING:
    from pathlib import Path

PACKAGES = ("abrace", "numpy", "scipy", "numba", "matplotlib", "pydantic", "mcap")
"""Packages whose versions are written."""


def write_origin(results: Path, campaign_file: Path) -> None:
    """Write origin.json into the folder of `results`, before the campaign of `campaign_file` runs."""
    content = campaign_file.read_bytes()
    middleware = os.environ.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")
    origin = {
        "command": f"abrace campaign {shlex.quote(str(campaign_file))}",
        "begun": datetime.now(UTC).isoformat(timespec="seconds"),
        "campaign_file": {
            "path": str(campaign_file),
            "sha256": hashlib.sha256(content).hexdigest(),
            "text": content.decode(),
        },
        "versions": {
            "python": platform.python_version(),
            **{name: version(name) for name in PACKAGES},
            "middleware": middleware,
            "system": platform.platform(),
        },
    }
    write_text(results / "origin.json", json.dumps(origin, indent=1))
