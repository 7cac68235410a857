# SPDX-License-Identifier: Apache-2.0
"""What is left of a bag after the worst cases: killed loggers, power losses, files cut off or damaged.

kills, opened       loggers killed at random moments, and bags of theirs that could be read
missing             messages that those bags lack before their end
worst_gap_seconds   from a bag's last message to the kill, the worst topic of all
info                seconds and peak megabytes of `abrace bag info` of 1 GB, as `bag_information.py` has them
power_loss          `runs`, random moments at which the power is lost; `opened`, those after which the bag can be read;
                    `worst_missing_seconds`, from the first message that a bag lacks to that moment
damaged_files, tracebacks, wrong_values, unreported, least_read, read_fraction   as `bag_damage.py` has them
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bag_damage import damage
from bag_information import bag_information, information_claims
from claims import Claim
from isolation import isolated
from logger_endurance import NUMBERED, RATE, kills, logger_command, power_losses, publishers, running, stop

from abrace_core.progress import Progress

KILLS = 50
POWER_LOSSES = 50
DAMAGED_BAG = 4.0
"""Seconds that the bag lasts which is cut off and damaged."""


def verify_bags() -> tuple[dict[str, Any], list[Claim]]:
    """Values for verify.json, and claims."""
    progress = Progress(4)
    with isolated():
        with progress.step("loggers killed") as shown:
            values = kills(KILLS, shown=shown)
        with progress.step("power lost") as shown:
            values["power_loss"] = power_losses(POWER_LOSSES, shown=shown)
        with progress.step("damaged files read") as shown:
            values |= damage(recorded_bag(Path("bag")), shown=shown)
    with progress.step("a bag of 1 GB"):
        values |= bag_information()
    claims = [
        Claim("bags: killed loggers whose bag opens", values["opened"], KILLS, f"{KILLS} killed", least=True),
        Claim("bags: messages missing before a bag's end", values["missing"], 0, "-"),
        Claim("bags: from a bag's end to the kill, s", values["worst_gap_seconds"], 0.2, "-"),
        *power_loss_claims(values["power_loss"]),
        *damage_claims(values),
        *information_claims(values),
    ]
    return values, claims


def power_loss_claims(found: dict[str, Any]) -> list[Claim]:
    """What is claimed of `power_losses`."""
    runs = f"{found['runs']} moments"
    return [
        Claim("bags: bag opens after a power loss", found["opened"], found["runs"], runs, least=True),
        Claim("bags: missing after a power loss, s", found["worst_missing_seconds"], 1.0, "-"),
    ]


def damage_claims(found: dict[str, Any]) -> list[Claim]:
    """What is claimed of `damage`."""
    return [
        Claim("bags: tracebacks in damaged files", found["tracebacks"], 0, f"{found['damaged_files']} files"),
        Claim("bags: wrong values in damaged files", found["wrong_values"], 0, "-"),
        Claim("bags: missing and not reported, topics", found["unreported"], 0, "-"),
        Claim("bags: read of what is whole", found["read_fraction"], 0.99, "-", least=True),
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
