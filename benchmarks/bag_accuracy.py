# SPDX-License-Identifier: Apache-2.0
"""What is left of a bag after the worst cases: killed loggers, power losses, files cut off or damaged.

kills, opened       loggers killed at random moments, and bags of theirs that could be read
missing             messages that those bags lack before their end
worst_gap_seconds   from a bag's last message to the kill, the worst topic of all
power_loss          `runs`, random moments at which the power is lost; `opened`, those after which the bag can be read;
                    `worst_missing_seconds`, from the first message that a bag lacks to that moment

conformance         `files` in every form that MCAP's specification leaves open, and those that are read `right`
bag_cuts            of the logger's bag in every compression, as `bag_damage.py` has them
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from bag_damage import damage, packed_as
from claims import Claim
from isolation import isolated
from logger_endurance import NUMBERED, RATE, kills, logger_command, power_losses, publishers, running, stop
from mcap.writer import CompressionType
from mcap_variants import inputs, misread, variant, variants

from abrace_core.files.progress import Progress

KILLS = 50
POWER_LOSSES = 50
DAMAGED_BAG = 2.0
"""Seconds that the bag lasts which is cut off and damaged."""


def verify_bags() -> tuple[dict[str, Any], list[Claim]]:
    """Values for verify.json, and claims."""
    progress = Progress(2)
    with isolated():
        with progress.step("loggers killed") as shown:
            values = kills(KILLS, shown=shown)
        with progress.step("power lost") as shown:
            values["power_loss"] = power_losses(POWER_LOSSES, shown=shown)
    claims = [
        Claim("bags: killed loggers whose bag opens", values["opened"], KILLS, f"{KILLS} killed", least=True),
        Claim("bags: messages missing before a bag's end", values["missing"], 0, "-"),
        Claim("bags: from a bag's end to the kill, s", values["worst_gap_seconds"], 0.2, "-"),
        *power_loss_claims(values["power_loss"]),
    ]
    return values, claims


def power_loss_claims(found: dict[str, Any]) -> list[Claim]:
    """What is claimed of `power_losses`."""
    runs = f"{found['runs']} moments"
    return [
        Claim("bags: bag opens after a power loss", found["opened"], found["runs"], runs, least=True),
        Claim("bags: missing after a power loss, s", found["worst_missing_seconds"], 1.0, "-"),
    ]


def verify_conformance() -> tuple[dict[str, int], list[Claim]]:
    """Values for verify.json, and claims."""
    found = {"files": 0, "right": 0}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "form.mcap"
        for name, records in inputs().items():
            for features in variants(records):
                path.write_bytes(variant(records, features))
                found["files"] += 1
                found["right"] += not misread(path, records, Path(folder) / "-".join((name, *features)))
    return found, [Claim("MCAP's forms read right", found["right"], found["files"], "416 files", least=True)]


def verify_cuts() -> tuple[dict[str, Any], list[Claim]]:
    """Values for verify.json, and claims."""
    progress = Progress(4)
    with isolated():
        with progress.step("a bag is recorded"):
            bags = [recorded_bag(Path("bag"))]
        bags += [packed_as(bags[0], one) for one in (CompressionType.LZ4, CompressionType.NONE)]
        found = []
        for bag in bags:
            with progress.step("damaged files read") as shown:
                found.append(damage(bag, shown=shown))
    values: dict[str, Any] = {name: sum(one[name] for one in found) for name in found[0]}
    values["read_fraction"] = min(one["read_fraction"] for one in found)
    files = f"{values['cuts']} files"
    return values, [
        Claim("bags: damaged files of which all is given", values["recovered"], values["cuts"], files, least=True),
        Claim("bags: tracebacks in damaged files", values["tracebacks"], 0, files),
        Claim("bags: wrong values in damaged files", values["wrong_values"], 0, "-"),
        Claim("bags: missing and not reported, topics", values["unreported"], 0, "-"),
        Claim("bags: read of what is whole", values["read_fraction"], 1.0, "-", least=True),
    ]


def recorded_bag(bag: Path) -> Path:
    """A short bag of three topics at 500 Hz, as the logger writes it."""
    topics = list(NUMBERED)
    with publishers() as (rig, folder):
        log = folder / "logger.log"
        with running(logger_command(rig.namespace, bag.absolute(), topics), log) as process:
            rig.wait_for_match(topics)
            rig.publish(RATE, DAMAGED_BAG, topics)
            stop(process, log)
    return bag
