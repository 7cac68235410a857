# SPDX-License-Identifier: Apache-2.0
"""The summary figure of validity: whether the model can be trusted, and if not, why, and what to do."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from abrace_core.figures.drawing import MEASURED, REFERENCE, SIMULATED, captioned, plain_ticks
from abrace_core.model import signals
from abrace_core.model.verdict import Verdict
from abrace_sysid.figures.identification import RIG

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

    from abrace_sysid.validity.finding import Finding, Validity
    from abrace_sysid.validity.residuals import Residual

COLOURS = {Verdict.TRUST: "#2a7f62", Verdict.CARE: "#d08c1d", Verdict.DONT: "#b3261e"}

SHORTEST, LONGEST = 0.01, 1000.0
"""Ends of the bars' axis, as multiples of the limit."""

SMOOTHED = 15
"""Number of lines over which the spectra are averaged."""

WIDTHS = (84, 62)
"""Greatest number of characters in a line of the reasons, and of the advice."""

MOST_LINES = 12
"""Greatest number of text lines below the bars and spectra."""


def validity_figure(validity: Validity, residuals: Sequence[Residual]) -> Figure:
    """Verdict, checks with their limits, spectra of residual and noise, and what to do.

    Parameters
    ----------
    validity
        The findings.
    residuals
        The residual of each test; may be empty.
    """
    shown = list(residuals)[:2]
    figure = Figure(figsize=(11.0, 7.6), layout="constrained")
    parts: Any = figure.subfigures(3, 1, height_ratios=[0.8, 5.0, 2.6])
    top, middle, bottom = parts
    top.set_facecolor(COLOURS[validity.verdict])
    causes = f": {', '.join(validity.causes)}" if validity.causes else ""
    title = f"{validity.verdict.words.capitalize()}{causes}"
    top.text(0.02, 0.5, title, color="white", fontsize=20, fontweight="bold", va="center")
    left = middle
    if shown:
        left, right = middle.subfigures(1, 2, width_ratios=[1.0, 1.1])
        for axis, residual in zip(right.subplots(len(shown), 1, squeeze=False)[:, 0], shown, strict=True):
            _spectra(axis, residual)
    _bars(left.subplots(), validity.worst)
    for place, title, sentences, width in zip(
        (0.02, 0.58), ("Why", "What to do"), _words(validity), WIDTHS, strict=True
    ):
        if sentences:
            bottom.text(place, 0.97, title, fontsize=10, fontweight="bold", va="top")
            bottom.text(place, 0.88, _wrapped(sentences, width), fontsize=8.5, va="top", linespacing=1.3)
    return captioned(figure, "Whether the model can be trusted: each check with its limit, and the model's residual.")


def _bars(axis: Axes, shown: Sequence[Finding]) -> None:
    rows = np.arange(len(shown))
    lengths = np.clip([finding.times_limit for finding in shown], SHORTEST, LONGEST)
    left = SHORTEST / 1.5
    axis.barh(rows, lengths - left, left=left, color=[COLOURS[one.verdict] for one in shown])
    axis.axvline(1.0, color="k", lw=1.2)
    axis.set_xscale("log")
    axis.set_xlim(left, 1.5 * LONGEST)
    plain_ticks(axis.xaxis, SHORTEST, LONGEST)
    axis.set_yticks(rows, [finding.check for finding in shown])
    axis.set_ylim(len(shown) - 0.4, -0.6)
    axis.set_xlabel("value over its limit [-]")
    axis.grid(axis="x", alpha=0.3)


def _spectra(axis: Axes, residual: Residual) -> None:
    """Response, residual and expected noise of the channel with the greatest residual over noise."""
    worst = int(np.argmax(residual.ratio.mean(axis=0)))
    lines, frequency = residual.test, residual.test.omega / (2 * np.pi)

    def level(power: np.ndarray) -> np.ndarray:
        return np.sqrt(np.convolve(power, np.ones(SMOOTHED) / SMOOTHED, "same"))

    axis.semilogy(frequency, level(np.abs(lines.measured[:, worst]) ** 2), color=MEASURED, lw=1.0, label="measured")
    axis.semilogy(frequency, level(np.abs(residual.left[:, worst]) ** 2), color=SIMULATED, lw=1.0, label="residual")
    axis.semilogy(frequency, level(residual.noise[:, worst]), color=REFERENCE, lw=1.4, label="sensor noise")
    axis.set_title(f"{lines.outputs[worst]}, {lines.source}", fontsize="medium", loc="left")
    axis.set_xlabel("frequency [Hz]")
    name, unit = lines.outputs[worst], ""
    if RIG.match(name):
        unit = f" [{signals.unit(name)}" + ("]" if lines.transient else f" / ({signals.unit(lines.inputs[0])})]")
    axis.set_ylabel(f"amplitude at a line{unit}")
    axis.set_xlim(frequency[0], frequency[-1])
    axis.grid(alpha=0.3)
    low, high = axis.get_ylim()
    axis.set_ylim(low, high * (high / low) ** 0.2)  # room for the legend above the curves
    axis.legend(fontsize="small", ncols=3, loc="upper right")


def _words(validity: Validity) -> tuple[Sequence[str], Sequence[str]]:
    if not validity.verdict:
        return ["Every check is within its limit: the model holds for motions like those of its tests."], []
    unchecked = [f"not checked: {check}: {why}" for check, why in validity.not_checked.items()]
    reasons = [reason.meaning for reason in sorted(validity.reasons, key=lambda reason: not reason.advice)]
    return [*reasons, *unchecked], validity.advice


def _wrapped(sentences: Sequence[str], width: int) -> str:
    lines: list[str] = []
    for sentence in sentences:
        lines += textwrap.wrap(sentence, width, initial_indent="- ", subsequent_indent="  ")
    return "\n".join(lines if len(lines) <= MOST_LINES else [*lines[: MOST_LINES - 1], "- more in validity.json"])
