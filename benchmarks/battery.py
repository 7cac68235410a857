# SPDX-License-Identifier: Apache-2.0
"""Random structures identified by the names alone: `make verify PARTS=battery`, with N4SID of the true order beside.

A case (`battery_cases`) is fitted to its first two thirds and predicts the last; its limit is what the truth predicts.
A mode is found if a listed pair is within 1 % of its frequency and 30 % of its damping; a listed pair farther than 3 %
from every true frequency is false. Which modes can be identified, and which cases nobody can predict, is told by the
Cramer-Rao bound (`battery_bounds`). `python benchmarks/battery.py KIND[:NUMBER] ...` measures some cases alone.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from battery_bounds import bounds
from battery_cases import NUMBERS, Case, case
from claims import Claim, claim_table
from n4sid import n4sid_model
from scipy import optimize
from simulation import ONE_THREAD

from abrace.report.table import Table
from abrace_core import AbraceError
from abrace_core.files.progress import Progress
from abrace_sysid.data_identification import DataOptions, identify_data, variance_accounted_for

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from abrace_sysid.data_identification import DataIdentification
    from abrace_sysid.recorded.test import Test

WITHIN, PEER = 0.01, 0.005
"""Shares of the held-out variance that may be lost against the limit, and against N4SID."""

NEAR, DAMPING, FALSE = 0.01, 0.3, 0.03
"""Relative distance from the truth of a mode that is found, in frequency and damping, and of a pair that is false."""


class Outcome(NamedTuple):
    """What became of a case.

    Parameters
    ----------
    kind, number
        Which case.
    refused
        Why there is no model; empty: there is one.
    lost
        Share of the held-out variance that is lost against the limit, at the worst output.
    expected
        Share that maximum likelihood loses on the mean, at the worst output (`battery_bounds`).
    peer
        As `lost`, by N4SID; NaN: it has no model that predicts.
    frequencies, dampings, identifiable, found
        (modes,) of the truth, in Hz and as ratio; whether each can be identified, and is found.
    false
        [Hz] frequencies of the false pairs.
    covered
        For each interval of the frequencies and dampings of pairs near a mode: whether it contains the true value.
    seconds
        Computing time of the identification.
    """

    kind: str
    number: int
    refused: str
    lost: float
    expected: float
    peer: float
    frequencies: tuple[float, ...]
    dampings: tuple[float, ...]
    identifiable: tuple[bool, ...]
    found: tuple[bool, ...]
    false: tuple[float, ...]
    covered: tuple[bool, ...]
    seconds: float

    @property
    def unpredictable(self) -> bool:
        """Whether nobody can predict it: maximum likelihood loses more than WITHIN."""
        return self.expected > WITHIN

    @property
    def within(self) -> bool:
        """Whether it predicts as well as the noise allows, or as maximum likelihood where nobody can."""
        return not self.refused and self.lost <= WITHIN + (self.expected if self.unpredictable else 0.0)

    @property
    def worse_than_peer(self) -> bool:
        """Whether N4SID predicts better; not better than the truth, which knows nothing of a disturbance."""
        return bool(self.lost > max(self.peer, 0.0) + PEER)

    @property
    def missed(self) -> list[str]:
        """The identifiable modes that are not found."""
        modes = zip(self.frequencies, self.dampings, self.identifiable, self.found, strict=True)
        return [f"{f:.4g} Hz ({100 * z:.2g} %)" for f, z, can, found in modes if can and not found]

    def failures(self) -> str:
        """What went wrong in words; empty: nothing."""
        if self.refused:
            return f"refused: {self.refused}"
        texts = []
        if not self.within:
            texts.append(f"loses {100 * self.lost:.2f} points, maximum likelihood {100 * self.expected:.2f}")
        if self.worse_than_peer:
            texts.append(f"loses {100 * self.lost:.2f} points, N4SID {100 * self.peer:.2f}")
        if self.missed:
            texts.append(f"misses {', '.join(self.missed)}")
        if self.false:
            texts.append(f"false at {', '.join(f'{f:.4g}' for f in self.false)} Hz")
        return "; ".join(texts)


def measure_case(kind: str, number: int, with_peer: bool = True) -> Outcome:
    """Identify the case of a kind and a number.

    Parameters
    ----------
    kind, number
        As for `battery_cases.case`.
    with_peer
        Whether N4SID is fitted as well, which needs ctrlsys.
    """
    one = case(kind, number)
    truth, best = one.structure, bounds(one)
    frequencies, modes = truth.frequencies / (2 * np.pi), len(truth.frequencies)
    options = DataOptions(inputs=one.input_names, sample_rate=one.sample_rate)
    (record,) = options.read(one.columns)
    first, last = record.part(0, one.cut), record.part(one.cut, len(record.outputs))
    peer = _lost_by_n4sid(one, first, last) if with_peer else np.nan
    nothing = Outcome(
        kind, number, "", 1.0, float(best.loss.max()), peer, tuple(frequencies.tolist()),
        tuple(truth.dampings.tolist()), tuple(best.identifiable.tolist()), (False,) * modes, (), (), 0.0,
    )  # fmt: skip
    begin = time.process_time()
    try:
        found = identify_data(first, options)
    except AbraceError as error:
        return nothing._replace(refused=str(error))
    seconds = time.process_time() - begin
    shares = variance_accounted_for(found.model, found.in_time(last))
    share = dict(zip(found.model.outputs, shares.tolist(), strict=True))
    lost = max(limit - share.get(name, 0.0) for name, limit in _limits(one).items())
    hits, false, covered = _compared(found, truth.frequencies, truth.dampings)
    return nothing._replace(lost=lost, found=hits, false=false, covered=covered, seconds=seconds)


def _limits(one: Case) -> dict[str, float]:
    """By output the share of the held-out variance that the truth accounts for."""
    measured, foreseen = one.outputs[one.cut :], one.foreseen[one.cut :]
    shares = 1 - (measured - foreseen).var(axis=0) / measured.var(axis=0)
    return {f"y{i + 1}": float(share) for i, share in enumerate(shares)}


def _lost_by_n4sid(one: Case, first: Test, last: Test) -> float:
    """What N4SID of the true order loses at the worst output, the true delays known; NaN: it predicts nothing."""
    delays, modes = one.delays, len(one.structure.frequencies)
    try:
        model = n4sid_model(first.in_time(delays), 2 * modes, float(one.structure.frequencies[-1]) / (2 * np.pi))
    except AbraceError:
        return np.nan
    shares = variance_accounted_for(model, last.in_time(delays))
    lost = max(limit - share for limit, share in zip(_limits(one).values(), shares, strict=True))
    return float(lost) if np.min(shares) > 0 else np.nan


def _compared(
    found: DataIdentification, frequencies: NDArray[np.float64], dampings: NDArray[np.float64]
) -> tuple[tuple[bool, ...], tuple[float, ...], tuple[bool, ...]]:
    """Which modes are found, the false pairs [Hz], and whether each interval holds; each pair is for one mode."""
    pairs = found.pairs
    distance = np.abs(np.array([pair.frequency for pair in pairs])[:, None] / frequencies - 1)
    near, modes = optimize.linear_sum_assignment(distance)
    hits, covered = [False] * len(frequencies), []
    for i, k in zip(near, modes, strict=True):
        pair = pairs[i]
        hits[k] = bool(distance[i, k] < NEAR and abs(pair.damping / dampings[k] - 1) < DAMPING)
        if distance[i, k] < FALSE:
            (slow, fast), (low, high) = pair.frequency_interval, pair.damping_interval
            covered += [bool(slow <= frequencies[k] <= fast), bool(low <= dampings[k] <= high)]
    false = [pair.frequency / (2 * np.pi) for pair, each in zip(pairs, distance, strict=True) if each.min() > FALSE]
    return tuple(hits), tuple(false), tuple(covered)


def summary(outcomes: Sequence[Outcome]) -> dict[str, float]:
    """Counts and shares of some cases, as in verify.json.

    Parameters
    ----------
    outcomes
        The cases, at least one.
    """
    modes = [hit for one in outcomes for can, hit in zip(one.identifiable, one.found, strict=True) if can]
    covered = [holds for one in outcomes for holds in one.covered]
    seconds = [one.seconds for one in outcomes if not one.refused]
    return {
        "cases": len(outcomes),
        "refused": sum(bool(one.refused) for one in outcomes),
        "within": sum(one.within for one in outcomes),
        "unpredictable": sum(one.unpredictable for one in outcomes),
        "n4sid_predicts": sum(bool(np.isfinite(one.peer)) for one in outcomes),
        "worse_than_n4sid": sum(one.worse_than_peer for one in outcomes),
        "n4sid_within": sum(one._replace(lost=one.peer, refused="").within for one in outcomes),
        "modes": len(modes),
        "found": sum(modes),
        "false_cases": sum(bool(one.false) for one in outcomes),
        "coverage": float(np.mean(covered)) if covered else np.nan,
        "seconds": float(np.median(seconds)) if seconds else np.nan,
    }


def measure(cases: Sequence[tuple[str, int]], processes: int = 2) -> list[Outcome]:
    """Outcomes in the order of the cases, on processes of one thread each.

    Parameters
    ----------
    cases
        Kinds and numbers.
    processes
        How many at once.
    """
    os.environ.update(ONE_THREAD)  # of the processes to come, which load their BLAS anew
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, context) as pool, Progress(1).step("battery") as shown:
        futures = [pool.submit(measure_case, *each) for each in cases]
        for done, _ in enumerate(as_completed(futures), 1):
            shown.update(done / len(futures), f"{done} of {len(futures)} cases")
        return [one.result() for one in futures]


def verify_battery(processes: int = 2) -> tuple[dict[str, Any], list[Claim], list[Table]]:
    """Values for verify.json, claims, a table by kind and one of what went wrong.

    Parameters
    ----------
    processes
        How many cases at once.
    """
    outcomes = measure([(kind, number) for kind, count in NUMBERS.items() for number in range(count)], processes)
    whole = summary(outcomes)
    by_kind = {kind: summary([one for one in outcomes if one.kind == kind]) for kind in NUMBERS}
    return whole | {"by_kind": by_kind}, claims_of(whole), [table_of(whole, by_kind), failures_of(outcomes)]


def claims_of(whole: dict[str, float]) -> list[Claim]:
    """The claims about all cases.

    Parameters
    ----------
    whole
        Their `summary`.
    """
    cases, predicts = whole["cases"], max(whole["n4sid_predicts"], 1)
    within, peer = whole["within"] / cases, f"N4SID, true order: {whole['n4sid_within'] / cases:.3f}"
    worse, found = whole["worse_than_n4sid"] / predicts, whole["found"] / whole["modes"]
    false, coverage = whole["false_cases"] / cases, whole["coverage"]
    return [
        Claim("battery: cases without a model", whole["refused"], 0, "-"),
        Claim("battery: within 1 point of what the noise allows", within, 0.98, peer, least=True),
        Claim("battery: worse than N4SID by 0.5 points, where it predicts", worse, 0.01, "-"),
        Claim("battery: identifiable modes found", found, 0.98, "-", least=True),
        Claim("battery: cases with a false mode", false, 0.01, "-"),
        Claim("battery: 95 % intervals that hold", coverage, 0.92, "theory: 0.95", least=True),
        Claim("battery: 95 % intervals that hold", coverage, 0.98, "theory: 0.95"),
    ]


def table_of(whole: dict[str, float], by_kind: dict[str, dict[str, float]]) -> Table:
    """The counts by kind.

    Parameters
    ----------
    whole
        The `summary` of all cases.
    by_kind
        That of the cases of each kind.
    """
    rows = [
        (
            kind.replace("_", " "),
            *(f"{one[key]:.0f}" for key in ("cases", "refused", "unpredictable", "within", "n4sid_within")),
            f"{one['worse_than_n4sid']:.0f}",
            f"{one['found']:.0f}/{one['modes']:.0f}",
            f"{one['false_cases']:.0f}",
            f"{100 * one['coverage']:.1f}",
            f"{one['seconds']:.2f}",
        )
        for kind, one in {**by_kind, "all": whole}.items()
    ]
    header = ("kind", "cases", "no model", "nobody", "within", "N4SID", "worse", "found", "false", "95 %", "s")
    note = (
        "nobody: cases in which maximum likelihood loses more than 1 point; within: at most 1 point is lost (or 1 more "
        "than maximum likelihood, if nobody can), by ours and by N4SID of the true order; worse: by 0.5 points than "
        "N4SID; found: identifiable modes; false: cases with a false mode; 95 %: intervals that hold; s: median."
    )
    return Table("Battery: random structures, names alone, last third predicted", header, tuple(rows), (note,))


def failures_of(outcomes: Sequence[Outcome]) -> Table:
    """The cases in which something went wrong.

    Parameters
    ----------
    outcomes
        All cases.
    """
    rows = tuple((one.kind, str(one.number), one.failures()) for one in outcomes if one.failures())
    return Table("Battery: what went wrong", ("kind", "number", ""), rows)


def main() -> int:
    """All cases, or those that are named, one at a time."""
    named = sys.argv[1:] or list(NUMBERS)
    outcomes = []
    for name in named:
        kind, _, number = name.partition(":")
        for place in [int(number)] if number else range(NUMBERS[kind]):
            one = measure_case(kind, place)
            outcomes.append(one)
            lost = ", ".join(f"{100 * share:.3f}" for share in (one.lost, one.peer, one.expected))
            print(f"{kind} {place}: loses, N4SID, bound: {lost}; {one.seconds:.1f} s  {one.failures()}", flush=True)
    whole = summary(outcomes)
    kinds = dict.fromkeys(one.kind for one in outcomes)
    by_kind = {kind: summary([one for one in outcomes if one.kind == kind]) for kind in kinds}
    tables = claim_table(claims_of(whole)), table_of(whole, by_kind), failures_of(outcomes)
    print("\n\n".join(table.text() for table in tables))
    return 0 if all(claim.holds for claim in claims_of(whole)) else 1


if __name__ == "__main__":
    sys.exit(main())
