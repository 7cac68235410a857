# SPDX-License-Identifier: Apache-2.0
"""Simulated faults: how often validity names them, and how often it names one on the linear rig.

Every fault is simulated in tests of 120 s each on the table and with the command, 20 seeds; what varies from seed to
seed (storey, channel, unit) goes through a list. The limits of the checks (docs/identification.md)
were set on other seeds.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from claims import Claim
from laboratory import Laboratory
from simulation import ONE_THREAD

from abrace.report.table import Table
from abrace_core import AbraceError
from abrace_core.files.installed import find_file
from abrace_core.files.progress import Progress
from abrace_core.model import signals
from abrace_plant.rig import published
from abrace_plant.rig.file import load_rig
from abrace_sysid.fitting.options import IdentificationOptions
from abrace_sysid.identification import identify
from abrace_sysid.validity.judgement import judge, judge_failure

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from abrace_core.model.run import Run
    from abrace_plant.rig.model import Rig
    from abrace_sysid.validity.finding import Validity

SEEDS, FIRST_SEED = 20, 2100
"""The first is far from those that the limits were set on."""

SECONDS = 120.0
BENCH_LAG = 0.0008
"""Of the paper's bench test [s], with which the tests' is compared."""

NAMES: dict[str, str] = {
    "linear": "",
    "50 N friction": "friction",
    "0.5 mm backlash": "backlash",
    "swapped sensors": "swapped sensors",
    "dead channel": "dead channel",
    "wrong unit": "wrong unit",
    "3 ms lag": "lag",
    "mode missed": "mode missed",
    "saturated test": "saturation",
    "spikes": "spikes",
}
"""What validity should say of each fault."""

PAIRS = (
    ("x1", "x2"),
    ("a1", "a2"),
    ("x2", "x3"),
    ("a2", "a3"),
    ("x1", "x3"),
    ("a1", "a3"),
    ("xf", "f"),
    ("x1", "xf"),
    ("x2", "a2"),
)
UNITS = (
    ("a1", 1 / 9.80665),
    ("x1", 1e3),
    ("f", 1 / 9.80665),
    ("a3", 100.0),
    ("xf", 1e3),
    ("x3", 100.0),
    ("f", 1e-3),
    ("w", 1 / 9.80665),
)
LATE = ("a1", "w", "x2", "a3", "xf", "a2", "x1", "x3")
CHANNELS = ("a2", "x3", "f", "a1", "xf", "x1", "a3", "x2")


def the_rig() -> Rig:
    """The paper's rig."""
    return load_rig(find_file(published.RIG, "abrace_plant", "config", ".yaml", "rig"))


def changed(run: Run, name: str, change: Callable[[np.ndarray], np.ndarray]) -> Run:
    """The same test with one channel's readings changed."""
    if name == signals.GROUND:
        return replace(run, ground_acceleration=change(run.ground_acceleration))
    outputs = run.outputs.copy()
    outputs[:, run.names.index(name)] = change(outputs[:, run.names.index(name)])
    return replace(run, outputs=outputs)


def both_tests(rig: Rig, seed: int) -> list[Run]:
    """Table and command, with sensor noise of their own."""
    table, command = Laboratory(rig, 2 * seed), Laboratory(rig, 2 * seed + 1)
    return [table.table_test(SECONDS), command.command_test(SECONDS)]


def planted(fault: str, seed: int) -> tuple[list[Run], IdentificationOptions]:
    """Tests with a `fault`, and the options of their identification."""
    rig, options = the_rig(), IdentificationOptions(servo_lag=BENCH_LAG)
    if fault == "50 N friction":
        storeys = np.zeros(rig.floors)
        storeys[seed % rig.floors] = 50.0
        return both_tests(replace(rig, building=replace(rig.building, friction=tuple(storeys))), seed), options
    (group,) = rig.braces
    if fault == "0.5 mm backlash":
        return both_tests(replace(rig, braces=(replace(group, backlash=5e-4),)), seed), options
    if fault == "3 ms lag" and seed % 2:
        slow = replace(group, actuator=replace(group.actuator, lag=0.003))
        return both_tests(replace(rig, braces=(slow,)), seed), options
    tests = both_tests(rig, seed)
    if fault == "mode missed":
        return tests, options.model_copy(update={"modes": 4 + seed % 2})
    wrong = {
        "swapped sensors": swapped,
        "dead channel": dead,
        "wrong unit": other_unit,
        "3 ms lag": late,
        "saturated test": saturated,
        "spikes": spiked,
    }
    return (wrong[fault](tests, seed) if fault in wrong else tests), options


def swapped(tests: Sequence[Run], seed: int) -> list[Run]:
    """Two channels exchanged in both tests."""
    found = []
    for run in tests:
        columns = [run.names.index(name) for name in PAIRS[seed % len(PAIRS)]]
        outputs = run.outputs.copy()
        outputs[:, columns] = outputs[:, columns[::-1]]
        found.append(replace(run, outputs=outputs))
    return found


