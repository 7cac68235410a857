# SPDX-License-Identifier: Apache-2.0
"""Claims about the bridge: a flooded UDP device, and the demo in real time through emulator and bridge."""

from __future__ import annotations

from typing import Any

from bridge_demo import bridge_demo
from bridge_endurance import bridge_endurance
from claims import Claim

DEMO_SECONDS = 160.0


def verify_bridge() -> tuple[dict[str, Any], list[Claim]]:
    """Values for verify.json, and claims."""
    values = bridge_endurance()
    demo = bridge_demo(DEMO_SECONDS)
    claims = [
        Claim("bridge: malformed packets", values["malformed_packets"], 100_000, "at 10 kHz", least=True),
        Claim("bridge: wrong samples", values["wrong_samples"], 0, "-"),
        Claim("bridge: missed samples", values["missed_samples"], 0, "-"),
        Claim("bridge: faults in the demo", int(bool(demo["fault"])), 0, demo["fault"] or "-"),
        Claim("bridge: samples lost in the demo", demo["lost_samples"], 0, f"{DEMO_SECONDS:g} s"),
    ]
    return {**values, "demo": demo}, claims
