# SPDX-License-Identifier: Apache-2.0
"""The finding of a check, as numbers and text, and the verdict over all findings."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import IntEnum
from typing import Any


class Verdict(IntEnum):
    """How far a model can be trusted."""

    TRUST = 0
    CARE = 1
    DONT = 2

    @property
    def words(self) -> str:
        """The verdict as text, in files and on the terminal."""
        return ("trust", "trust with care", "don't trust")[self]


@dataclass(frozen=True)
class Finding:
    """What one check found.

    Parameters
    ----------
    check
        Name of the check.
    where
        Channel, storey or mode, and the test.
    value, limit
        The value found, and the value above which the model is to be used with care; in `unit`.
    unit
        Unit of both; empty for ratios.
    verdict
        Verdict on the model from this check alone.
    cause
        Name of the suspected fault; empty if there is none.
    meaning
        What was found, as a sentence.
    advice
        What to do, as a sentence; empty if nothing needs to be done.
    """

    check: str
    where: str
    value: float
    limit: float
    unit: str
    verdict: Verdict
    cause: str
    meaning: str
    advice: str

    @property
    def content(self) -> dict[str, Any]:
        """For a JSON file."""
        return {**asdict(self), "verdict": self.verdict.words, "cause": self.cause or None}


@dataclass(frozen=True)
class Validity:
    """All findings on one identification.

    Parameters
    ----------
    findings
        The findings of all checks that could be made.
    not_checked
        The checks that could not be made, with the reason.
    """

    findings: tuple[Finding, ...]
    not_checked: dict[str, str]

    @property
    def verdict(self) -> Verdict:
        """The verdict of the worst finding."""
        return max((finding.verdict for finding in self.findings), default=Verdict.TRUST)

    @property
    def reasons(self) -> tuple[Finding, ...]:
        """The findings beyond their limits, the worst verdict first."""
        found = [finding for finding in self.findings if finding.verdict]
        return tuple(sorted(found, key=lambda finding: (-finding.verdict, not finding.cause)))

    @property
    def causes(self) -> tuple[str, ...]:
        """The suspected faults, each once, those of the worst verdict first."""
        return tuple(dict.fromkeys(finding.cause for finding in self.reasons if finding.cause))

    @property
    def content(self) -> dict[str, Any]:
        """For a JSON file."""
        return {
            "verdict": self.verdict.words,
            "causes": list(self.causes),
            "findings": [finding.content for finding in self.findings],
            "not_checked": self.not_checked,
        }

    @property
    def advice(self) -> tuple[str, ...]:
        """What to do, each sentence once."""
        return tuple(dict.fromkeys(reason.advice for reason in self.reasons if reason.advice))

    def text(self) -> str:
        """A few lines for a terminal: the verdict, the findings beyond their limits, and what to do."""
        lines = [f"validity: {self.verdict.words}" + (f" ({', '.join(self.causes)})" if self.causes else "")]
        lines += [f"  {reason.meaning}" for reason in self.reasons if reason.advice]
        follows = [reason.meaning for reason in self.reasons if not reason.advice]
        lines += [f"  {meaning}" for meaning in follows[:1]]
        lines += [f"  and {len(follows) - 1} findings like it in validity.json" for _ in follows[1:2]]
        lines += [f"  what to do: {sentence}" for sentence in self.advice]
        return "\n".join([*lines, *(f"  not checked: {check}: {why}" for check, why in self.not_checked.items())])


def judged(value: float, care: float, dont: float | None = None) -> Verdict:
    """The verdict on a `value`: "trust with care" above `care`, and "don't trust" above `dont`, if that is given."""
    if dont is not None and value > dont:
        return Verdict.DONT
    return Verdict.CARE if value > care else Verdict.TRUST
