# SPDX-License-Identifier: Apache-2.0
"""How often 95 % intervals hold what they are about: the part `buildings.coverage` of `make verify`.

Tests of the paper's rig, and of the same rig with 50 N of Coulomb friction in each storey, by noise (300 s) and by
multisines (six realizations of three periods of 32.768 s), with the table or with the command: 24 seeds of each, with
sensors' noise of their own. Asked are frequency and damping ratio of every pair.

Of the linear rig the truth is known. With friction it is the best linear approximation for an input of that spectrum
and level, which is what the mean of many tests tends to: for each seed the mean of what the 23 others found, whose own
scatter (a 23rd of the variance) is allowed for.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from claims import Claim, claim_table
from identification_accuracy import INPUTS, the_rig, true_pairs
from laboratory import Laboratory
from simulation import ONE_THREAD

from abrace.report.table import Table
from abrace_core.files.progress import Progress
from abrace_sysid.fitting.pole_estimate import NORMAL_95
from abrace_sysid.identification import identify

if TYPE_CHECKING:
    from abrace_core.model.run import Run
    from abrace_plant.rig.model import Rig

SEEDS = 24
FRICTION = 50.0
"""Of each storey [N]."""

SECONDS = 300.0
REALIZATIONS, PERIODS, PERIOD = 6, 3, 32.768
RIGS = ("linear", "friction")
EXCITATIONS = ("noise", "multisine")
TESTS = tuple(INPUTS)
LEAST, MOST = 0.90, 0.98

Found = dict[str, list[tuple[float, float, float, float]]]
"""By test: frequency, damping ratio and their deviations of each pair."""


def tests_of(rig: Rig, excitation: str, seed: int) -> dict[str, list[Run]]:
    """The tests with the table and those with the command; nothing of one seed is in those of another."""
    found: dict[str, list[Run]] = {test: [] for test in TESTS}
    for i, test in enumerate(TESTS):
        if excitation == "noise":
            laboratory = Laboratory(rig, 2 * seed + i)
            found[test] = [laboratory.table_test(SECONDS) if test == "table" else laboratory.command_test(SECONDS)]
            continue
        for realization in range(REALIZATIONS):
            laboratory = Laboratory(rig, 100 * seed + 2 * realization + i)
            found[test].append(laboratory.multisine_test(test == "table", test == "command", PERIODS, PERIOD))
    return found


def trial(which: str, excitation: str, seed: int) -> Found:
    """Pairs of each test, and of both where the rig is linear: with friction each test has its own best linear rig."""
    rig = the_rig()
    if which == "friction":
        rig = replace(rig, building=replace(rig.building, friction=(FRICTION,) * rig.floors))
    tests = tests_of(rig, excitation, seed)
    poles = identify(tests["table"], tests["command"]).poles
    found = {"table": poles.table_pairs, "command": poles.command_pairs}
    if which == "linear":
        found["common"] = poles.common_pairs
    return {
        test: [(one.frequency, one.damping, one.frequency_deviation, one.damping_deviation) for one in pairs]
        for test, pairs in found.items()
    }


def errors(found: np.ndarray, true: np.ndarray | None) -> np.ndarray:
    """(seeds, pairs, 2) errors in units of their deviations.

    Parameters
    ----------
    found
        (seeds, pairs, 4).
    true
        (pairs, 2); None: the mean of the other seeds.
    """
    values, deviations, seeds = found[..., :2], found[..., 2:], len(found)
    if true is not None:
        return np.asarray((values - true) / deviations)
    others = (values.sum(axis=0) - values) / (seeds - 1)
    return np.asarray((values - others) / deviations / np.sqrt(1 + 1 / (seeds - 1)))


def measure() -> dict[tuple[str, str], list[Found]]:
    """All trials, on two processes of one thread each; those with friction first, which take longer."""
    os.environ.update(ONE_THREAD)  # of the processes to come, which load their BLAS anew
    kinds = [(which, excitation) for which in reversed(RIGS) for excitation in EXCITATIONS]
    with ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool, Progress(1).step("coverage") as shown:
        trials = {kind: [pool.submit(trial, *kind, seed) for seed in range(SEEDS)] for kind in kinds}
        futures = [one for of_kind in trials.values() for one in of_kind]
        for done, _ in enumerate(as_completed(futures), 1):
            shown.update(done / len(futures), f"{done} of {len(futures)} pairs of tests")
        return {kind: [one.result() for one in of_kind] for kind, of_kind in trials.items()}


def pooled_over_better(trials: list[Found], true: dict[str, Any]) -> float:
    """Greatest rms error of the building's pairs common to both tests, over the lesser of the two tests' own."""
    floors = len(true["table"])
    rms = {}
    for test in ("table", "command", "common"):
        values = np.array([one[test][:floors] for one in trials])[..., :2]
        rms[test] = np.sqrt(np.mean((values - np.array(true["table"])) ** 2, axis=0))
    return float(np.max(rms["common"] / np.minimum(rms["table"], rms["command"])))


def verify_coverage() -> tuple[dict[str, Any], list[Claim], list[Table]]:
    """Values for verify.json, claims, and a table of the errors."""
    true = true_pairs(the_rig())
    values: dict[str, Any] = {}
    claims, rows = [], []
    measured = measure()
    for (which, excitation), trials in sorted(measured.items(), reverse=True):
        for test in trials[0]:
            found = np.array([one[test] for one in trials])
            scaled = errors(found, np.array(true[test]) if which == "linear" else None)
            name = f"{which}_{test}_{excitation}"
            values[name] = float(np.mean(np.abs(scaled) < NORMAL_95))
            title = f"95 % intervals: {name.replace('_', ', ')}"
            claims.append(Claim(title, values[name], LEAST, "theory: 0.95", least=True))
            claims.append(Claim(title, values[name], MOST, "theory: 0.95"))
            rms = np.sqrt(np.mean(scaled**2, axis=0)).T
            rows.append((name, f"{values[name]:.3f}", *(" ".join(f"{one:.2f}" for one in each) for each in rms)))
    pooled = pooled_over_better(measured["linear", "noise"], true)
    claims.append(Claim("poles of both tests, rms error over the better test's", pooled, 1.1, "1: as good"))
    header = ("rig, test, excitation", "within 95 %", "rms error of frequencies, in deviations", "of damping ratios")
    notes = (
        f"{SEEDS} seeds. With friction the truth is what the other seeds found on the mean.",
        f"Building's pairs common to both tests, noise: rms error at most {pooled:.2f} of the better test's.",
    )
    return (
        values,
        claims,
        [Table("Intervals: how often they hold, and errors over deviations", header, tuple(rows), notes)],
    )


def main() -> int:
    """The section alone."""
    values, claims, tables = verify_coverage()
    print(values)
    print("\n\n".join(table.text() for table in (claim_table(claims), *tables)))
    return 0 if all(claim.holds for claim in claims) else 1


if __name__ == "__main__":
    sys.exit(main())
