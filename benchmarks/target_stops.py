# SPDX-License-Identifier: Apache-2.0
"""Stops of the emulated target, cut cables, a sticking valve, in live runs over real packets; the C target itself acts.

trips, latched           times that the target stopped by itself at a random instant, with a sine, noise and LQG3 as
                         commands, and times that the rig's fault was latched within two samples of the target's
followed_again           times that it followed again before a person cleared the rig
stalled                  stops and cuts before which this computer's own delay had stopped the rig: they are tried again
worst_step_over_rate_limit   of all commands that reached the actuators
cable_cuts, cable_passed times that no packet came through for 0.15 to 0.6 s at a random instant while the table moved,
                         and times that the fault was latched, nothing was followed again, and abrace had the table
                         where it is measured when a person had cleared the rig
stuck_valve_passed       whether load cells that stay at 20 kN after a stop lead to the second stage within the ramp and
                         0.2 s, and `clear` is refused

python benchmarks/target_stops.py [TRIPS] [CUTS]
"""

from __future__ import annotations

import json
import math
import random
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from claims import Claim
from controller_speed import lqg3
from live_rig import LiveRig, forces
from udp_target import RIG

from abrace_core import AbraceError
from abrace_core.model import signals
from abrace_core.safety.rig_safety import RAMP_TIME, REST_TIME, State
from abrace_lqg.control_law import ControlLaw

if TYPE_CHECKING:
    from collections.abc import Callable

    from live_rig import Law

TRIPS, CUTS = 200, 100
RATE = RIG.sample_rate
OWN_LIMIT = "stop=64"
STOPPED = (State.RAMPING_DOWN, State.LATCHED, State.PROTECTIVE_STOP, State.NOT_AT_REST)
STALLS = ("taken late", "samples missed", "has applied no command")
"""Causes that are this computer's own."""
PLACE = 1e-3
"""Difference of abrace's place of the table from the measured one that counts as the same [m]."""


class Shake:
    """A table that moves by some centimetres, each time towards its middle from where the last stop has left it."""

    def __init__(self) -> None:
        self._first, self._sign = 0, 1.0

    def begin(self, place: float) -> None:
        """Begin anew with the next sample."""
        self._first, self._sign = -1, -math.copysign(0.3, place)

    def at(self, sequence: int) -> float:
        """0.3 m/s^2 at 0.7 Hz; it begins as a cosine does, so that it does not drift."""
        if self._first < 0:
            self._first = sequence
        return self._sign * math.cos(2 * math.pi * 0.7 * (sequence - self._first) / RATE)


def sine(shake: Shake) -> Law:
    """5 kN at 1.17 Hz, and a table that moves."""
    return lambda sequence, _: (5e3 * math.sin(2 * math.pi * 1.17 * sequence / RATE), shake.at(sequence))


def noise(shake: Shake) -> Law:
    """Forces with an rms of 4 kN, up to some 8 Hz, and a table that moves."""
    values, chance = [0.0, 0.0], random.Random(1)

    def law(sequence: int, _: list[float]) -> tuple[float, float]:
        values[0] += 0.1 * (chance.gauss(0.0, 20e3) - values[0])
        values[1] += 0.1 * (values[0] - values[1])
        return values[1], shake.at(sequence)

    return law


def controlled(shake: Shake) -> Law:
    """LQG3, and a table that moves."""
    law = ControlLaw(lqg3(), signals.response_names(RIG.floors, RIG.groups))

    def answer(sequence: int, reading: list[float]) -> tuple[float, float]:
        others = 2 * RIG.floors + RIG.groups
        force = law.update([*reading[:others], float(np.mean(reading[others:-1]))]).tolist()
        law.advance(force)
        return force[0], shake.at(sequence)

    return answer


LAWS: dict[str, Callable[[Shake], Law]] = {"sine": sine, "noise": noise, "LQG3": controlled}


class Stops:
    """Counts of what was asked for above."""

    def __init__(self) -> None:
        self.trips = self.latched = self.followed_again = self.cable_cuts = self.cable_passed = self.stalled = 0
        self.worst_step = 0.0
        self.shake = Shake()

    def stopped(self, rig: LiveRig, count: int, stalls: tuple[str, ...]) -> bool | None:
        """Wait until the target has stopped, and all is at rest; whether the fault was latched in time.

        None: the rig had stopped at sample `count` already, the last before, or then for one of these `stalls`.
        """
        rig.until(lambda: not rig.seen[-1].target.armed, "the target to stop")
        rig.until(lambda: rig.state in (State.LATCHED, State.NOT_AT_REST), "all to be at rest")
        time.sleep(0.1)
        seen = rig.since(count)
        first = next(i for i, one in enumerate(seen) if not one.target.armed)
        self.followed_again += any(one.target.armed for one in seen[first:])
        latched = next(i for i, one in enumerate(seen) if State(one.sample.head.state) in STOPPED)
        if latched < max(first, 1) or any(stall in rig.safety.cause for stall in stalls):
            self.stalled += 1
            return None
        return latched <= first + 2

    def trip(self, rig: LiveRig, chance: random.Random) -> None:
        """The target stops by itself at a random instant."""
        in_time = None
        while in_time is None:
            count = self._driven(rig, chance)
            rig.target.ask(OWN_LIMIT)
            in_time = self.stopped(rig, count, (*STALLS, "no sample for"))
        self.trips += 1
        # a computer that stood still may have stopped the target first, which then has both causes
        well = in_time and all(text in rig.safety.cause for text in ("target not following: ", "a limit of its own"))
        if not (well and self._at_zero(rig)):
            print(f"\nnot latched in time ({in_time}), or not at zero: {rig.safety.cause}", file=sys.stderr)
            return
        self.latched += 1

    def cut(self, rig: LiveRig, chance: random.Random) -> None:
        """No packet passes for a while."""
        in_time, again = None, self.followed_again
        while in_time is None:
            count = self._driven(rig, chance)
            rig.target.ask("loss=1")
            time.sleep(chance.uniform(0.15, 0.6))
            rig.target.ask("loss=0")
            in_time = self.stopped(rig, count, STALLS)
        self.cable_cuts += 1
        well = in_time and self._at_zero(rig) and again == self.followed_again
        self.cable_passed += well and self._place_is_known(rig)

    def _driven(self, rig: LiveRig, chance: random.Random) -> int:
        """Let the rig run and be driven until a random instant; the number of samples before the last one so far."""
        place = rig.seen[-1].target.table if rig.seen else 0.0
        assert place is not None
        self.shake.begin(place)
        rig.start()
        time.sleep(chance.uniform(0.1, 0.8))
        return len(rig.seen) - 1

    def _at_zero(self, rig: LiveRig) -> bool:
        """Whether no force is measured, and none is applied."""
        rig.until(lambda: not any(rig.seen[-1].target.applied), "the table to brake")
        last = rig.seen[-1]
        report = rig.target.report()
        self.worst_step = max(self.worst_step, report["worst_step_over_rate_limit"])
        return bool(np.abs(forces([last])).max() < RIG.capacity[0] / 4)

    def _place_is_known(self, rig: LiveRig) -> bool:
        """Whether abrace has the table where it is once it acts again."""
        rig.start(asks=False)
        table = rig.safety.outputs[1]
        measured = rig.seen[-1].target.table
        assert measured is not None
        return abs(table.state.displacement - measured) < PLACE  # type: ignore[attr-defined]


