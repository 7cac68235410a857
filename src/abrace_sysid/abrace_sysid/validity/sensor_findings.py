# SPDX-License-Identifier: Apache-2.0
"""Findings on channels: dead, saturated, with spikes, swapped, late, in a wrong unit or with a wrong sign."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from abrace_core import signals
from abrace_core.run import Run
from abrace_sysid.recordings import at_extremes
from abrace_sysid.spectra.fourier import held_input
from abrace_sysid.validity.finding import Finding, Verdict, judged
from abrace_sysid.validity.kinematics import CONTRADICTION, Change, kinematics
from abrace_sysid.validity.spikes import reversals_with_play, spikes

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from abrace_sysid.measured_data import MeasuredData
    from abrace_sysid.validity.kinematics import Kinematics
    from abrace_sysid.validity.motion import Motion

WRONG = ("swapped sensors", "wrong unit", "wrong sign")
"""Faults of channels with which the equations of floors and braces do not hold."""

SATURATED = (0.0, 0.02)
"""Limits of the share of a channel's samples at the end of its range: "trust with care" above the first, "don't trust"
above the second."""

SPIKED = (0.0, 0.02)
"""Limits, likewise, of the power of spikes over that of the channel."""

LATE = (0.0015, 0.01)
"""Limits, likewise, of the time [s] between two sensors of a floor; with the filters and transducers of the rig
`ncree_as_a_rig` it is 0.0007 s."""


def dead(run: Run | MeasuredData, inputs: Sequence[str], reasons: Mapping[str, str]) -> list[Finding]:
    """A finding for each channel of a test that does not respond; a single one if all respond.

    Parameters
    ----------
    run
        The test.
    inputs
        Names of the excited inputs. If no channel responds to the table's acceleration, that channel itself is dead.
    reasons
        Why each channel is dead, by name (`recordings.dead_channels`).
    """
    check, advice = "channels respond", "Check sensor, cable and channel number, and repeat the test"
    if len(reasons) == len(run.names) and inputs == (signals.GROUND,):
        reasons = {signals.GROUND: "no channel answers to it"}
    if not reasons:
        return [Finding(check, run.source, 0.0, 0.0, "channels", Verdict.TRUST, "", "every channel answers", "")]
    return [
        Finding(
            check,
            f"{name}, {run.source}",
            1.0,
            0.0,
            "channels",
            Verdict.CARE,
            "dead channel",
            f"{name} is dead in {run.source}: {reason}; no model has it",
            advice,
        )
        for name, reason in reasons.items()
    ]


def saturated(run: Run, inputs: Sequence[str], without: Sequence[str], period: int | None) -> list[Finding]:
    """A finding for each channel of a test that reaches the end of its range; a single one if none does.

    Parameters
    ----------
    run
        The test.
    inputs
        Names of the excited inputs.
    without
        Names of channels that do not respond.
    period
        Samples in a period of a multisine; None: noise.
    """
    flags = run.clipped_samples or {}
    counts = {}
    for name in (*run.names, signals.GROUND, *run.command_names):
        values = held_input(run, name)
        middle = len(values) // 2
        # each period of a multisine reaches its peak once
        count = 0 if name in without else at_extremes(values if period is None else values[middle : middle + period])
        # a group's force is the mean of its load cells, fa, fb, ...
        counts[name] = count or sum(number for flag, number in flags.items() if flag in (name, name + flag[-1]))
    return at_ends(run.source, counts, len(run.outputs) if period is None else period, inputs)


def at_ends(source: str, counts: Mapping[str, int], samples: int, inputs: Sequence[str]) -> list[Finding]:
    """A finding for each channel that reaches the end of its range; a single one if none does.

    Parameters
    ----------
    source
        Name of the test.
    counts
        Number of samples at the extremes, by channel.
    samples
        Number of samples of the test.
    inputs
        Names of the excited inputs.
    """
    check = "within the range"
    found = [(count / samples, name, count) for name, count in counts.items() if count]
    if not found:
        return [Finding(check, source, 0.0, SATURATED[0], "", Verdict.TRUST, "", "no channel is saturated", "")]
    return [
        Finding(
            check,
            f"{name}, {source}",
            share,
            SATURATED[0],
            "",
            judged(share, *SATURATED),
            "saturation",
            f"{name} is saturated in {source}: {count} samples ({share:.2g} of them) are at its extremes",
            "Repeat the test with less excitation" if name not in inputs else "Use a smaller input",
        )
        for share, name, count in sorted(found, reverse=True)
    ]


def spiked(run: Run | MeasuredData, names: Sequence[str]) -> list[Finding]:
    """A finding for each channel of a test that has spikes; a single one if none has.

    Parameters
    ----------
    run
        The test.
    names
        Names of the channels that are checked.
    """
    check, found = "spikes", []
    forces = set(names) & set(signals.numbered("f", run.groups)) if isinstance(run, Run) else set()
    struck = [reversals_with_play(run.channels([name])[:, 0]) for name in forces]
    blows = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *struck])[:, None] + np.arange(-1, 2))
    for name in names:
        values = run.channels([name])[:, 0]
        where, size = spikes(values)
        own = ~np.isin(where, blows)
        where, size = where[own], size[own]
        if len(where):
            found.append((float(np.sum(size**2) / np.sum((values - values.mean()) ** 2)), name, len(where)))
    if not found:
        return [Finding(check, run.source, 0.0, SPIKED[0], "", Verdict.TRUST, "", "no channel has spikes", "")]
    return [
        Finding(
            check,
            f"{name}, {run.source}",
            share,
            SPIKED[0],
            "",
            judged(share, *SPIKED),
            "spikes",
            f"{name} has {count} spikes in {run.source}, {share:.2g} of its power: readings far from their neighbours",
            "Check plug, cable and shielding of the sensor, and repeat the test",
        )
        for share, name, count in sorted(found, reverse=True)
    ]


def contradicting(motion: Motion, band: tuple[float, float]) -> list[Finding]:
    """Findings on sensors of one test that contradict each other.

    Parameters
    ----------
    motion
        The test.
    band
        Band [Hz] of the building's modes.
    """
    found = kinematics(motion, band)
    check, source = "sensors agree", motion.source
    worst = max(found.contradictions.values(), default=0.0)
    findings = [
        Finding(
            check,
            f"{' and '.join(change.channels)}, {source}",
            worst,
            CONTRADICTION,
            "",
            Verdict.DONT,
            *_named(change, source),
        )
        for change in found.changes
    ]
    if max(found.left.values(), default=0.0) > CONTRADICTION:
        rest = ", ".join(name for name, value in found.left.items() if value > CONTRADICTION)
        findings.append(
            Finding(
                check,
                f"{rest}, {source}",
                max(found.left.values()),
                CONTRADICTION,
                "",
                Verdict.DONT,
                "sensors that disagree",
                f"{rest} contradict each other in {source}, and no swap, unit or sign explains it",
                "Check these channels one by one: tap, tilt or move each sensor by hand",
            )
        )
    if not findings:
        meaning = "accelerations, displacements, strokes and forces agree"
        findings.append(Finding(check, source, worst, CONTRADICTION, "", Verdict.TRUST, "", meaning, ""))
    return findings + _late(found, source)


def _named(change: Change, source: str) -> tuple[str, str, str]:
    """Cause, meaning and advice for a fault of channels."""
    if change.kind == "swapped":
        both = " and ".join(change.channels)
        return WRONG[0], f"{both} are swapped in {source}", "Correct the channel list, or the cables"
    (name,) = change.channels
    if change.kind == "reversed":
        return WRONG[2], f"{name} has the wrong sign in {source}", "Reverse the sensor, or its sign in the calibration"
    size = f"{abs(change.factor):.4g} times too large" + (" and reversed" if change.factor < 0 else "")
    unit = f": {change.unit} in place of {signals.unit(name)}" if change.unit else ""
    return WRONG[1], f"{name} is {size} in {source}{unit}", "Correct unit or sensitivity in the calibration"


def _late(found: Kinematics, source: str) -> list[Finding]:
    if not found.lags or found.changes:
        return []
    findings = []
    for name, lag in found.lags.items():
        others = "the displacement sensors" if name == signals.GROUND else f"x{name[1:]}"
        findings += late(name, others, lag, source)
    late_ones = [one for one in findings if one.verdict]
    return late_ones or [max(findings, key=lambda one: one.value)]


def late(name: str, others: str, lag: float, source: str) -> list[Finding]:
    """A finding on the time between two sensors.

    Parameters
    ----------
    name, others
        Names of the sensors compared.
    lag
        Time by which the first is later [s].
    source
        Name of the test.
    """
    first, second = (name, others) if lag > 0 else (others, name)
    verdict, cause, advice = judged(abs(lag), *LATE), "", ""
    meaning = f"{name} and {others} are in time in {source}"
    if verdict:
        cause, advice = "lag", "Give these sensors the same filter, or sample them together"
        reads = "read" if first.startswith("the") else "reads"
        meaning = f"{first} {reads} {1e3 * abs(lag):.2g} ms later than {second} in {source}"
    return [
        Finding("sensors synchronous", f"{name}, {source}", abs(lag), LATE[0], "s", verdict, cause, meaning, advice)
    ]
