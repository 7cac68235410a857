# SPDX-License-Identifier: Apache-2.0
"""The interlocks of the paper's rig: their utilisation in tests that must not trip them, and the faults that trip them.

tests       by test, the utilisation of each interlock: its greatest value over its limit; and the trips, none
causes      by planted cause: the interlock that acted, after how long [ms], the greatest drift until then and after [m]
planted     by interlock: the message of the rig and the time to the trip [ms] with the fault that is to trip this one
            before any other, and whether it did and nothing tripped without the fault
check_us    the processor's time for one check [us], by rig

python benchmarks/interlock_margins.py    prints the tables; `make verify` has them too
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from claims import Claim, claim_table
from planted_causes import PLANTED, tripped
from rehearsal import (
    Array,
    Cause,
    Outcome,
    command_noise,
    controller,
    earthquake,
    el_centro,
    harmonic,
    pulse,
    rehearse,
    table_noise,
)

from abrace.report.table import Table
from abrace_core.files.installed import find_file
from abrace_lqg.weights import load_weights
from abrace_plant.rig.file import load_rig
from abrace_plant.rig.interlocks import Interlocks
from abrace_plant.rig.limits import INTERLOCKS
from abrace_plant.rig.sensors import FAULTS, Measurement

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from planted_causes import Tripped

    from abrace_core.model.controller_file import Controller
    from abrace_lqg.weights import Weights
    from abrace_plant.rig.model import Rig

RIGS = ("ncree_three_storey", "five_storey", "ten_storey", "single_storey")
CONTROLLERS = ("lqg1", "lqg2", "lqg3", "lqg4", "lqg5")
START = 3.0
"""Second of El Centro at which a cause is planted."""
UNSTABLE_GAIN = 4.0
"""Of LQG3's gain margin it is 1.5: the loop is unstable with the local mode at 9 Hz."""
SECONDS_OF_NOISE = 240.0


def verify_interlocks() -> tuple[dict[str, Any], list[Claim], list[Table]]:
    """Values for verify.json, claims, and the tables."""
    rig = load_rig(find_file(RIGS[0], "abrace_plant", "config", ".yaml", "rig"))
    weights = {name: load_weights(find_file(name, "abrace_lqg", "config", ".yaml", "weights")) for name in CONTROLLERS}
    tests = {name: rehearse(rig, *given) for name, given in _tests(rig, weights)}
    tests |= dict(_other_rigs(rig))
    causes = {name: (start, outcome) for name, start, outcome in _causes(rig, weights["lqg3"])}
    values: dict[str, Any] = {
        "tests": {name: {"trip": str(one.trip or ""), **one.utilisation} for name, one in tests.items()},
        "causes": {name: _cause(start, one) for name, (start, one) in causes.items()},
        "planted": {name: _planted(tripped(rig, name)) for name in PLANTED},
        "check_us": {name: check_time(name) for name in RIGS},
    }
    acted = [one for one in values["causes"].values() if one["interlock"]]
    faults = [found["ms"] for name, found in values["causes"].items() if name.partition("=")[2] in FAULTS]
    wrong_sign = values["causes"]["law with the wrong sign"]
    warned = f"only warned of: {_only_warned_of(rig, weights['lqg3']):.3f}"
    claims = [
        Claim("interlocks: trips in the paper's tests", sum(one.trip is not None for one in tests.values()), 0, "-"),
        Claim("interlocks: greatest utilisation there", max(_shares(tests, "force")), 0.9, "-"),
        Claim("interlocks: the same of the force, cut at 0.93", max(_shares(tests)), 0.95, "-"),
        Claim("interlocks: planted causes that tripped", len(acted), len(causes), f"{len(causes)}", least=True),
        Claim("interlocks: slowest of the sensor faults, ms", max(faults), 100, "-"),
        Claim("interlocks: wrong sign, greatest drift, m", wrong_sign["greatest_drift"], 0.045, warned),
        Claim("interlocks: a check, us, the paper's rig", values["check_us"][RIGS[0]], 15, "-"),
    ]
    return values, claims, [margin_table(tests), cause_table(values["causes"]), planted_table(values["planted"])]


def _shares(tests: dict[str, Outcome], without: str = "") -> list[float]:
    """Every utilisation, but for that of the interlock `without`: commands are cut at 0.93 of the force's limit."""
    return [share for one in tests.values() for name, share in one.utilisation.items() if name != without]


