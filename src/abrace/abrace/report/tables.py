# SPDX-License-Identifier: Apache-2.0
"""The tables of a campaign: poles, Table 1, without and with control, simulated against measured, timing."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from abrace.report.events import events_table
from abrace.report.summary import error_vs_paper, nearest_pole, poles_by_test, timing_summary
from abrace.report.table import Table, number, reduction
from abrace_core.model.response import (
    PAPER_RIG,
    TABLE_1_EXPERIMENT,
    TABLE_1_SIMULATION,
    PeakRms,
    clipped_sentences,
    mean_relative_error,
)
from abrace_plant.rig.published import PAPER_POLES
from abrace_sysid.fitting.pole_estimate import NORMAL_95, TESTS, PoleInterval

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from abrace.report.results import AmbientResult, Cells, ComparedTest, Poles, Results, Timing
    from abrace.report.units import Units
    from abrace_lqg.proof.checks import Proof
    from abrace_sysid.validity.finding import Validity

PAPER_ERROR = mean_relative_error(TABLE_1_SIMULATION, TABLE_1_EXPERIMENT)
FITTED = "LQG3's five weights were fitted to these 18 cells; the models identified below were not fitted to the paper"


def tables(results: Results, units: Units) -> list[Table]:
    """Poles, validity, Table 1, without and with control, simulated against measured, timing: what the results have.

    Numbers are in these `units`.
    """
    return [
        *identification_tables(results),
        *comparison_tables(results, units),
        *event_tables(results),
        timing_table(results.timing),
    ]


def identification_tables(results: Results) -> list[Table]:
    """Poles, validity and modes of ambient tests of the `results`."""
    found = []
    if results.poles is not None:
        paper = results.poles.rig == PAPER_RIG
        found += [_pole_table(test, poles, paper) for test, poles in poles_by_test(results.poles)]
    found += [_validity_table(step, one) for step, one in results.validity.items()]
    return found + [_ambient_table(step, one) for step, one in results.ambient.items()]


def interval_tables(results: Results) -> list[Table]:
    """Pole pairs of every identification of the `results` with their 95 % intervals."""
    return [_interval_table(step, one) for step, one in results.intervals.items()]


def comparison_tables(results: Results, units: Units) -> list[Table]:
    """Table 1, reductions and agreement of the main comparison of the `results`, then all of them, in these `units`."""
    found = one_comparison(results.main, units) if results.main is not None else []
    return [*found, *tables_of_all(results, units)]


def one_comparison(comparison: ComparedTest, units: Units) -> list[Table]:
    """Peaks and rms of a `comparison`, reductions, and agreement with models, in these `units`."""
    found = [_table_1(comparison, units)]
    if comparison.uncontrolled is not None:
        found.append(_reduction_table(comparison, comparison.uncontrolled, units))
    if comparison.simulated_vs_measured:
        found.append(_agreement_table(comparison))
    return found


def tables_of_all(results: Results, units: Units) -> list[Table]:
    """Comparisons of the `results` side by side, where there are several, in these `units`."""
    return _controller_tables(results.comparisons, units)


def event_tables(results: Results) -> list[Table]:
    """Which tests of the `results` have readings at the end of a sensor's range, and what else happened, if any."""
    clipped, events = _clipped_rows(results.comparisons), events_table(results.timing)
    found = [Table("At the end of a sensor's range", ("test", ""), clipped)] if clipped else []
    return [*found, events] if events else found


def margin_table(proofs: Mapping[str, Proof]) -> Table:
    """Margins of every controller that was designed: the least of all models, from their `proofs`."""

    def row(name: str, proof: Proof) -> tuple[str, ...]:
        margins = proof.margins
        return (
            name,
            number(margins.gain_db, ".1f"),
            number(margins.phase_deg, ".1f"),
            number(1e3 * margins.delay, ".1f"),
            number(margins.sensitivity_peak, ".2f"),
            number(100 * proof.least_damping_kept, ".0f"),
            "yes" if proof.models and all(one.stable for one in proof.models) else "NO",
            ", ".join(proof.accepted) or "-",
        )

    columns = ("gain margin [dB]", "phase margin [deg]", "delay margin [ms]", "sensitivity peak", "damping kept %")
    header = ("controller", *columns, "stable", "accepted")
    notes = tuple(f"{name}: {proof.summary()}" for name, proof in proofs.items())
    return Table("Margins", header, tuple(row(name, proof) for name, proof in proofs.items()), notes)


