# SPDX-License-Identifier: Apache-2.0
"""Endurance of the UDP device: malformed packets at 10 kHz from the target's own address while the loop runs at 500 Hz.

The target is a process of its own. Its samples can be identified by their values, so that no wrong one passes
unnoticed.

python benchmarks/bridge_endurance.py [malformed packets]
"""

from __future__ import annotations

import json
import multiprocessing
import random
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from udp_target import KINDS, PERIOD, UdpTarget, device_file, malformed, values_of

from abrace_plant.devices.device import DeviceError, Wanted
from abrace_plant.devices.udp import UdpFile

if TYPE_CHECKING:
    from multiprocessing.synchronize import Event

MALFORMED = 100_000
MALFORMED_RATE = 10_000
"""Packets per second."""
TIMEOUT = UdpFile.model_fields["timeout"].default
"""Of a device file that names none [s]."""


def flood(path: Path, packets: int, stopped: Event) -> None:
    """Be the target: samples at its ticks, from the 500th on malformed packets between them until there are enough."""
    chance = random.Random(1)
    with UdpTarget(path) as target:
        target.counter = 0
        begin, sent = time.monotonic_ns(), 0
        while not stopped.is_set():
            now = time.monotonic_ns() - begin
            if now >= (target.counter + 1) * PERIOD:
                target.tick()
            elif sent < packets and now >= 500 * PERIOD + sent * 1e9 / MALFORMED_RATE:
                content = chance.randbytes(chance.randrange(200))
                target.send(malformed(target, chance.choice(KINDS), chance.randrange(2**31), content))
                sent += 1
            else:
                time.sleep(5e-5)


def bridge_endurance(packets: int = MALFORMED, timeout: float = TIMEOUT) -> dict[str, Any]:
    """Counts of `packets` malformed ones, of wrong and missed samples; for verify.json.

    A missed sample is a valid one that was not used: the device did not recognize it, or it was older than the
    `timeout` [s] when this process, on a busy machine, came to read it. `errors` are exchanges that timed out.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = device_file(Path(folder), timeout=timeout)
        stopped = multiprocessing.Event()
        target = multiprocessing.Process(target=flood, args=(path, packets, stopped))
        device = UdpTarget.device_of(path)
        target.start()
        try:
            device.open()
            first = round(device.exchange([0.0], 0.0, Wanted.FOLLOW, 1).values[0])
            at_first, last = device.samples, first
            wrong = errors = 0
            worst, follows = 0.0, True
            while sum(device.dropped.values()) < packets and last - first < 2 * packets:
                begun = time.perf_counter()
                try:
                    reading = device.exchange([0.0], 0.0, Wanted.FOLLOW, 1)
                except DeviceError:
                    errors += 1
                    follows = False  # it takes the next samples, whatever their counter is
                    continue
                worst = max(worst, time.perf_counter() - begun)
                counter = round(reading.values[0])
                wrong += reading.values.tolist() != values_of(counter)
                wrong += follows and counter != last + 1 + reading.missed
                last, follows = counter, True
            missed = last - first - (device.samples - at_first)
        finally:
            stopped.set()
            target.join()
            device.close()
    return {
        "malformed_packets": sum(device.dropped.values()),
        "wrong_samples": wrong,
        "missed_samples": missed,
        "samples": last - first,
        "errors": errors,
        "worst_exchange_ms": 1e3 * worst,
        "dropped": dict(device.dropped),
    }


if __name__ == "__main__":
    print(json.dumps(bridge_endurance(int(sys.argv[1]) if len(sys.argv) > 1 else MALFORMED), indent=1))
