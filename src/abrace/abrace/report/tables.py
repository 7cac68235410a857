"""The tables of a campaign: poles, Table 1, without and with control, simulated against measured, timing."""

from __future__ import annotations

from typing import TYPE_CHECKING, get_args

from abrace.report.results import (
    AmbientMode,
    AmbientResult,
    Cells,
    Comparison,
    Facts,
    Pole,
    Poles,
    Results,
    Timing,
    ValidityFinding,
    ValidityResult,
    VerdictWords,
)
from abrace.report.summary import error_vs_paper, nearest_pole, poles_by_test, timing_summary, worst_peak_rms_error
from abrace.report.table import Table
from abrace_core.response import (
    TABLE_1_EXPERIMENT,
    TABLE_1_SIMULATION,
    PeakRms,
    clipped_sentences,
    mean_relative_error,
    paper_unit,
)
from abrace_plant.rig.published import PAPER_POLES
from abrace_sysid.fitting.pole_estimate import NORMAL_95

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

PAPER_ERROR = mean_relative_error(TABLE_1_SIMULATION, TABLE_1_EXPERIMENT)
VERDICTS = get_args(VerdictWords)
FITTED = (
    "LQG3's five weights were fitted to these 18 cells: the error is that of a fit, the table of models below is not"
)


def tables(results: Results) -> list[Table]:
    """Poles, validity, Table 1, without and with control, simulated against measured, timing: what the results have."""
    found = []
    if results.poles is not None:
        found += [_pole_table(test, poles) for test, poles in poles_by_test(results.poles)]
    found += [_validity_table(step, one) for step, one in results.validity.items()]
    found += [_ambient_table(step, one) for step, one in results.ambient.items()]
    if results.main is not None:
        found.append(_table_1(results.main))
        if results.main.uncontrolled is not None:
            found.append(_reduction_table(results.main, results.main.uncontrolled))
        if results.main.simulated_vs_measured:
            found.append(_agreement_table(results.main))
    if len(results.comparisons) > 1:
        found += _controller_tables(results.comparisons)
    predicted = {step: one for step, one in results.comparisons.items() if one.simulated_vs_measured}
    if len(predicted) > 1:
        found.append(_all_agreements_table(predicted))
    clipped = _clipped_rows(results.comparisons)
    if clipped:
        found.append(Table("At the end of a sensor's range", ("test", ""), clipped))
    return [*found, _timing_table(results.timing)]


def _validity_table(step: str, validity: ValidityResult) -> Table:
    """The verdict, each check's worst finding, and what to do."""
    worst: dict[str, ValidityFinding] = {}
    for finding in validity.findings:
        before = worst.get(finding.check)
        rank = VERDICTS.index(finding.verdict), finding.value
        if before is None or rank > (VERDICTS.index(before.verdict), before.value):
            worst[finding.check] = finding
    rows = tuple((one.check, f"{one.value:.2g}", f"{one.limit:.2g}", one.verdict, one.where) for one in worst.values())
    causes = f": {', '.join(validity.causes)}" if validity.causes else ""
    reasons = [finding for finding in validity.findings if finding.cause is not None]
    notes = dict.fromkeys([*(one.meaning for one in reasons), *(one.advice for one in reasons if one.advice)])
    title = f"Validity of {step}: {validity.verdict}{causes}"
    return Table(title, ("check", "found", "limit", "verdict", "where"), rows, tuple(notes))


def _pole_table(test: str, poles: Poles) -> Table:
    paper = [Pole(frequency=abs(p), damping_ratio=-p.real / abs(p)) for p in PAPER_POLES[test]]
    missed = [true for true in poles.true if nearest_pole(poles.identified, true.frequency) is None]

    def row(pole: Pole) -> list[str]:
        found = None if pole in missed else pole
        true, papers = nearest_pole(poles.true, pole.frequency), nearest_pole(paper, pole.frequency)

        def cells(quantity: Callable[[Pole], float], form: str) -> list[str]:
            error = 100 * (quantity(found) / quantity(true) - 1) if found and true else None
            columns = [_number(quantity(p) if p else None, ".3f") for p in (found, true, papers)]
            return [*columns, _number(error, form)]

        return cells(lambda p: p.frequency, "+.3f") + cells(lambda p: 100 * p.damping_ratio, "+.1f")

    matrix = {"table": "A1", "command": "A2"}[test]
    columns = ("plant's", f"paper's {matrix}", "error %")
    ordered = sorted([*poles.identified, *missed], key=lambda pole: pole.frequency)
    return Table(
        f"Poles from the {test} test",
        ("", "rad/s", *columns, "damping %", *columns),
        tuple((str(i + 1), *row(pole)) for i, pole in enumerate(ordered)),
    )