def strong(sequence: int, _: list[float]) -> tuple[float, float]:
    """20 kN, reached within 0.6 s, and held: a computer that stands still for a moment finds it all the same."""
    return 20e3 * math.sin(2 * math.pi * 0.4 * min(sequence / RATE, 0.625)), 0.0


def stuck_valve(rig: LiveRig) -> bool:
    """Load cells stay at the force of the moment of a stop: second stage in time, clear refused.

    Again where this computer stood still, and so stopped the rig first or was missing samples of the stop.
    """

    def pushes() -> bool:
        if rig.state is State.LATCHED:
            rig.start()
        return bool(abs(forces(rig.seen[-1:])).min() > 15e3)

    for _ in range(20):
        rig.start()
        rig.until(pushes, "a force")
        count = len(rig.seen)
        for channel in ("fa", "fb"):
            rig.target.ask(f"{channel}=stuck")
        with rig.lock:
            rig.safety.press("panel")
        rig.until(lambda: rig.state is State.NOT_AT_REST, "the second stage")
        seen = rig.since(count)
        began = next(i for i, one in enumerate(seen) if one.sample.head.state == State.RAMPING_DOWN)
        second = next(i for i, one in enumerate(seen) if one.sample.head.state == State.NOT_AT_REST)
        with rig.lock:
            rig.safety.release()
        refused = not rig.cleared()
        for channel in ("fa", "fb"):
            rig.target.ask(f"{channel}=well")
        rig.until(lambda: rig.state is State.LATCHED, "rest")
        first, last = (seen[i].sample for i in (began, second))
        if "panel" in first.cause and last.head.sequence - first.head.sequence == second - began:
            return refused and (second - began) / RATE < RAMP_TIME + REST_TIME + 0.02
    return False


def target_stops(trips: int = TRIPS, cuts: int = CUTS) -> dict[str, Any]:
    """Values for verify.json."""
    stops, chance = Stops(), random.Random(1)
    for number, (name, law) in enumerate(LAWS.items()):
        with tempfile.TemporaryDirectory() as folder:
            rig = LiveRig(Path(folder), law(stops.shake))
            try:
                for wanted, act in ((trips, stops.trip), (cuts, stops.cut)):
                    for _ in range(wanted // 3 + (number < wanted % 3)):
                        act(rig, chance)
                        print(f"\r{name}: {stops.trips} trips, {stops.cable_cuts} cuts", end="", file=sys.stderr)
            finally:
                rig.close()
    with tempfile.TemporaryDirectory() as folder:
        rig = LiveRig(Path(folder), strong)
        try:
            valve = stuck_valve(rig)
        finally:
            rig.close()
    print(file=sys.stderr)
    return {
        "trips": stops.trips,
        "latched": stops.latched,
        "followed_again": stops.followed_again,
        "stalled": stops.stalled,
        "worst_step_over_rate_limit": stops.worst_step,
        "cable_cuts": stops.cable_cuts,
        "cable_passed": stops.cable_passed,
        "stuck_valve_passed": valve,
    }


def verify_target() -> tuple[dict[str, Any], list[Claim]]:
    """Values for verify.json, and claims."""
    found = target_stops()
    return found, [
        Claim("stops of the target latched, of all", found["latched"] / found["trips"], 1.0, "-", least=True),
        Claim("followed again without a person", found["followed_again"], 0, "-"),
        Claim("step over the rate limit", found["worst_step_over_rate_limit"], 1.0, "-"),
        Claim("cut cables survived, of all", found["cable_passed"] / found["cable_cuts"], 1.0, "-", least=True),
        Claim("sticking valve found", float(found["stuck_valve_passed"]), 1.0, "-", least=True),
    ]


if __name__ == "__main__":
    try:
        print(json.dumps(target_stops(*map(int, sys.argv[1:])), indent=1))
    except AbraceError as error:
        sys.exit(f"target_stops: {error}")
