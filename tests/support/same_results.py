# SPDX-License-Identifier: Apache-2.0
"""What a campaign in lockstep leaves, byte for byte, but for what the clock or a process's number is in.

Left out, and why: timing.json, origin.json, the timing in summary.json and report.html (seconds, times, and
checksums of files with such in them; what they show is in the other files); the nodes' output (seconds); steps.json
(checksums of bags, which have diagnostics by the clock in them); of the nodes' parameters the processor that a node is
given, by the campaign's process number; of samples and commands the number of the run, which is a time. Bags are in
folders called by the time.
"""

from __future__ import annotations

import hashlib
import json
import re
from typing import TYPE_CHECKING

from abrace_bags import Bag

if TYPE_CHECKING:
    from pathlib import Path

BY_THE_CLOCK = ("timing.json", "steps.json", "origin.json", "report.html")
STREAMS = ("response", "brace_command", "ground_motion")


def contents(folder: Path, name: str) -> dict[str, str]:
    """Checksums of the results and recorded streams of the campaign `name`, which was run in a `folder`.

    By file, and by test and topic.
    """
    results = folder / "results" / name
    found = {}
    for path in sorted(results.rglob("*")):
        if path.is_file() and path.name not in BY_THE_CLOCK and path.suffix != ".log":
            found[str(path.relative_to(results))] = hashlib.sha256(_without_times(path)).hexdigest()
    for step in json.loads((results / "steps.json").read_text(encoding="utf-8"))["steps"]:
        if step["bag"] is not None:
            found |= _streams(folder / step["bag"], name)
    return found


def _without_times(path: Path) -> bytes:
    content = path.read_bytes()
    if path.name == "summary.json":
        summary = json.loads(content)
        del summary["timing"]
        return json.dumps(summary).encode()
    if path.suffix not in (".json", ".yaml"):
        return content
    text = re.sub(r"bags/(\w+)/\d{8}-\d{6}(-\d+)?", r"bags/\1", content.decode())
    if path.parent.name == "nodes":
        text = re.sub(r'"cpu_affinity": .*', "", text)
    return text.encode()


def _streams(bag: Path, name: str) -> dict[str, str]:
    found = {}
    for topic, arrays in Bag(bag).arrays().items():
        if topic not in [f"/{name}/{stream}" for stream in STREAMS]:
            continue
        digest = hashlib.sha256(arrays.log_time.tobytes())
        for field, values in sorted(arrays.fields.items()):
            if field != "run":
                digest.update(f"{field} {values.shape}".encode() + values.tobytes())
        found[f"{bag.name} {topic}"] = digest.hexdigest()
    return found