def _tests(
    rig: Rig, weights: dict[str, Weights]
) -> Iterator[tuple[str, tuple[Array, Array | None, Controller | None]]]:
    """The paper's tests: name, motion of the table, excitation, law."""
    rate = rig.sample_rate
    laws = {name: controller(rig, one) for name, one in weights.items()}
    first = 7.363
    white = table_noise(rate, SECONDS_OF_NOISE, 0.25, 1)
    force = command_noise(rate, SECONDS_OF_NOISE, 1800.0, 2)
    yield "white noise, table", (white, None, None)
    yield "white noise, command", (0 * force, force, None)
    yield "white noise, both", (white, force, None)
    motions = {
        "El Centro": el_centro(rate),
        "pulse of 1 s": pulse(rate),
        "earthquake-like noise": earthquake(rate),
        "weak white noise": table_noise(rate, 60.0, 0.12, 11),
    }
    for motion, ground in motions.items():
        yield f"{motion}, zero command", (ground, None, None)
        for name, law in laws.items():
            yield f"{motion}, {name}", (ground, None, law)
    yield "harmonic at mode 1, zero command", (harmonic(rate, first, 0.08), None, None)
    yield "harmonic at mode 1, lqg3", (harmonic(rate, first, 0.4), None, laws["lqg3"])
    yield "harmonic at mode 2, lqg3", (harmonic(rate, 22.93, 0.98), None, laws["lqg3"])


def _other_rigs(rig: Rig) -> Iterator[tuple[str, Outcome]]:
    """Three tests of the paper's `rig` without the key `interlocks`, of it at 1 kHz, and of the other rigs."""
    others = {
        "no key": replace(rig, interlocks={}),
        "1 kHz": replace(rig, sample_rate=1000.0),
        **{name: load_rig(find_file(name, "abrace_plant", "config", ".yaml", "rig")) for name in RIGS[1:]},
    }
    for name, other in others.items():
        rate = other.sample_rate
        white = table_noise(rate, 60.0, 0.25, 1)
        yield f"{name}: table", rehearse(other, white)
        yield f"{name}: command", rehearse(other, 0 * white, command_noise(rate, 60.0, 0.073 * other.capacity.max(), 2))
        yield f"{name}: El Centro", rehearse(other, el_centro(rate))


def _causes(rig: Rig, weights: Weights) -> Iterator[tuple[str, float, Outcome]]:
    """Planted causes in El Centro with LQG3: name, the second from which on something is wrong, what happened."""
    names = rig.channel_names
    law, ground = controller(rig, weights), el_centro(rig.sample_rate, 15.0)
    rest = np.zeros(round(15 * rig.sample_rate))
    yield "law with the wrong sign", 0.0, rehearse(rig, ground, law=controller(rig, weights, -1.0))
    yield "law with the wrong sign, at rest", 0.0, rehearse(rig, rest, law=controller(rig, weights, -1.0))
    unstable = controller(rig, weights, UNSTABLE_GAIN)
    yield f"law times {UNSTABLE_GAIN:g}, unstable", 0.0, rehearse(rig, ground, law=unstable)
    yield f"law times {UNSTABLE_GAIN:g}, at rest", 0.0, rehearse(rig, rest, law=unstable)
    yield "table runs away with 1 m/s^2", START, rehearse(rig, ground, law=law, cause=Cause(START, table=1.0))
    for name in names:
        for kind in FAULTS:
            yield f"{name}={kind}", START, rehearse(rig, ground, law=law, cause=Cause(START, f"{name}={kind}"))
    tampered = {
        "accelerometers a1 and a3 swapped": _swapped(names.index("a1"), names.index("a3")),
        "accelerometers a2 and a3 swapped": _swapped(names.index("a2"), names.index("a3")),
        "displacements x1 and x2 swapped": _swapped(names.index("x1"), names.index("x2")),
        **{
            f"{name} turned around": _scaled(names.index(name), -1.0)
            for name in ("x1", "xf", "a1", "a2", "a3", "fa", "w")
        },
        **{f"{name} reads half": _scaled(names.index(name), 0.5) for name in ("x1", "xf", "a1", "a3", "fa")},
        "fb has lost its zero, 8 kN": _shifted(names.index("fb"), 8000.0),
    }
    for name, tamper in tampered.items():
        yield name, START, rehearse(rig, ground, law=law, cause=Cause(START, tamper=tamper))


def _only_warned_of(rig: Rig, weights: Weights) -> float:
    """The greatest drift [m] of the law with the wrong sign where nothing stops it."""
    unstopped = {name: replace(limit, action="warn") for name, limit in rig.interlocks.items()}
    law = controller(rig, weights, -1.0)
    return rehearse(replace(rig, interlocks=unstopped), el_centro(rig.sample_rate, 15.0), law=law).greatest_drift


