# SPDX-License-Identifier: Apache-2.0
"""Claims about the bridge: a flooded UDP device, and the demo in real time through emulator and bridge."""

from __future__ import annotations

from typing import Any

from bridge_demo import bridge_demo
from bridge_endurance import bridge_endurance
from claims import Claim
from isolation import isolated
from timing import QUANTILES

from abrace.report.table import Table

DEMO_SECONDS, FAST_SECONDS, FAST_RATE = 160.0, 30.0, 1000.0
"""Of the demo at the paper's rate, and of that at 1 kHz [Hz], for which nothing is claimed: it needs more than two
processors."""


def verify_bridge() -> tuple[dict[str, Any], list[Claim], list[Table]]:
    """Values for verify.json, claims, and the times of the demo."""
    values = bridge_endurance()
    with isolated():
        demo, fast = bridge_demo(DEMO_SECONDS), bridge_demo(FAST_SECONDS, FAST_RATE)
    claims = [
        Claim("bridge: malformed packets", values["malformed_packets"], 100_000, "at 10 kHz", least=True),
        Claim("bridge: wrong samples", values["wrong_samples"], 0, "-"),
        Claim("bridge: missed samples", values["missed_samples"], 0, "-"),
        Claim("bridge: exchanges that timed out", values["errors"], 0, "-"),
        Claim("bridge: faults in the demo", int(bool(demo["fault"])), 0, demo["fault"] or "-"),
        Claim("bridge: samples lost in the demo", demo["lost_samples"], 0, f"{DEMO_SECONDS:g} s"),
    ]
    tables = [timing_table(f"{DEMO_SECONDS:g} s at 500 Hz", demo), timing_table(f"{FAST_SECONDS:g} s at 1 kHz", fast)]
    return {**values, "demo": demo, "demo_1_khz": fast}, claims, tables


def timing_table(name: str, demo: dict[str, Any]) -> Table:
    """The answers' times beside those of samples, of a bare timer and of a bare echo."""
    parts = {"sample to command": demo, **{part: demo[part] for part in ("intervals", "timer", "echo")}}
    rows = tuple((part, *(f"{found[quantile]:.0f}" for quantile in QUANTILES)) for part, found in parts.items())
    answers = f"{demo['answers']} answers, {demo['missed_deadlines']} after their deadline"
    ended = f"ended by a fault: {demo['fault']}" if demo["fault"] else "no fault"
    header = ("us", *(quantile.removesuffix("_us") for quantile in QUANTILES))
    return Table(
        f"The demo through emulator and bridge, {name}",
        header,
        rows,
        (f"{answers}; {demo['lost_samples']} samples lost; {ended}",),
    )
