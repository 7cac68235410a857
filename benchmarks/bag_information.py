# SPDX-License-Identifier: Apache-2.0
"""Time and memory for a large bag: `abrace bag info` of 1 GB, and its recovery and export.

info            `seconds` and `peak_megabytes` of the command, from start to end; the least of a few runs
rosbags         the same of `rosbags`: topics, counts, duration (it has no gaps and losses)
peak_megabytes  of each: recovery, csv export, replay (its messages, without publishing them)

python benchmarks/bag_information.py
"""

from __future__ import annotations

import base64
import json
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from claims import Claim

SIZE = 10**9
"""Bytes of the bag."""
PAYLOAD = 1000
"""Characters of noise in a message; three quarters of them remain in a compressed chunk."""
TOPICS = ("/response", "/brace_command", "/ground_motion")
RATE = 500.0
REPEATS = 3
HEADER = "std_msgs/Header header\nuint64 sequence\nstring content\n"
NESTED = (
    "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n",
    "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n",
)
PEAK = """
import sys; from pathlib import Path
(line,) = (one for one in Path("/proc/self/status").read_text().splitlines() if one.startswith("VmHWM"))
print(line.split()[1], file=sys.stderr)
"""
OURS = "import sys; from abrace.cli import main; main(['bag', 'info', sys.argv[1]])"
ROSBAGS = """
import sys; from pathlib import Path; from rosbags.rosbag2 import Reader
with Reader(Path(sys.argv[1])) as reader:
    for name, topic in reader.topics.items():
        print(name, topic.msgtype, topic.msgcount, reader.duration)
"""
LONG = {
    "recover": "import sys; from abrace_bags import recover; recover(sys.argv[1], sys.argv[1] + '_whole')",
    "csv": "import sys; from abrace.cli import main; "
    "main(['bag', 'csv', sys.argv[1], 'response', '--output', sys.argv[1] + '.csv'])",
    "replay": "import sys; from abrace_bags.playback import BagPlayback, bag_to_replay\n"
    "playback = BagPlayback(bag_to_replay(sys.argv[1], list(sys.argv[2:]), 0.0, 0.0), 1.0, False)\n"
    "while not playback.ended: playback.next_message()",
}


def write_bag(directory: Path, size: int) -> None:
    """A bag of about `size` bytes: three numbered topics at 500 Hz, of noise."""
    from abrace_bags import BagWriter

    definition = ("\n" + "=" * 80 + "\n").join((HEADER, *NESTED))
    source = np.random.default_rng(6)
    with BagWriter(directory, {"rig": "noise"}) as bag:
        topics = [bag.add_topic(name, "bench_msgs/msg/Numbered", definition, "") for name in TOPICS]
        for k in range(round(size / (0.79 * PAYLOAD * len(topics)))):
            at = round(k * 1e9 / RATE)
            head = struct.pack("<4siII4sQI", b"\0\1\0\0", *divmod(at, 10**9), 4, b"rig\0", k, PAYLOAD + 1)
            for topic in topics:
                text = base64.b64encode(source.bytes(PAYLOAD * 3 // 4))
                bag.write(topic, head + text + b"\0", at, at)


def measured(program: str, *arguments: str) -> tuple[float, float]:
    """Seconds and peak megabytes of a Python `program` in a process of its own."""
    begin = time.perf_counter()
    command = [sys.executable, "-c", f"{program}\n{PEAK}", *arguments]
    ran = subprocess.run(command, check=True, capture_output=True, text=True)
    return time.perf_counter() - begin, float(ran.stderr.split()[-1]) * 1024 / 1e6


def bag_information(size: int = SIZE) -> dict[str, Any]:
    """Values for verify.json."""
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        write_bag(bag, size)
        ours, rosbags = ([measured(program, str(bag)) for _ in range(REPEATS)] for program in (OURS, ROSBAGS))
        peaks = {name: measured(program, str(bag), *TOPICS)[1] for name, program in LONG.items()}
        written = sum(path.stat().st_size for path in bag.iterdir())
    return {
        "info": {
            "bytes": written,
            "seconds": min(seconds for seconds, _ in ours),
            "peak_megabytes": max(peak for _, peak in ours),
            "rosbags_seconds": min(seconds for seconds, _ in rosbags),
            "rosbags_peak_megabytes": max(peak for _, peak in rosbags),
        },
        "peak_megabytes": peaks,
    }


def information_claims(found: dict[str, Any]) -> list[Claim]:
    """What is claimed of `bag_information`."""
    info, peaks = found["info"], found["peak_megabytes"]
    seconds, peak = info["rosbags_seconds"], info["rosbags_peak_megabytes"]
    return [
        Claim("bags: info of 1 GB, s", info["seconds"], 1.0, f"rosbags {seconds:.2f}"),
        Claim("bags: info of 1 GB, peak MB", info["peak_megabytes"], 100, f"rosbags {peak:.0f}"),
        *(Claim(f"bags: {name} of 1 GB, peak MB", value, 300, "-") for name, value in peaks.items()),
    ]


if __name__ == "__main__":
    print(json.dumps(bag_information(*map(int, sys.argv[1:])), indent=1))
