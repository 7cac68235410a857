# SPDX-License-Identifier: Apache-2.0
"""The program `emulator`: a rig behind a device file, for tests of everything on this side of the cable; no ROS."""

from __future__ import annotations

import gc
import json
import os
import signal
import sys
from pathlib import Path

from abrace_core import AbraceError
from abrace_core.files.command_line import OneLineParser
from abrace_core.files.writing import write_text
from abrace_plant.emulator.emulator import Emulator
from abrace_plant.rig.file import load_rig


def arguments() -> OneLineParser:
    """The program's arguments."""
    parser = OneLineParser(
        prog="emulator",
        description="An emulated rig for a device file, with faults on demand.",
        example="abrace run abrace_plant emulator --rig my_rig.yaml --device my_device.yaml --fault loss=0.01",
    )
    parser.add_argument("--rig", type=Path, required=True, help="rig file; its sample_rate is that of the ticks")
    parser.add_argument("--device", type=Path, required=True, help="device file of the kind udp")
    parser.add_argument("--seed", type=int, default=0, help="seed of the sensors' noise and of random faults (0)")
    parser.add_argument("--fault", action="append", default=[], help="such as loss=0.01, a2=stuck@20 (docs/bridge.md)")
    parser.add_argument("--control", type=int, default=0, metavar="PORT", help="UDP port for faults while it runs")
    parser.add_argument("--duration", type=float, default=float("inf"), help="seconds to run (until stopped)")
    parser.add_argument("--priority", type=int, default=0, help="SCHED_FIFO priority, 1 to 99, where allowed (0: none)")
    parser.add_argument("--log", type=Path, help="JSON file of the counts, written at the end")
    return parser


def raise_priority(priority: int) -> None:
    """Be scheduled before all ordinary processes, where that is allowed."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        print(f"emulator: no priority {priority}: {error.strerror}; ticks may be late", file=sys.stderr, flush=True)


def main() -> int:
    """Entry point."""
    given = arguments().parse_args()
    stops: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda which, _: stops.append(which))
    try:
        rig = load_rig(given.rig)
        emulator = Emulator(given.device, rig, given.seed, given.fault, given.control)
        if given.priority:
            raise_priority(given.priority)
        print("emulator: ticking", flush=True)
        # the garbage collector's pauses would be late ticks
        gc.collect()
        gc.freeze()
        try:
            emulator.run(lambda: bool(stops), given.duration)
        finally:
            emulator.close()
        report = json.dumps(emulator.report(), indent=1) + "\n"
        if given.log is not None:
            write_text(given.log, report)
        print(report, end="", flush=True)
    except AbraceError as error:
        print(f"emulator: {error}", file=sys.stderr, flush=True)
        return 2
    return 0