def _swapped(one: int, other: int) -> Callable[[Array], None]:
    def tamper(reading: Array) -> None:
        reading[[one, other]] = reading[[other, one]]

    return tamper


def _scaled(place: int, factor: float) -> Callable[[Array], None]:
    def tamper(reading: Array) -> None:
        reading[place] *= factor

    return tamper


def _shifted(place: int, by: float) -> Callable[[Array], None]:
    def tamper(reading: Array) -> None:
        reading[place] += by

    return tamper


def _cause(start: float, outcome: Outcome) -> dict[str, Any]:
    if outcome.trip is None:
        return {"interlock": "", "message": "", "ms": float("inf"), "drift": 0.0, "greatest_drift": 0.0}
    return {
        "interlock": outcome.trip.interlock,
        "message": str(outcome.trip),
        "ms": 1e3 * (outcome.time - start),
        "drift": outcome.drift,
        "greatest_drift": outcome.greatest_drift,
    }


def _planted(found: Tripped) -> dict[str, Any]:
    return {"message": found.message, "ms": 1e3 * found.seconds, "alone": found.alone}


def interlocks_tripped() -> dict[str, int]:
    """How many interlocks the paper's rig has, and how many of them were tripped by their planted cause alone."""
    rig = load_rig(find_file(RIGS[0], "abrace_plant", "config", ".yaml", "rig"))
    alone = sum(tripped(rig, name).alone for name in rig.interlocks)
    return {"interlocks": len(rig.interlocks), "interlocks_tripped": alone}


def check_time(name: str) -> float:
    """Best of 30 blocks of 500 checks of the rig `name` at rest, for one check, of the processor's time [us]."""
    rig = load_rig(find_file(name, "abrace_plant", "config", ".yaml", "rig"))
    interlocks, channels = Interlocks(rig), rig.channel_sensors
    readings = list(Measurement(channels, 1, 0.002).record(np.zeros((500, len(channels)))))
    command, times = [0.0] * rig.groups, []
    for _ in range(30):
        begin = time.thread_time()
        for reading in readings:
            interlocks.check(reading, command, 0.0, 0.0, 0)
        times.append((time.thread_time() - begin) / len(readings))
    return 1e6 * min(times)


def margin_table(tests: dict[str, Outcome]) -> Table:
    """By interlock, the greatest utilisation of all tests, which test it was, and by kind of test."""
    kinds = {
        "white noise": [name for name in tests if name.startswith("white")],
        "zero command": [name for name in tests if name.endswith("zero command")],
        "LQG1 to LQG5": [name for name in tests if "lqg" in name],
        "other rigs": [name for name in tests if ": " in name],
    }
    rows = []
    for interlock in INTERLOCKS:
        shares = {name: outcome.utilisation[interlock] for name, outcome in tests.items()}
        nearest = max(shares, key=lambda name: shares[name])
        by_kind = (f"{max(shares[name] for name in names):.2f}" for names in kinds.values())
        rows.append((interlock, *by_kind, nearest if shares[nearest] else "-"))
    seconds = f"{len(tests)} tests"
    return Table(f"Interlocks: greatest value over limit, {seconds}", ("", *kinds, "nearest in"), tuple(rows))


def cause_table(causes: dict[str, Any]) -> Table:
    """What tripped first, and when."""
    rows = tuple(
        (
            name,
            found["interlock"] or "NONE",
            f"{found['ms']:.0f}",
            f"{1e3 * found['drift']:.1f}",
            f"{1e3 * found['greatest_drift']:.1f}",
        )
        for name, found in causes.items()
    )
    header = ("cause", "interlock", "after ms", "drift until then mm", "greatest mm")
    return Table("Interlocks: what trips them, in El Centro at 0.1 g with LQG3", header, rows)


def planted_table(planted: dict[str, Any]) -> Table:
    """By interlock the fault that trips it, and the rig's message."""
    rows = tuple(
        (
            name,
            PLANTED[name].name,
            found["message"] or "NOTHING",
            f"{found['ms']:.0f}",
            "" if found["alone"] else "NOT ALONE",
        )
        for name, found in planted.items()
    )
    return Table("Interlocks: each one tripped by its own fault", ("", "fault", "message", "after ms", ""), rows)


def main() -> None:
    """Measure and print."""
    values, claims, tables = verify_interlocks()
    print("\n\n".join(table.text() for table in (claim_table(claims), *tables)))
    print(values["check_us"])


if __name__ == "__main__":
    main()
