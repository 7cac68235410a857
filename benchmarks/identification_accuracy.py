# SPDX-License-Identifier: Apache-2.0
"""How well identification finds the paper's rig, against other methods: the part `identification` of `make verify`.

Simulated tests with the rig's own sensors (noise 65 dB down, 16 bits), each with noise of its own. Asked are the worst
pole of 8 seeds for each length of test, how often the 95 % intervals hold the rig's poles over 20 seeds, and the
prediction of El Centro by the three models.
"""

from __future__ import annotations

import multiprocessing
import os
from collections import Counter
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from laboratory import Laboratory
from n4sid import n4sid_poles
from simulation import ONE_THREAD

from abrace_core import AbraceError
from abrace_core.files.installed import find_file
from abrace_core.files.progress import Progress
from abrace_core.model.linear_model import pole_table
from abrace_lqg.design import design
from abrace_lqg.weights import load_weights
from abrace_plant.records.files import read_record
from abrace_plant.records.measures import STANDARD_GRAVITY
from abrace_plant.records.options import Treatment
from abrace_plant.records.treatment import prepare
from abrace_plant.rig import published
from abrace_plant.rig.file import load_rig
from abrace_sysid.fitting.options import IdentificationOptions
from abrace_sysid.identification import Identification, identify
from abrace_sysid.methods import fit
from abrace_sysid.validation import compare

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_core.model.run import Run
    from abrace_plant.rig.model import Rig
    from abrace_sysid.fitting.pole_estimate import PoleInterval

    Pairs = Sequence[tuple[float, float]]
    """Frequency [rad/s] and damping ratio of pole pairs."""

SEEDS, COVERAGE_SEEDS = 8, 20
PEERS = ("paper", "n4sid", "vector_fitting")
"""Methods compared with ours; the first two are measured over all seeds, all three on one."""

SHOWN = (600, 0)
"""Length and seed of the tests on which all methods are compared pole by pole."""

INPUTS = {"table": "w", "command": "U"}
"""Of the tests."""

LENGTHS: tuple[float | None, ...] = (120, 300, 600, None)
"""Seconds of each of both tests; None: a multisine of 5 periods of 32.768 s instead."""

# For each key of verify.json: length, the tests whose worst pole counts, and what is asked of frequency and damping.
# short_120 and multisine are about both tests; the worst of each test alone is asked more than the poles common to both
# would be, and says what either test can do without the other.
CASES: dict[str, tuple[float | None, tuple[str, ...], float, float]] = {
    "table_300": (300, ("table",), 0.0003, 0.01),
    "table_600": (600, ("table",), 0.0001, 0.005),
    "command_300": (300, ("command",), 0.001, 0.035),
    "command_600": (600, ("command",), 0.0006, 0.02),
    "short_120": (120, ("table", "command"), 0.001, 0.10),
    "multisine": (None, ("table", "command"), 0.0002, 0.005),
}


@dataclass(frozen=True)
class Trial:
    """What was found from one table test and one command test.

    Parameters
    ----------
    length, seed
        Of the tests.
    ours
        Pairs with their intervals: of "table", of "command" and "common".
    peers
        By method and test: pairs, or in words why there are none.
    """

    length: float | None
    seed: int
    ours: dict[str, tuple[PoleInterval, ...]]
    peers: dict[str, dict[str, Pairs | str]]

    def pairs(self, method: str, test: str) -> Pairs | str:
        """Of one method and one test."""
        if method == "ours":
            return [(pair.frequency, pair.damping) for pair in self.ours[test]]
        return self.peers[method][test]


def the_rig() -> Rig:
    """The paper's rig."""
    return load_rig(find_file(published.RIG, "abrace_plant", "config", ".yaml", "rig"))


def true_pairs(rig: Rig) -> dict[str, Pairs]:
    """The rig's own pairs that each test shows: the building's from the table, all from the command."""
    own = pole_table(rig.model.poles)
    return {"table": own[: rig.floors], "command": own, "common": own}


def two_tests(rig: Rig, length: float | None, seed: int) -> dict[str, Run]:
    """A table test and a command test; sensors of the second have noise of their own."""
    first, second = Laboratory(rig, 2 * seed), Laboratory(rig, 2 * seed + 1)
    if length is None:
        return {"table": first.multisine_test(True, False), "command": second.multisine_test(False, True)}
    return {"table": first.table_test(length), "command": second.command_test(length)}


def by_peer(method: str, runs: dict[str, Run], found: Identification) -> dict[str, Pairs | str]:
    """Each test's pairs by another method: N4SID from the record, the others from our transfer functions."""
    if method == "n4sid":
        return {test: _by_n4sid(test, run) for test, run in runs.items()}
    options = IdentificationOptions.model_validate({"method": method, "servo_lag": published.BENCH_LAG})
    try:
        poles = fit(found.table, found.commands, runs["table"].floors, options, _in_silence).poles
    except AbraceError as error:
        return dict.fromkeys(runs, str(error))
    return {
        test: [(pair.frequency, pair.damping) for pair in pairs]
        for test, pairs in (("table", poles.table_pairs), ("command", poles.command_pairs))
    }


def _by_n4sid(test: str, run: Run) -> Pairs | str:
    try:
        poles = n4sid_poles(run, INPUTS[test])
    except AbraceError as error:
        return str(error)
    return pole_table(poles) or f"{run.source}: n4sid finds no oscillating pair"


def _in_silence(_step: str, _fraction: float) -> None:
    """Progress that is not shown."""