def _validity_table(step: str, validity: Validity) -> Table:
    """The verdict, each check's worst finding, and what to do."""
    rows = tuple(
        (one.check, number(one.value, ".2g"), f"{one.limit:.2g}", one.verdict.words, one.where)
        for one in validity.worst
    )
    causes = f": {', '.join(validity.causes)}" if validity.causes else ""
    reasons = [finding for finding in validity.findings if finding.cause]
    notes = dict.fromkeys([*(one.meaning for one in reasons), *(one.advice for one in reasons if one.advice)])
    title = f"Validity of {step}: {validity.verdict.words}{causes}"
    return Table(title, ("check", "found", "limit", "verdict", "where"), rows, tuple(notes))


def _interval_table(step: str, intervals: Mapping[str, Sequence[PoleInterval]]) -> Table:
    """Pairs of the table test, the command test and both tests, each with its 95 % interval."""

    def text(value: float, deviation: float) -> str:
        if not math.isfinite(deviation):
            return f"{value:.4g}"
        digits = max(3, 1 - math.floor(math.log10(deviation))) if deviation > 0 else 3
        return f"{value:.{digits}f} ± {NORMAL_95 * deviation:.{digits}f}"

    rows = [
        (
            f"{TESTS.get(test, test)} {i}",
            text(pair.frequency, pair.frequency_deviation),
            text(100 * pair.damping, 100 * pair.damping_deviation),
        )
        for test, pairs in intervals.items()
        for i, pair in enumerate(pairs, 1)
    ]
    return Table(f"Poles with 95 % intervals: {step}", ("", "frequency [rad/s]", "damping ratio [%]"), tuple(rows))


def _pole_table(test: str, poles: Poles, is_papers: bool) -> Table:
    """Identified poles, the plant's own and, for the paper's rig, the paper's."""
    paper = [PoleInterval(abs(p), -p.real / abs(p)) for p in PAPER_POLES[test]] if is_papers else []
    missed = [true for true in poles.true if nearest_pole(poles.identified, true.frequency) is None]

    def row(pole: PoleInterval) -> list[str]:
        found = None if pole in missed else pole
        true, papers = nearest_pole(poles.true, pole.frequency), nearest_pole(paper, pole.frequency)

        def cells(quantity: Callable[[PoleInterval], float], form: str) -> list[str]:
            error = 100 * (quantity(found) / quantity(true) - 1) if found and true else None
            compared = (found, true, papers) if is_papers else (found, true)
            columns = [number(quantity(p) if p else None, ".3f") for p in compared]
            return [*columns, number(error, form)]

        return cells(lambda p: p.frequency, "+.3f") + cells(lambda p: 100 * p.damping, "+.1f")

    matrix = {"table": "A1", "command": "A2"}[test]
    columns = ("plant's", *((f"paper's {matrix}",) if is_papers else ()), "error %")
    ordered = sorted([*poles.identified, *missed], key=lambda pole: pole.frequency)
    return Table(
        f"Poles from the {test} test",
        ("", "rad/s", *columns, "damping %", *columns),
        tuple((str(i + 1), *row(pole)) for i, pole in enumerate(ordered)),
    )


