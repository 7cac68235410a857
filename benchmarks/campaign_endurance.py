# SPDX-License-Identifier: Apache-2.0
"""A campaign in lockstep interrupted 20 times at random moments, and one that is not: their results, byte for byte.

interrupted  times that SIGINT, SIGTERM or SIGKILL came; `campaigns` is how many ended meanwhile
compared     files of results, and recorded topics, of all of those together
different    of them (`same_results` says what is left out, and why)
left         nodes that still ran half a minute after the last one

python benchmarks/campaign_endurance.py [INTERRUPTIONS]
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from isolation import isolated
from same_results import contents

NAME = "interrupted"
INTERRUPTIONS = 20
LONGEST = 8.0
"""Seconds after which a campaign is interrupted, at most: less than it needs, and more than any of its steps."""
CAMPAIGN = f"""name: {NAME}
rig: ncree_three_storey
lockstep: true
steps:
  - name: table_noise
    test: {{duration: 60.0, ground_motion: {{record: white_noise, rms: 0.25, band: [0.1, 10.0], seed: 1}}}}
  - name: command_noise
    test: {{duration: 60.0, excitation: {{rms: 1800.0, band: [0.0, 30.0], seed: 2}}}}
  - name: model
    identify: {{table: table_noise, command: command_noise}}
  - name: lqg3
    design: {{model: model, weights: lqg3}}
  - name: shaken
    test: {{duration: 10.0, ground_motion: {{record: el_centro, peak_acceleration: 0.5}}}}
  - name: controlled
    test: {{duration: 10.0, ground_motion: {{record: el_centro, peak_acceleration: 0.5}}, controller: lqg3}}
  - name: comparison
    validate: {{test: controlled, uncontrolled: shaken, model: model, controller: lqg3}}
"""
COMMAND = ("abrace", "campaign", f"{NAME}.yaml")


def _folder(name: str) -> Path:
    folder = Path(name).resolve()
    folder.mkdir()
    (folder / f"{NAME}.yaml").write_text(CAMPAIGN, encoding="utf-8")
    return folder


def _nodes_in(folder: Path) -> int:
    """Processes that run there."""
    found = 0
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            found += entry.joinpath("cwd").readlink() == folder and int(entry.name) != os.getpid()
        except OSError:
            continue
    return found


def _interrupted(process: subprocess.Popen[bytes], moments: random.Random) -> bool:
    """Interrupt a campaign at a random moment; returns False if it ended before that."""
    try:
        process.wait(moments.uniform(0.2, LONGEST))
    except subprocess.TimeoutExpired:
        process.send_signal(moments.choice((signal.SIGINT, signal.SIGTERM, signal.SIGKILL)))
        process.wait()
        return True
    if process.returncode:
        raise SystemExit(f"the campaign ended with {process.returncode}")
    return False


def campaign_endurance(interruptions: int = INTERRUPTIONS) -> dict[str, Any]:
    """All of it; call it on a domain of one's own."""
    moments = random.Random(1)
    whole, folder = _folder("whole"), _folder("broken")
    with Path("whole.log").open("wb") as log:
        subprocess.run(COMMAND, cwd=whole, stdout=log, stderr=log, check=True)
    expected = contents(whole, NAME)
    count = campaigns = different = 0
    with Path("broken.log").open("wb") as log:
        while True:
            process = subprocess.Popen(COMMAND, cwd=folder, stdout=log, stderr=log)
            if count < interruptions and _interrupted(process, moments):
                count += 1
                continue
            if process.wait():
                said = Path("broken.log").read_text(errors="replace")[-500:]
                raise SystemExit(f"the campaign ended with {process.returncode}: {said}")
            campaigns += 1
            found = contents(folder, NAME)
            differing = [key for key in found | expected if found.get(key) != expected.get(key)]
            print(*differing, sep="\n", end="\n" * bool(differing), file=sys.stderr)
            different += len(differing)
            if count == interruptions:
                break
    deadline = time.monotonic() + 30.0
    while (left := _nodes_in(folder)) and time.monotonic() < deadline:
        time.sleep(0.1)
    compared = campaigns * len(expected)
    return {"interrupted": count, "campaigns": campaigns, "compared": compared, "different": different, "left": left}


if __name__ == "__main__":
    with isolated():
        print(json.dumps(campaign_endurance(*map(int, sys.argv[1:])), indent=1))
