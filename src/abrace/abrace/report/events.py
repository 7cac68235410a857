# SPDX-License-Identifier: Apache-2.0
"""Texts for the events in the tests of a campaign: those that make a test untrustworthy, and those for information."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from abrace.report.table import Table
from abrace_core.model.response import clipped_sentences

if TYPE_CHECKING:
    from abrace.report.results import StepTiming, Timing

WARNINGS = {
    "lost_samples": "not in the bag",
    "table_limited": "with a ground motion cut to what the table can do",
    "stop_pressed": "with a stop pressed",
}
"""Counts of samples that make a test untrustworthy."""
REMARKS = {
    "saturated": "with a command cut to the capacity",
    "rate_limited": "with a force held back by the rate limit",
    "late": "taken late",
    "missed_deadlines": "answered too late to act from the next one on",
}
"""Counts of samples that are correctly recorded, and may have been intended."""


def _sentences(step: StepTiming, counted: dict[str, str]) -> list[str]:
    counts = [(getattr(step, key) or 0, what) for key, what in counted.items()]
    return [f"{count} sample{'s' if count > 1 else ''} {what}" for count, what in counts if count]


def _untrusted(step: StepTiming) -> list[str]:
    return [*clipped_sentences(step.clipped), *_sentences(step, WARNINGS)]


def warnings_of(timing: Timing) -> list[str]:
    """Why tests cannot be trusted, from the campaign's `timing`; empty: all are."""
    return [f"{step.name}: {sentence}" for step in timing.steps for sentence in _untrusted(step)]


def events(timing: Timing) -> dict[str, dict[str, Any]]:
    """By test, deviations from the request, counted in samples, from the campaign's `timing`."""
    names = {"clipped", *WARNINGS, *REMARKS}
    counts = {step.name: step.model_dump(include=names) for step in timing.steps}
    return {name: found for name, all_ in counts.items() if (found := {key: n for key, n in all_.items() if n})}


def events_table(timing: Timing) -> Table | None:
    """Deviations of the tests from the request, from the campaign's `timing`; None: no deviation."""
    rows: list[tuple[str, str, str]] = []
    for step in timing.steps:
        rows += [(step.name, sentence, "no") for sentence in _untrusted(step)]
        rows += [(step.name, sentence, "yes") for sentence in _sentences(step, REMARKS)]
    if timing.failed is not None:
        rows.append((timing.failed.step, f"failed: {timing.failed.cause}", "no"))
    return Table("What happened in the tests", ("test", "", "to be trusted"), tuple(rows)) if rows else None