def _ambient_table(step: str, found: AmbientResult) -> Table:
    """Modes from ambient vibration with 95 % intervals, and their changes."""
    changes = {mode.after: mode for mode in found.change.modes} if found.change else {}

    def row(mode: PoleInterval) -> tuple[str, ...]:
        cells = (
            f"{mode.frequency:.4f} +- {NORMAL_95 * mode.frequency_deviation:.4f}",
            f"{100 * mode.damping:.3f} +- {100 * NORMAL_95 * mode.damping_deviation:.3f}",
        )
        if found.change is None:
            return cells
        change = changes.get(mode.frequency)
        if change is None:
            return (*cells, "not found before", "", "")
        moved = (f"{100 * change.frequency_change:+.3f}", f"{100 * change.damping_change:+.1f}")
        return (*cells, *moved, f"{change.probability:.2g}")

    header: tuple[str, ...] = ("rad/s", "damping %")
    notes: tuple[str, ...] = ()
    if found.change is not None:
        header += ("frequency, change %", "damping, change %", "by chance")
        notes = ("The building has changed." if found.change.changed else "No change beyond chance.",)
        if not found.change.modes:
            notes = ("No mode is in both tests: nothing can be said of the building.",)
    title = f"Modes from ambient vibration: {step}, {found.seconds:g} s of {', '.join(found.channels)}"
    return Table(title, header, tuple(row(mode) for mode in found.modes), notes)


def _table_1(comparison: ComparedTest, units: Units) -> Table:
    facts = comparison.test
    given = {"measured": comparison.measured, "simulated": comparison.simulated or {}}
    columns: dict[str, Mapping[str, PeakRms | Cells]] = {title: dict(rows) for title, rows in given.items() if rows}
    notes: tuple[str, ...] = ()
    if comparison.is_the_papers:
        columns = {"paper exp.": TABLE_1_EXPERIMENT, "paper sim.": TABLE_1_SIMULATION, **columns}
        errors = {title: error_vs_paper(comparison, rows) for title, rows in given.items() if rows}
        note = "Mean absolute relative error against the paper's experiment, 18 cells: "
        note += ", ".join(f"{title} {number(error, '.3f')}" for title, error in errors.items())
        note += f", the paper's simulation {PAPER_ERROR:.3f}"
        notes = (note, FITTED)
    rows = []
    for name in comparison.measured:
        cells = [column.get(name) for column in columns.values()]
        shown = [units.cell(name, c.peak if c else None) for c in cells]
        rows.append((units.quantity(name), *shown, *(units.cell(name, c.rms if c else None) for c in cells)))
    header = ("", *(f"peak: {name}" if i == 0 else name for i, name in enumerate(columns)))
    header += tuple(f"rms: {name}" if i == 0 else name for i, name in enumerate(columns))
    title = "Table 1" if comparison.is_the_papers else "Peak and rms"
    return Table(
        f"{title}: {facts.controller or 'zero command'}, {units.motion(*facts.motion)}",
        header,
        tuple(rows),
        notes,
    )


def _reduction_table(comparison: ComparedTest, uncontrolled: Mapping[str, Cells], units: Units) -> Table:
    rows = []
    for name, controlled in comparison.measured.items():
        row = [units.quantity(name)]
        for before, after in (
            (uncontrolled[name].peak, controlled.peak),
            (uncontrolled[name].rms, controlled.rms),
        ):
            row += [units.cell(name, before), units.cell(name, after), reduction(before, after)]
        rows.append(tuple(row))
    return Table(
        f"Without and with {comparison.test.controller}: {units.motion(*comparison.test.motion)}",
        ("", "peak: without", "with", "reduction %", "rms: without", "with", "reduction %"),
        tuple(rows),
    )


def _agreement_table(comparison: ComparedTest) -> Table:
    header = ("", "correlation", "rms error / rms", "without sensor noise", *comparison.other_models)
    rows = []
    for channel, row in comparison.simulated_vs_measured.items():
        others = [other.simulated_vs_measured.get(channel) for other in comparison.other_models.values()]
        errors = [row.normalised_rms_error, *(other.noise_free_error if other else None for other in (row, *others))]
        rows.append((channel, f"{row.correlation:.4f}", *(number(error, ".4f") for error in errors)))
    models = {"model": comparison.peak_rms_error}
    models |= {name: other.peak_rms_error for name, other in comparison.other_models.items()}
    means = ", ".join(f"{name} {_percent(error, '.1f')} %" for name, error in models.items())
    notes = [f"Mean error of peaks and rms: {means}"]
    if comparison.validity is not None:
        notes.append(f"Validity: {comparison.validity.verdict.words}: {comparison.validity.meaning}")
    return Table("Simulated by the identified models against measured", header, tuple(rows), tuple(notes))


