# SPDX-License-Identifier: Apache-2.0
"""A fragility study whose processes are killed at random: part of `make soak`.

A scheduler, two workers and the study's command run as processes of their own. Twenty times, after a random time, one
of the four gets SIGKILL and is started anew, the command as often as it needs. The files have to be those of a study
that nobody disturbed, byte for byte.

python benchmarks/fragility_endurance.py [KILLS [SEED]]
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import random
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from simulation import ONE_THREAD

KILLS, SEED = 20, 1
BUSY = (0.5, 4.0)
"""Seconds from one kill to the next."""
PATIENCE = 300.0
"""Seconds within which a further file has to be written, however slow the machine is."""
STUDY = """
import sys
from pathlib import Path
import numpy as np
from abrace_core.linear_model import LinearModel
from abrace_core.controller_file import Controller
from abrace_core.errors import AbraceError
from abrace_core.loop_extremes import Motions
from abrace_lqg.batches.missing import compute_missing
from abrace_lqg.fragility import study as module
from abrace_lqg.fragility.loops import compute_batch
from abrace_plant.rig.file import load_rig

module.BATCH_STEPS = 4_000_000
rig = load_rig(sys.argv[3])
law = LinearModel([[0.998]], [[0.002]], [[-3.0e4]], [[0.0]], ("a1",), ("U",), 0.002)
controller = Controller("damper", law, np.zeros((1, 1)), np.zeros((1, 2)), np.array([8000.0]), "", "", "")
motions = Motions.of(np.random.default_rng(seed).standard_normal(20_000) / 4 for seed in range(10))
study = module.FragilityStudy(
    (rig.model,) * 6000, (controller,), (module.Fault("a1", 0.0),), motions, tuple("0123456789"), (1.0, 6.0), (), 0.002
)
try:
    compute_missing(compute_batch, study, study.batches(), sys.argv[1], scheduler=sys.argv[2], workers=2)
except AbraceError as error:
    sys.exit(f"{error}")
"""


class Laboratory:
    """A scheduler, two workers, and the study's command; each is started when it is not running."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self.starts: dict[str, int] = {}

    def keep(self) -> bool:
        """Start what is not running; whether the command has done all its work."""
        if (command := self._running.get("command")) is not None and command.poll() == 0:
            return True
        port = self.address.rpartition(":")[2]
        dask = [sys.executable, "-m"]
        scheduler = ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard"]
        worker = ["distributed.cli.dask_worker", self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
        worker += ["--local-directory", str(self._folder), "--death-timeout", "5"]
        rig = Path(__file__).resolve().parents[1] / "src/abrace_plant/config/ncree_three_storey.yaml"
        self._keep("scheduler", [*dask, *scheduler])
        for name in ("worker 1", "worker 2"):
            self._keep(name, [*dask, *worker])
        self._keep("command", [sys.executable, "-c", STUDY, str(self._folder / "loops"), self.address, str(rig)])
        return False

    def kill(self, name: str) -> None:
        """Kill one of them without warning."""
        self._running[name].kill()
        self._running[name].wait()

    def end(self) -> None:
        """Kill all of them."""
        for process in self._running.values():
            process.kill()
            process.wait()

    def _keep(self, name: str, command: list[str]) -> None:
        process = self._running.get(name)
        if process is None or process.poll() is not None:
            self.starts[name] = self.starts.get(name, 0) + 1
            with (self._folder / f"{name}.log").open("ab") as log:
                self._running[name] = subprocess.Popen(command, env=os.environ | ONE_THREAD, stdout=log, stderr=log)


def run(kills: int, seed: int, folder: Path) -> dict[str, Any]:
    """The study with so many kills; checksums of its files, and how often each process was started."""
    chance = random.Random(seed)
    laboratory = Laboratory(folder)
    killed: list[str] = []
    done, due = False, time.monotonic() + chance.uniform(*BUSY)
    written, limit = 0, time.monotonic() + PATIENCE
    try:
        while not done:
            done = laboratory.keep()
            if len(killed) < kills and not done and time.monotonic() > due:
                name = chance.choice(["worker 1", "worker 2", "scheduler", "command"])
                laboratory.kill(name)
                killed.append(name)
                due = time.monotonic() + chance.uniform(*BUSY)
            if (count := len(list((folder / "loops").glob("part-*")))) > written:
                written, limit = count, time.monotonic() + PATIENCE
            if time.monotonic() > limit:
                raise TimeoutError(f"no file within {PATIENCE:g} s after {written}: {killed}, {laboratory.starts}")
            time.sleep(0.05)
    finally:
        laboratory.end()
    if len(killed) < kills:
        raise RuntimeError(f"the study was over after {len(killed)} kills, expected {kills}: a longer one is needed")
    files = sorted((folder / "loops").iterdir())
    sums = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files if path.suffix == ".parquet"}
    return {"files": sums, "killed": killed, "starts": laboratory.starts}


def fragility_endurance(kills: int = KILLS, seed: int = SEED) -> dict[str, Any]:
    """For soak.json: kills, and files that are not those of an undisturbed study."""
    with contextlib.ExitStack() as stack:
        undisturbed, disturbed = (Path(stack.enter_context(tempfile.TemporaryDirectory())) for _ in range(2))
        expected = run(0, seed, undisturbed)["files"]
        found = run(kills, seed, disturbed)
    names = {*expected, *found["files"]}
    differing = sorted(name for name in names if expected.get(name) != found["files"].get(name))
    if differing:
        print("differing:", *differing, file=sys.stderr)
    return {
        "files": len(expected),
        "kills": {name: found["killed"].count(name) for name in sorted(set(found["killed"]))},
        "starts": found["starts"],
        "differing": len(differing),
    }


if __name__ == "__main__":
    print(json.dumps(fragility_endurance(*map(int, sys.argv[1:])), indent=1))