def dead(tests: Sequence[Run], seed: int) -> list[Run]:
    """A channel that reads nothing, keeps its value from a tenth of the test on, or has noise alone."""
    name, noise = CHANNELS[seed % len(CHANNELS)], np.random.default_rng(seed)

    def readings(values: np.ndarray) -> np.ndarray:
        if seed % 3 == 0:
            return np.zeros_like(values)
        if seed % 3 == 1:
            return np.concatenate([values[: len(values) // 10], np.full(len(values) - len(values) // 10, values[0])])
        return noise.normal(0.0, 0.01 * np.std(values), len(values))

    return [changed(run, name, readings) for run in tests]


def other_unit(tests: Sequence[Run], seed: int) -> list[Run]:
    """A channel in another unit in both tests."""
    name, factor = UNITS[seed % len(UNITS)]
    return [changed(run, name, lambda values: factor * values) for run in tests]


def late(tests: Sequence[Run], seed: int) -> list[Run]:
    """A sensor that is 3 ms late."""
    name = LATE[seed // 2 % len(LATE)]
    samples = 0.003 / tests[0].sample_period

    def readings(values: np.ndarray) -> np.ndarray:
        when = np.arange(len(values))
        return np.interp(when - samples, when, values)

    return [changed(run, name, readings) for run in tests]


def saturated(tests: Sequence[Run], seed: int) -> list[Run]:
    """A sensor whose range ends at 2.5 times the rms, or a command that is cut."""
    if seed % 4 == 0:
        limit = (3000.0, 6000.0)[seed // 4 % 2]
        table, _ = tests
        cut = Laboratory(the_rig(), 2 * seed + 1)
        force = np.clip(cut._noise(SECONDS, 30.0, 1800.0, 2000 + cut.seed), -limit, limit)
        return [table, cut.open_loop("bags/command", 0 * force, force)]
    name = CHANNELS[seed % len(CHANNELS)]
    return [
        changed(run, name, lambda values: np.clip(values, *(np.std(values) * np.array([-2.5, 2.5])))) for run in tests
    ]


def spiked(tests: Sequence[Run], seed: int) -> list[Run]:
    """A channel of which 5 to 40 readings are off by half its rms to its rms, either way."""
    random = np.random.default_rng(seed)

    def readings(values: np.ndarray) -> np.ndarray:
        found, count = values.copy(), int(random.integers(5, 41))
        size = np.std(values) * random.uniform(0.5, 1.0, count) * random.choice([-1.0, 1.0], count)
        found[random.choice(len(values), count, replace=False)] += size
        return found

    return [changed(run, CHANNELS[seed % len(CHANNELS)], readings) for run in tests]


def judged(fault: str, seed: int) -> tuple[str, int, Validity]:
    """What validity says of tests with a `fault`."""
    (table, command), options = planted(fault, seed)
    try:
        found = identify(table, command, options)
    except AbraceError as error:
        failed = judge_failure(table, command, options, error)
        assert failed is not None
        return fault, seed, failed.validity
    return fault, seed, judge(found).validity


def verify_validity(
    seeds: Sequence[int] = range(FIRST_SEED, FIRST_SEED + SEEDS),
) -> tuple[dict[str, Any], list[Claim], list[Table]]:
    """Values for verify.json, claims, and a table of what was said of each fault."""
    cases = [(fault, seed) for seed in seeds for fault in NAMES]
    os.environ.update(ONE_THREAD)  # of the processes to come, which load their BLAS anew
    found = []
    with (
        Progress(1).step("validity of planted faults") as step,
        ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool,
    ):
        for one in pool.map(judged, *zip(*cases, strict=True)):
            found.append(one)
            step.update(len(found) / len(cases), f"{len(found)} of {len(cases)} tests")
    named, verdicts, others = {}, {}, {}
    for fault, name in NAMES.items():
        said = [validity for of, _, validity in found if of == fault]
        right = [(name in validity.causes) if name else not validity.verdict for validity in said]
        named[fault] = float(np.mean(right))
        verdicts[fault] = Counter(validity.verdict.words for validity in said)
        others[fault] = Counter(cause for validity in said for cause in validity.causes if cause != name)
    words = {
        fault: ", ".join(f"{said} {count}" for said, count in sorted(counted.items()))
        for fault, counted in verdicts.items()
    }
    values: dict[str, Any] = {
        "named": min(share for fault, share in named.items() if NAMES[fault]),
        "false_alarms": 1 - named["linear"],
        "named_by_fault": {fault: share for fault, share in named.items() if NAMES[fault]},
        "verdicts": words,
    }
    claims = [
        Claim(f"each planted fault named, {len(seeds)} seeds", values["named"], 0.95, "-", least=True),
        Claim(f"false alarms on the linear rig, {len(seeds)} seeds", values["false_alarms"], 0.05, "-"),
    ]
    rows = tuple(
        (
            fault,
            f"{100 * named[fault]:.0f}" if NAMES[fault] else "-",
            words[fault],
            ", ".join(f"{cause} {count}" for cause, count in others[fault].most_common()) or "-",
        )
        for fault in NAMES
    )
    title = f"What validity says of planted faults, {len(seeds)} seeds of {SECONDS:g} s"
    return values, claims, [Table(title, ("fault", "named %", "verdicts", "what else it names"), rows)]


def main() -> int:
    """The section alone."""
    first, count = (int(text) for text in (sys.argv[1:3] if len(sys.argv) > 2 else (FIRST_SEED, SEEDS)))
    values, claims, tables = verify_validity(range(first, first + count))
    print(values)
    print("\n\n".join(table.text() for table in tables))
    return 0 if all(claim.holds for claim in claims) else 1


if __name__ == "__main__":
    sys.exit(main())