def _controller_tables(comparisons: Mapping[str, ComparedTest], units: Units) -> list[Table]:
    """For each motion under which several controllers ran on a rig: measured peak and rms, and their reductions.

    Tests of one motion whose tests without control differ have tables of their own, whose titles name the steps.
    """
    motions: dict[tuple[str, str], list[dict[str, ComparedTest]]] = {}
    for step, comparison in comparisons.items():
        if comparison.test.controller and comparison.uncontrolled is not None:
            groups = motions.setdefault((comparison.test.rig, units.motion(*comparison.test.motion)), [])
            same = (one for one in groups if next(iter(one.values())).uncontrolled == comparison.uncontrolled)
            group = next(same, None)
            if group is None:
                groups.append({step: comparison})
            else:
                group[step] = comparison
    several = {key: groups for key, groups in motions.items() if sum(map(len, groups)) > 1}
    rigs = {rig for rig, _ in several}
    found = []
    for (rig, motion), groups in several.items():
        for group in groups:
            title = f"All controllers, {motion}" + (f", rig {rig or 'unknown'}" if len(rigs) > 1 else "")
            title += f", {', '.join(group)}" if len(groups) > 1 else ""
            found += _controllers_beside(title, list(group.values()), units)
    return found


def _controllers_beside(title: str, several: Sequence[ComparedTest], units: Units) -> list[Table]:
    """Measured peak and rms of `several` comparisons with the same test without control, and their reductions."""
    without, names = several[0].uncontrolled or {}, [one.test.controller for one in several]
    found = []
    for key in ("peak", "rms"):
        measured, reductions = [], []
        for row, before in without.items():
            cells = [getattr(one.measured[row], key) for one in several]
            start = getattr(before, key)
            shown = (units.cell(row, cell) for cell in (start, *cells))
            measured.append((units.quantity(row), *shown))
            reductions.append((row, *(reduction(start, cell) for cell in cells)))
        found.append(Table(f"{title}: {key}", ("", "without", *names), tuple(measured)))
        moved = tuple(row for row in reductions if row[0][0] in "xa")
        found.append(Table(f"{title}: reduction of {key}, %", ("", *names), moved))
    return found


def _clipped_rows(comparisons: Mapping[str, ComparedTest]) -> tuple[tuple[str, str], ...]:
    """The tests with readings at the end of a sensor's range, or for which this is unknown."""
    return tuple(
        (f"{step}, {which}", sentence)
        for step, comparison in comparisons.items()
        for which, counts in comparison.clipped.items()
        for sentence in clipped_sentences(counts)
    )


def timing_table(timing: Timing) -> Table:
    """How long each step took, how fast each test went, and what was lost, from the campaign's `timing`."""
    summary = timing_summary(timing)
    speeds = summary["samples_per_second_of_test"]

    losses = [summary[key] for key in ("lost_samples", "missed_deadlines") if not timing.lockstep]

    def row(name: str, seconds: float, speed: float | None) -> tuple[str, ...]:
        counts = [sum(loss.values()) if name == "all" else loss.get(name) for loss in losses]
        return (
            name,
            f"{seconds:.1f}",
            number(speed, ".0f"),
            number(speed and speed / timing.sample_rate, ".2f"),
            *(number(count, "d") for count in counts),
        )

    return Table(
        f"Timing, {'in lockstep' if timing.lockstep else 'in real time'}",
        ("step", "wall s", "samples/s", "x real time", *(("lost samples", "missed deadlines") if losses else ())),
        (
            *(row(step.name, step.wall_seconds, speeds.get(step.name)) for step in timing.steps),
            row("all", summary["total_wall_seconds"], summary["samples_per_second"]),
        ),
    )


def _percent(value: float | None, form: str) -> str:
    return number(None if value is None else 100 * value, form)