def measure_trial(length: float | None, seed: int) -> Trial:
    """Identify from one table and one command test, by our method and others."""
    runs = two_tests(the_rig(), length, seed)
    found = identify(runs["table"], runs["command"])
    poles = found.poles
    ours = {"table": poles.table_pairs, "command": poles.command_pairs, "common": poles.common_pairs}
    methods = PEERS if (length, seed) == SHOWN else PEERS[:2] if seed < SEEDS else ()
    peers = {method: by_peer(method, runs, found) for method in methods}
    return Trial(length, seed, ours, peers)


def measure_prediction() -> dict[str, Any]:
    """El Centro at 0.1 g, with zero command and with LQG3, by the models of one table and one command test of 600 s."""
    rig = the_rig()
    runs = two_tests(rig, 600, 0)
    found = identify(runs["table"], runs["command"])
    models = {"consistent": found.model, "states_24": found.superposed, "states_8": found.reduced}
    weights = load_weights(find_file("lqg3", "abrace_lqg", "config", ".yaml", "weights"))
    law = design(found.reduced, weights, 1 / rig.sample_rate).controller
    treatment = Treatment(peak_acceleration=0.1 * STANDARD_GRAVITY, duration=100.0)
    ground = prepare(read_record("el_centro"), rig.sample_rate, treatment)
    laboratory = Laboratory(rig, 2 * COVERAGE_SEEDS)
    tests = {
        "zero_command": (laboratory.open_loop("bags/uncontrolled", ground, 0 * ground), None),
        "closed_loop": (laboratory.closed_loop("bags/controlled", ground, law), law),
    }
    values: dict[str, Any] = {}
    for name, model in models.items():
        compared = {test: compare(run, model, control, rig.capacity) for test, (run, control) in tests.items()}
        values[name] = {}
        for test, one in compared.items():
            error = one.noise_free_error()
            values[name][test] = {channel: error[channel] for channel in tests[test][0].names}
        values[name]["peak_rms_error"] = float(np.mean([one.peak_rms_error() for one in compared.values()]))
    return values


def worst_errors(found: Pairs, true: Pairs) -> tuple[float, float]:
    """Greatest relative error of frequency and of damping ratio; the found pair nearest in frequency is compared."""
    pairs, own = np.array(found), np.array(true)
    nearest = np.abs(pairs[:, :1] / own[:, 0] - 1).argmin(axis=0)
    frequency, damping = np.abs(pairs[nearest] / own - 1).max(axis=0)
    return float(frequency), float(damping)


def worst_of(method: str, case: str, trials: Sequence[Trial], true: dict[str, Pairs]) -> dict[str, Any]:
    """A case's worst errors over SEEDS seeds; none where a method refuses a seed, but its reason and how many."""
    length, tests, *_ = CASES[case]
    errors, refused, reasons = [], 0, []
    for trial in (one for one in trials if one.length == length and one.seed < SEEDS):
        found = {test: trial.pairs(method, test) for test in tests}
        refusals = [pairs for pairs in found.values() if isinstance(pairs, str)]
        errors += [worst_errors(pairs, true[test]) for test, pairs in found.items() if not isinstance(pairs, str)]
        reasons += refusals
        refused += bool(refusals)
    if refused:
        return {"frequency_error": None, "damping_error": None, "failed": reasons[0], "failed_seeds": refused}
    frequency, damping = np.max(errors, axis=0)
    return {"frequency_error": float(frequency), "damping_error": float(damping)}


def coverage(test: str, trials: Sequence[Trial], true: dict[str, Pairs]) -> float:
    """Fraction of frequencies and damping ratios from 600 s within their 95 % interval."""
    inside = Counter(
        low <= value <= high
        for trial in trials
        if trial.length == 600
        for pair, (frequency, damping) in zip(trial.ours[test], true[test], strict=True)
        for (low, high), value in ((pair.frequency_interval, frequency), (pair.damping_interval, damping))
    )
    return inside[True] / inside.total()


def measure() -> tuple[list[Trial], dict[str, Any]]:
    """All trials and the prediction, on two processes of one thread each."""
    os.environ.update(ONE_THREAD)  # of the processes to come, which load their BLAS anew
    lengths = sorted(LENGTHS, key=lambda length: -(length or 0))
    wanted = [(n, seed) for n in lengths for seed in range(COVERAGE_SEEDS if n == 600 else SEEDS)]
    with (
        ProcessPoolExecutor(2, multiprocessing.get_context("spawn")) as pool,
        Progress(1).step("identification") as shown,
    ):
        prediction = pool.submit(measure_prediction)
        trials = [pool.submit(measure_trial, *one) for one in wanted]
        futures: list[Future[Any]] = [prediction, *trials]
        for done, _ in enumerate(as_completed(futures), 1):
            shown.update(done / (len(trials) + 1), f"{done} of {len(trials) + 1} pairs of tests")
        return [trial.result() for trial in trials], prediction.result()


def evaluate(trials: Sequence[Trial], prediction: dict[str, Any], true: dict[str, Pairs]) -> dict[str, Any]:
    """The content of verify.json -> identification."""
    return {
        **{case: worst_of("ours", case, trials, true) for case in CASES},
        "paper_method": {case: worst_of("paper", case, trials, true) for case in CASES},
        "n4sid": {case: worst_of("n4sid", case, trials, true) for case in CASES},
        "coverage": coverage("common", trials, true),
        "coverage_table": coverage("table", trials, true),
        "coverage_command": coverage("command", trials, true),
        "prediction": prediction,
    }
