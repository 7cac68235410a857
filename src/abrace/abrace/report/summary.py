# SPDX-License-Identifier: Apache-2.0
"""summary.json: what the steps of a campaign measured, in numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from abrace.report.happenings import happenings
from abrace_core.response import TABLE_1_EXPERIMENT, PeakRms, mean_relative_error, shown_unit

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pydantic

    from abrace.report.results import AllPoles, Cells, Comparison, Pole, Poles, Results, Timing
    from abrace.report.units import Units

SAME_POLE = 0.05
"""Relative difference in frequency within which two poles count as the same."""


def summarise(results: Results, units: Units) -> dict[str, Any]:
    """The content of summary.json from the `results` of a campaign, in these `units`."""
    summary: dict[str, Any] = {"timing": timing_summary(results.timing), "happened": happenings(results.timing)}
    if results.timing.failed is not None:
        summary["failed"] = results.timing.failed.model_dump()
    if results.poles is not None:
        summary["poles"] = {
            test: poles.model_dump()
            | {
                "largest_relative_error": {
                    "frequency": _largest_error(poles, "frequency"),
                    "damping_ratio": _largest_error(poles, "damping_ratio"),
                }
            }
            for test, poles in poles_by_test(results.poles)
        }
    if results.validity:
        summary["validity"] = {
            step: {"verdict": one.verdict, "causes": list(one.causes)} for step, one in results.validity.items()
        }
    if results.ambient:
        summary["ambient"] = _dumped(results.ambient)
    if results.main is not None:
        summary |= _comparison(results.main, units)
        summary["comparisons"] = {step: _comparison(one, units) for step, one in results.comparisons.items()}
    return summary


def _comparison(comparison: Comparison, units: Units) -> dict[str, Any]:
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
        "simulated_vs_measured": _dumped(comparison.simulated_vs_measured),
        "peak_rms_error": comparison.peak_rms_error,
        "other_models": _dumped(comparison.other_models),
    }


def _dumped(rows: Mapping[str, pydantic.BaseModel]) -> dict[str, Any]:
    return {name: row.model_dump() for name, row in rows.items()}


def poles_by_test(poles: AllPoles) -> tuple[tuple[str, Poles], tuple[str, Poles]]:
    """The `poles` of each test with the name of the test."""
    return ("table", poles.table), ("command", poles.command)


def error_vs_paper(comparison: Comparison, rows: Mapping[str, Cells] | None) -> float | None:
    """Mean relative error of the `rows` of a `comparison` to Table 1's experiment; None where it is of another test."""
    if not comparison.is_the_papers or rows is None:
        return None
    return mean_relative_error({name: PeakRms(row.peak, row.rms) for name, row in rows.items()}, TABLE_1_EXPERIMENT)


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


def nearest_pole(poles: Sequence[Pole], frequency: float) -> Pole | None:
    """The one of `poles` that is nearest to a `frequency` [rad/s]; None where none is near enough to be the same."""
    nearest = min(poles, key=lambda pole: abs(pole.frequency - frequency), default=None)
    return nearest if nearest and abs(nearest.frequency - frequency) <= SAME_POLE * frequency else None


def _largest_error(poles: Poles, key: str) -> float | None:
    """Largest relative error of the identified poles against the true ones; None if a true pole was not identified."""
    pairs = [(nearest_pole(poles.identified, true.frequency), true) for true in poles.true]
    errors = [abs(getattr(found, key) / getattr(true, key) - 1) for found, true in pairs if found is not None]
    return max(errors) if errors and len(errors) == len(pairs) else None


def worst_peak_rms_error(comparison: Comparison) -> float:
    """Greatest relative error of a simulated peak or rms value, of the channels that move.

    Parameters
    ----------
    comparison
        Of a validate step, with a model.
    """
    simulated = comparison.simulated or {}
    return max(
        abs(getattr(simulated[name], key) / getattr(comparison.measured[name], key) - 1)
        for name in comparison.simulated_vs_measured
        for key in ("peak", "rms")
    )
