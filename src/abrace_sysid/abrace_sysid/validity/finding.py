# SPDX-License-Identifier: Apache-2.0
"""The finding of a check, as numbers and text, and the verdict over all findings."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from math import inf, isfinite, nan
from typing import TYPE_CHECKING, Annotated, Any

import pydantic

from abrace_core.files.config_file import Number  # noqa: TC001  pydantic reads it
from abrace_core.model.verdict import Verdict, judged

if TYPE_CHECKING:
    from collections.abc import Mapping


def _of_words(verdict: Any) -> Any:
    found = {each.words: each for each in Verdict}.get(verdict, verdict)
    if not isinstance(found, Verdict):
        raise ValueError(" or ".join(repr(each.words) for each in Verdict))
    return found


WORDS = pydantic.WithJsonSchema({"type": "string", "enum": [each.words for each in Verdict]})
InWords = Annotated[Verdict, pydantic.BeforeValidator(_of_words), WORDS]
"""A verdict, in files as text."""
OrNull = Annotated[str, pydantic.BeforeValidator(lambda given: given or "")]
"""In files null where it is empty."""


@dataclass(frozen=True)
class Finding:
    """What one check found; `content` is it in a file, which pydantic reads back.

    Parameters
    ----------
    where
        Channel, storey or mode, and the test.
    value, limit
        The value found, and the value above which the model is to be used with care; in `unit`. A value that is not a
        number: nothing could be judged.
    unit
        Unit of both; empty for ratios.
    verdict
        Verdict on the model from this check alone; never "trust" where the value is not finite.
    cause
        Name of the suspected fault; empty if there is none, as advice is, with the verdict "trust".
    meaning
        What was found, as a sentence.
    advice
        What to do, as a sentence; empty if nothing needs to be done.
    """

    check: str
    where: str
    value: Number
    limit: float
    unit: str
    verdict: InWords
    cause: OrNull
    meaning: str
    advice: str

    def __post_init__(self) -> None:
        if not isfinite(self.value):
            object.__setattr__(self, "verdict", max(self.verdict, judged(self.value, self.limit), Verdict.CARE))
        if self.verdict is Verdict.TRUST:
            object.__setattr__(self, "cause", "")
            object.__setattr__(self, "advice", "")

    @classmethod
    def of(
        cls,
        check: str,
        where: str,
        value: float,
        limits: tuple[float, ...],
        meaning: str,
        cause: str = "",
        advice: str = "",
        unit: str = "",
        verdict: Verdict | None = None,
    ) -> Finding:
        """The finding on a `value`: "trust with care" above the first of its `limits`, "don't trust" above the second.

        `verdict`: one that the value alone does not decide; the rest as in `Finding`.
        """
        verdict = judged(value, *limits) if verdict is None else verdict
        return cls(check, where, value, limits[0], unit, verdict, cause, meaning, advice)

    @property
    def times_limit(self) -> float:
        """The value over its limit; 0 or infinite, by the verdict, where the limit is 0 or the value not finite."""
        if self.limit <= 0 or not isfinite(self.value):
            return inf if self.verdict else 0.0
        return self.value / self.limit

    @property
    def content(self) -> dict[str, Any]:
        """For a JSON file."""
        value = self.value if isfinite(self.value) else None
        return {**asdict(self), "value": value, "verdict": self.verdict.words, "cause": self.cause or None}


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
        """The verdict of the worst finding; "trust with care" if nothing was checked."""
        return max((finding.verdict for finding in self.findings), default=Verdict.CARE)

    @property
    def worst(self) -> tuple[Finding, ...]:
        """The worst finding of each check, in the order of the checks."""
        found: dict[str, Finding] = {}
        for one in self.findings:
            before = found.get(one.check)
            if before is None or (one.verdict, one.times_limit) > (before.verdict, before.times_limit):
                found[one.check] = one
        return tuple(found.values())

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


MISSED = (0.03, 0.3)
"""Limits of the worst channel's rms error, sensor noise subtracted, over the measured rms: "trust with care" above the
first, "don't trust" above the second."""


def prediction_finding(errors: Mapping[str, float], reasons: Mapping[str, str]) -> Finding:
    """The finding on a test that a model has predicted.

    Parameters
    ----------
    errors
        Rms error of each channel, sensor noise subtracted, over the measured rms; NaN: the channel cannot be judged,
        and the verdict is "trust with care" at best.
    reasons
        What is wrong with each channel that cannot be judged or did not move.
    """
    finite = {name: error for name, error in errors.items() if isfinite(error)}
    unjudged = [name for name in errors if name not in finite]
    worst = max(finite, key=lambda name: finite[name], default="")
    error, where, said = finite.get(worst, nan), worst, []
    verdict = judged(error, *MISSED)
    if worst in reasons:
        where = ", ".join(name for name in finite if reasons.get(name) == reasons[worst])
        said.append(f"{where} {reasons[worst]}")
    elif finite:
        said.append(f"the worst predicted channel is {worst}: {100 * error:.2g} % off beyond its sensor's noise")
    if unjudged:
        said.append(f"not judged: {', '.join(f'{name} {reasons[name]}' for name in unjudged)}")
        if verdict is Verdict.TRUST or not finite:
            verdict, where = Verdict.CARE, ", ".join(unjudged)
    faulty = [name for name in errors if name in reasons]
    advice = "See validity.svg of the identification for what the model does not contain" if verdict else ""
    if faulty:
        advice = f"Check sensor, cable and channel of {', '.join(faulty)}, here and in the tests of the identification"
    meaning = "; ".join(said) or "no channel was predicted"
    return Finding.of("prediction", where, error, MISSED, meaning, "", advice, verdict=verdict)