def _ambient_table(step: str, found: AmbientResult) -> Table:
    """Modes without a drive with 95 % intervals, and how they have changed."""
    changes = {mode.after: mode for mode in found.change.modes} if found.change else {}

    def row(mode: AmbientMode) -> tuple[str, ...]:
        cells = (
            f"{mode.frequency:.4f} +- {NORMAL_95 * mode.frequency_deviation:.4f}",
            f"{100 * mode.damping_ratio:.3f} +- {100 * NORMAL_95 * mode.damping_ratio_deviation:.3f}",
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
    title = f"Modes without a drive: {step}, {found.seconds:g} s of {', '.join(found.channels)}"
    return Table(title, header, tuple(row(mode) for mode in found.modes), notes)


def _table_1(comparison: Comparison) -> Table:
    facts = comparison.test
    given = {"measured": comparison.measured, "simulated": comparison.simulated or {}}
    columns: dict[str, Mapping[str, PeakRms]] = {
        title: {name: PeakRms(row.peak, row.rms) for name, row in rows.items()} for title, rows in given.items() if rows
    }
    notes: tuple[str, ...] = ()
    if comparison.is_the_papers:
        columns = {"paper exp.": TABLE_1_EXPERIMENT, "paper sim.": TABLE_1_SIMULATION, **columns}
        errors = {title: error_vs_paper(comparison, rows) for title, rows in given.items() if rows}
        note = "Mean absolute relative error against the paper's experiment, 18 cells: "
        note += ", ".join(f"{title} {error or 0.0:.3f}" for title, error in errors.items())
        note += f", the paper's simulation {PAPER_ERROR:.3f}"
        notes = (note, FITTED)
    rows = []
    for name in comparison.measured:
        cells = [column.get(name) for column in columns.values()]
        peaks, rms = [_cell(name, c and c.peak) for c in cells], [_cell(name, c and c.rms) for c in cells]
        rows.append((_quantity(name), *peaks, *rms))
    header = ("", *(f"peak: {name}" if i == 0 else name for i, name in enumerate(columns)))
    header += tuple(f"rms: {name}" if i == 0 else name for i, name in enumerate(columns))
    return Table(f"Table 1: {facts.controller}, {_motion(facts)}", header, tuple(rows), notes)


def _reduction_table(comparison: Comparison, uncontrolled: Mapping[str, Cells]) -> Table:
    rows = []
    for name, controlled in comparison.measured.items():
        row = [_quantity(name)]
        for before, after in (
            (uncontrolled[name].peak, controlled.peak),
            (uncontrolled[name].rms, controlled.rms),
        ):
            reduction = _number(100 * (1 - after / before) if before else None, ".1f")
            row += [_cell(name, before), _cell(name, after), reduction]
        rows.append(tuple(row))
    return Table(
        f"Without and with {comparison.test.controller}: {_motion(comparison.test)}",
        ("", "peak: without", "with", "reduction %", "rms: without", "with", "reduction %"),
        tuple(rows),
    )


def _agreement_table(comparison: Comparison) -> Table:
    header = ("", "correlation", "rms error / rms", "without sensor noise", *comparison.other_models)
    rows = []
    for channel, row in comparison.simulated_vs_measured.items():
        others = [other.simulated_vs_measured[channel].noise_free_error for other in comparison.other_models.values()]
        errors = (row.normalised_rms_error, row.noise_free_error, *others)
        rows.append((channel, f"{row.correlation:.4f}", *(f"{error:.4f}" for error in errors)))
    models = {"model": comparison.peak_rms_error or 0.0}
    models |= {name: other.peak_rms_error for name, other in comparison.other_models.items()}
    means = ", ".join(f"{name} {100 * error:.1f} %" for name, error in models.items())
    notes = [f"Mean error of peaks and rms: {means}"]
    if comparison.validity is not None:
        notes.append(f"Validity: {comparison.validity.verdict}: {comparison.validity.meaning}")
    return Table("Simulated by the identified models against measured", header, tuple(rows), tuple(notes))


def _controller_tables(comparisons: Mapping[str, Comparison]) -> list[Table]:
    """For each motion under which several controllers ran: measured peak and rms, and their reductions."""
    motions: dict[str, list[Comparison]] = {}
    for comparison in comparisons.values():
        if comparison.test.controller and comparison.uncontrolled is not None:
            motions.setdefault(_motion(comparison.test), []).append(comparison)
    found = []
    for motion, several in motions.items():
        if len(several) < 2:
            continue
        without, names = several[0].uncontrolled or {}, [one.test.controller for one in several]
        for key in ("peak", "rms"):
            measured, reductions = [], []
            for row, before in without.items():
                cells = [getattr(one.measured[row], key) for one in several]
                start = getattr(before, key)
                measured.append((_quantity(row), _cell(row, start), *(_cell(row, cell) for cell in cells)))
                less = [_number(100 * (1 - cell / start) if start else None, ".1f") for cell in cells]
                reductions.append((row, *less))
            found.append(Table(f"All controllers, {motion}: {key}", ("", "without", *names), tuple(measured)))
            moved = tuple(row for row in reductions if row[0][0] in "xa")
            found.append(Table(f"All controllers, {motion}: reduction of {key}, %", ("", *names), moved))
    return found


def _all_agreements_table(comparisons: Mapping[str, Comparison]) -> Table:
    """Every comparison's worst figures, one row each."""
    rows = []
    for step, comparison in comparisons.items():
        worst = min(row.correlation for row in comparison.simulated_vs_measured.values())
        error = max(row.noise_free_error for row in comparison.simulated_vs_measured.values())
        others = (f"{100 * other.peak_rms_error:.2f}" for other in comparison.other_models.values())
        peaks = worst_peak_rms_error(comparison)
        rows.append(
            (
                step,
                f"{worst:.4f}",
                *(f"{100 * x:.2f}" for x in (error, comparison.peak_rms_error or 0.0, peaks)),
                *others,
            )
        )
    other_models = next(iter(comparisons.values())).other_models
    return Table(
        "Simulated against measured, every test",
        (
            "",
            "least correlation",
            "greatest rms error %",
            "peaks and rms: mean error %",
            "greatest %",
            *(f"mean, {name} %" for name in other_models),
        ),
        tuple(rows),
        ("Rms errors without sensor noise.",),
    )


def _clipped_rows(comparisons: Mapping[str, Comparison]) -> tuple[tuple[str, str], ...]:
    """The tests of which some reading is at the end of its range, or of which nobody knows."""
    return tuple(
        (f"{step}, {which}", sentence)
        for step, comparison in comparisons.items()
        for which, counts in comparison.clipped.items()
        for sentence in clipped_sentences(counts)
    )


def _timing_table(timing: Timing) -> Table:
    summary = timing_summary(timing)
    speeds = summary["samples_per_second_of_test"]

    losses = [summary[key] for key in ("lost_samples", "missed_deadlines") if not timing.lockstep]

    def row(name: str, seconds: float, speed: float | None) -> tuple[str, ...]:
        counts = [sum(loss.values()) if name == "all" else loss.get(name) for loss in losses]
        return (
            name,
            f"{seconds:.1f}",
            _number(speed, ".0f"),
            _number(speed and speed / timing.sample_rate, ".2f"),
            *(_number(count, "d") for count in counts),
        )

    return Table(
        f"Timing, {'in lockstep' if timing.lockstep else 'in real time'}",
        ("step", "wall s", "samples/s", "x real time", *(("lost samples", "missed deadlines") if losses else ())),
        (
            *(row(step.name, step.wall_seconds, speeds.get(step.name)) for step in timing.steps),
            row("all", summary["total_wall_seconds"], summary["samples_per_second"]),
        ),
    )


def _motion(facts: Facts) -> str:
    return facts.record + (f" at {facts.peak_acceleration / 9.80665:.3g} g" if facts.peak_acceleration else "")


def _quantity(name: str) -> str:
    return f"{name} [{paper_unit(name)[1]}]"


def _cell(name: str, value: float | None) -> str:
    return _number(value, {"cm": ".3f", "g": ".4f", "kgf": ".1f"}[paper_unit(name)[1]])


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
