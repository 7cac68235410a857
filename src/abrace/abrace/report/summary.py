# SPDX-License-Identifier: Apache-2.0
"""summary.json: what the steps of a campaign measured, in numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from abrace.report.events import events
from abrace_core.model.modes import nearest_mode
from abrace_core.model.response import TABLE_1_EXPERIMENT, PeakRms, mean_relative_error, shown_unit
from abrace_core.model.verdict import nan_last

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from abrace.report.results import AllPoles, Cells, ComparedTest, Poles, Results, Timing
    from abrace.report.units import Units
    from abrace_sysid.fitting.pole_estimate import PoleInterval


def summarise(results: Results, units: Units) -> dict[str, Any]:
    """The content of summary.json from the `results` of a campaign, in these `units`."""
    summary: dict[str, Any] = {"timing": timing_summary(results.timing), "happened": events(results.timing)}
    if results.timing.failed is not None:
        summary["failed"] = results.timing.failed.model_dump()
    if results.poles is not None:
        summary["poles"] = {
            test: poles.model_dump(by_alias=True)
            | {
                "largest_relative_error": {
                    "frequency": _largest_error(poles, "frequency"),
                    "damping_ratio": _largest_error(poles, "damping"),
                }
            }
            for test, poles in poles_by_test(results.poles)
        }
    if results.validity:
        summary["validity"] = {
            step: {"verdict": one.verdict.words, "causes": list(one.causes)} for step, one in results.validity.items()
        }
    if results.ambient:
        summary["ambient"] = {step: one.model_dump() for step, one in results.ambient.items()}
    if results.main is not None:
        summary |= _comparison(results.main, units)
        summary["comparisons"] = {step: _comparison(one, units) for step, one in results.comparisons.items()}
    return summary


def _comparison(comparison: ComparedTest, units: Units) -> dict[str, Any]:
    return {
        "test": comparison.test.model_dump(),
        "units": {name: shown_unit(name, units.system)[1] for name in comparison.measured},
        "table1": {
            "measured": units.numbers(comparison.measured),
            "simulated": units.numbers(comparison.simulated) if comparison.simulated else None,
            "error_vs_paper_experiment": error_vs_paper(comparison, comparison.measured),
            "simulated_error_vs_paper_experiment": error_vs_paper(comparison, comparison.simulated),
        },
        "uncontrolled": units.numbers(comparison.uncontrolled) if comparison.uncontrolled else None,
        "clipped": comparison.clipped,
        **comparison.model_dump(include={"simulated_vs_measured", "peak_rms_error", "other_models"}),
    }


def poles_by_test(poles: AllPoles) -> tuple[tuple[str, Poles], tuple[str, Poles]]:
    """The `poles` of each test with the name of the test."""
    return ("table", poles.table), ("command", poles.command)


def error_vs_paper(comparison: ComparedTest, rows: Mapping[str, Cells] | None) -> float | None:
    """Mean relative error of `rows` of a `comparison` to Table 1's experiment; None: of another test, or some lack."""
    if not comparison.is_the_papers or rows is None:
        return None
    known = {
        name: PeakRms(row.peak, row.rms) for name, row in rows.items() if row.peak is not None and row.rms is not None
    }
    return mean_relative_error(known, TABLE_1_EXPERIMENT) if set(TABLE_1_EXPERIMENT) <= set(known) else None


def timing_summary(timing: Timing) -> dict[str, Any]:
    """Wall times of the steps and speeds of the tests, from the campaign's `timing`."""
    tests = [(step.name, step.samples, step.run_seconds) for step in timing.steps if step.samples and step.run_seconds]
    samples, seconds = sum(test[1] for test in tests), sum(test[2] for test in tests)
    return {
        "lockstep": timing.lockstep,
        "sample_rate": timing.sample_rate,
        "wall_seconds": {step.name: step.wall_seconds for step in timing.steps},
        "total_wall_seconds": sum(step.wall_seconds for step in timing.steps),
        "samples_per_second_of_test": {name: count / run_seconds for name, count, run_seconds in tests},
        "samples_per_second": samples / seconds if tests else None,
        "real_time_factor": samples / seconds / timing.sample_rate if tests else None,
        **{
            key: {step.name: getattr(step, key) for step in timing.steps if getattr(step, key) is not None}
            for key in ("lost_samples", "missed_deadlines")
            if not timing.lockstep
        },
    }


def nearest_pole(poles: Sequence[PoleInterval], frequency: float) -> PoleInterval | None:
    """The one of `poles` that is nearest to a `frequency` [rad/s]; None where none is near enough to be the same."""
    nearest = nearest_mode([pole.frequency for pole in poles], frequency)
    return None if nearest is None else poles[nearest]


def _largest_error(poles: Poles, key: str) -> float | None:
    """Largest relative error of the identified poles against the true ones; None if a true pole was not identified."""
    pairs = [(nearest_pole(poles.identified, true.frequency), true) for true in poles.true]
    errors = [abs(getattr(found, key) / getattr(true, key) - 1) for found, true in pairs if found is not None]
    return max(errors, key=nan_last) if errors and len(errors) == len(pairs) else None
