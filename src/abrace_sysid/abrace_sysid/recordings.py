# SPDX-License-Identifier: Apache-2.0
"""Preparation of recorded tests for identification: checks, the longest piece without a gap, removal of trends.

A fault that makes the test unusable raises an error that names what was found and what was expected. If only a channel
or a part of the record is lost, a warning is given and the rest is used.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy import fft, signal

from abrace_core import signals
from abrace_core.errors import AbraceError
from abrace_core.run import Run
from abrace_core.sequence import breaks
from abrace_sysid.spectra.bands import excited_band
from abrace_sysid.spectra.fourier import held_input, transform
from abrace_sysid.spectra.welch import coherence_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_sysid.measured_data import MeasuredData

LEAST_SECONDS = 60.0
"""Shorter tests do not resolve modes of 1 % damping near 1 Hz."""

REST = 0.05
"""An input is at rest if its rms (sensor noise) is below this share of its rms in the test that excites it."""

CLIPPED_SHARE = 1e-3
"""Greatest share of an input's samples at its extremes: that of noise clipped at 3.3 standard deviations."""

CLIPPED_COUNT = 10
"""A signal is clipped if at least this many samples have its greatest, or its least, value.

Noise that is not clipped hardly ever has as many.
"""

STUCK_SHARE = 0.1
"""A channel is stuck if it keeps one value for more than this share of the record.

The rest at the beginning and end of a test is shorter.
"""

FALSE_ALARM = 1e-3
"""Probability that a channel of pure noise is accepted as a response."""


@dataclass(frozen=True)
class Recording:
    """A test prepared for identification.

    Parameters
    ----------
    run
        The test, or its longest piece without a gap; trends removed.
    left_out
        Channels that do not respond to the inputs, each with the reason.
    warnings
        About the test and its channels, one sentence each.
    """

    run: Run
    left_out: Mapping[str, str]
    warnings: tuple[str, ...]

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the channels that respond to the inputs."""
        return tuple(name for name in self.run.names if name not in self.left_out)


def prepare(
    run: Run,
    inputs: Sequence[str],
    band: tuple[float, float],
    period: int | None = None,
    others: Sequence[str] = (),
) -> Recording:
    """Check a test, take its longest piece without a gap, and remove trends.

    Parameters
    ----------
    run
        The test.
    inputs
        Names of the inputs to which the responses are wanted.
    band
        Lowest and highest frequency [Hz] of the excitation.
    period
        Samples in a period of a periodic excitation; None: noise. From a response to noise a straight line is removed,
        from a periodic response only the mean, since a line fitted to it would follow the periods.
    others
        Names of inputs excited at the same time on other lines.

    Raises
    ------
    AbraceError
        If no piece without a gap is long enough, a value is not finite, an input is clipped or is not excited
        throughout the band, or no channel responds to the inputs.
    """
    whole, warnings = longest_piece(run)
    left_out, found = check_channels(whole, inputs, band, period, others)
    return Recording(_without_trend(whole, "linear" if period is None else "constant"), left_out, warnings + found)


def check_channels(
    whole: Run | MeasuredData,
    inputs: Sequence[str],
    band: tuple[float, float],
    period: int | None = None,
    others: Sequence[str] = (),
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Find the outputs that do not respond to the inputs, each with the reason, and warnings about the channels.

    Parameters
    ----------
    whole
        The test, without gaps.
    inputs, band, period, others
        As of `prepare`.

    Raises
    ------
    AbraceError
        If a value is not finite, an input is clipped or is not excited throughout the band, or no channel responds to
        the inputs.
    """
    warnings: tuple[str, ...] = ()
    every = (signals.GROUND, *whole.command_names) if isinstance(whole, Run) else whole.inputs
    for name in dict.fromkeys((*whole.names, *every)):
        values = whole.channels([name])[:, 0]
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            where = f"first at sample {whole.sequence[bad[0]]}"
            raise AbraceError(f"{whole.source}: channel {name} has {len(bad)} values that are not finite, {where}")
    for name in inputs:
        require_excited(whole, name, band)
        excitation = held_input(whole, name)
        middle = len(excitation) // 2
        count = at_extremes(excitation if period is None else excitation[middle : middle + period])
        if count > CLIPPED_SHARE * len(whole.outputs):
            raise AbraceError(
                f"{whole.source}: input {name} is clipped, {count} of {len(whole.outputs)} samples are at its "
                f"extremes, expected at most {CLIPPED_SHARE:.1%}"
            )
        if count:
            warnings += (f"{whole.source}: input {name} is clipped in {count} samples",)

    driving = tuple(dict.fromkeys((*inputs, *others)))
    left_out = dead_channels(whole, driving, band)
    if len(left_out) == len(whole.names):
        reasons = ", ".join(f"{name} {reason}" for name, reason in left_out.items())
        raise AbraceError(f"{whole.source}: no channel is a response to {' and '.join(driving)}: {reasons}")
    for name, reason in left_out.items():
        warnings += (f"{whole.source}: channel {name} is left out: {reason}",)
    for name in whole.names:
        count = 0 if name in left_out else at_extremes(whole.channels([name])[:, 0])
        if count:
            warnings += (f"{whole.source}: channel {name} is clipped in {count} samples",)
    return left_out, warnings


def longest_piece(run: Run) -> tuple[Run, tuple[str, ...]]:
    """The longest piece of a test with consecutive sample numbers, and a warning if it is not the whole test.

    Parameters
    ----------
    run
        The test.

    Raises
    ------
    AbraceError
        If it is shorter than LEAST_SECONDS.
    """
    gaps = breaks(run.sequence)
    edges = np.concatenate([[0], gaps + 1, [len(run.sequence)]])
    longest = int(np.argmax(np.diff(edges)))
    first, last = int(edges[longest]), int(edges[longest + 1])
    seconds, expected = (last - first) * run.sample_period, f"expected at least {LEAST_SECONDS:g} s"
    if not len(gaps):
        if seconds < LEAST_SECONDS:
            raise AbraceError(f"{run.source}: {seconds:g} s, {expected}")
        return run, ()
    after, missing = run.sequence[gaps[0]], int(run.sequence[gaps[0] + 1]) - int(run.sequence[gaps[0]]) - 1
    found = f"a gap after sample {after}" if missing > 0 else f"sample numbers that do not rise after {after}"
    if missing > 0:
        found += f" ({missing} samples, {missing * run.sample_period:g} s)"
    if len(gaps) > 1:
        found += f" and {len(gaps) - 1} more"
    if seconds < LEAST_SECONDS:
        raise AbraceError(f"{run.source}: {found}; the longest whole piece has {seconds:g} s, {expected}")
    piece = replace(
        run,
        sequence=run.sequence[first:last],
        outputs=run.outputs[first:last],
        ground_acceleration=run.ground_acceleration[first:last],
        command=run.command[first:last],
    )
    span = f"samples {piece.sequence[0]} to {piece.sequence[-1]}"
    return piece, (
        f"{run.source}: {found}; {span} are used, {seconds:g} s of {len(run.sequence) * run.sample_period:g}",
    )


def require_excited(run: Run | MeasuredData, name: str, band: tuple[float, float]) -> None:
    """Check that an input has power in each of ten equal parts of a band.

    Parameters
    ----------
    run
        The test.
    name
        The input.
    band
        Lowest and highest frequency [Hz].

    Raises
    ------
    AbraceError
        If the band is not within 0 to half the sample rate, or the input has no power in a part of it.
    """
    half = 0.5 / run.sample_period
    if not 0 <= band[0] < band[1] <= half:
        raise AbraceError(
            f"{run.source}: band {band[0]:g} to {band[1]:g} Hz for {name}, expected within 0 to {half:g} Hz"
        )
    excitation = held_input(run, name)
    power = np.abs(transform(excitation[:, None])[:, 0]) ** 2
    frequency = fft.rfftfreq(len(excitation), run.sample_period)
    edges = np.linspace(*band, 11)
    parts = np.searchsorted(frequency, edges)
    share = np.array([power[a:b].mean() if b > a else 0.0 for a, b in itertools.pairwise(parts)])
    weak = np.flatnonzero(~(share > 1e-3 * share.max()))
    if len(weak):
        low, high = edges[weak[0]], edges[weak[0] + 1]
        raise AbraceError(
            f"{run.source}: {name} is not excited from {low:.3g} to {high:.3g} Hz, "
            f"expected noise from {band[0]:g} to {band[1]:g} Hz"
        )


def require_at_rest(run: Run, name: str, excited: Run) -> None:
    """Check that an input is at rest: a command must be zero, the table's rms below REST times that of its own test.

    The table's rms is that in the band which its own test excites: over all frequencies a weak test of a tall building
    is hardly more than the accelerometer's noise.

    Parameters
    ----------
    run
        The test in which the input is at rest.
    name
        The input.
    excited
        The test in which it is excited.

    Raises
    ------
    AbraceError
        If it is not at rest.
    """
    if name in run.command_names:
        greatest = float(np.abs(held_input(run, name)).max())
        if greatest:
            raise AbraceError(f"{run.source}: {name} up to {greatest:g} N, expected 0")
        return
    band = excited_band(excited, name)
    rest, moved = (_rms_within(each, name, band) for each in (run, excited))
    if not rest < REST * moved:
        raise AbraceError(
            f"{run.source}: rms of {name} {rest:.3g} m/s^2, and {moved:.3g} in {excited.source}; "
            f"expected the first at rest (less than {REST:g} of the second)"
        )


def _rms_within(run: Run, name: str, band: tuple[float, float]) -> float:
    """Rms of an input within a band [Hz]."""
    values = held_input(run, name)
    frequency = fft.rfftfreq(len(values), run.sample_period)
    within = transform(values[:, None])[(frequency >= band[0]) & (frequency <= band[1]), 0]
    return float(np.sqrt(2 * np.sum(np.abs(within) ** 2) / len(values)))


def at_extremes(values: NDArray[np.float64]) -> int:
    """How many of `values` (samples,) equal an extreme value that CLIPPED_COUNT or more samples have."""
    if not np.ptp(values):
        return 0
    counts = (np.count_nonzero(values == extreme) for extreme in (values.max(), values.min()))
    return int(sum(count for count in counts if count >= CLIPPED_COUNT))


def dead_channels(run: Run | MeasuredData, inputs: Sequence[str], band: tuple[float, float]) -> dict[str, str]:
    """Channels that never change, are stuck, or have no coherence with any input at any frequency, with the reason.

    Parameters
    ----------
    run
        The test.
    inputs
        Names of all inputs that were excited.
    band
        Lowest and highest frequency [Hz] of the excitation.
    """
    dead = {}
    samples = len(run.outputs)
    for column, name in enumerate(run.names):
        values = run.outputs[:, column]
        if not np.ptp(values):
            dead[name] = f"never changes from {values[0]:g}"
            continue
        changes = np.concatenate([[0], np.flatnonzero(np.diff(values)) + 1, [samples]])
        longest = int(np.argmax(np.diff(changes)))
        kept = int(changes[longest + 1] - changes[longest])
        if kept > STUCK_SHARE * samples:
            start = run.sequence[changes[longest]]
            dead[name] = f"stuck for {kept * run.sample_period:.3g} s from sample {start}"
    alive = [column for column, name in enumerate(run.names) if name not in dead]
    if not alive:
        return dead
    # a coherence c of pure noise is exceeded with probability (1 - c)^(averages - 1) (Bendat and Piersol 2010, ch. 9)
    segment = 2 ** int(np.log2(samples / 16))
    found = [coherence_of(run, name, band, segment) for name in inputs]
    averages = found[0][1]
    threshold = 1 - (FALSE_ALARM / len(found[0][0])) ** (1 / (averages - 1))
    greatest = np.max([coherence[:, alive] for coherence, _ in found], axis=(0, 1))
    for column, value in zip(alive, greatest, strict=True):
        if value < threshold:
            dead[run.names[column]] = f"noise, its coherence with {' and '.join(inputs)} is nowhere above {value:.2f}"
    return {name: dead[name] for name in run.names if name in dead}


def _without_trend(run: Run, kind: Literal["linear", "constant"]) -> Run:
    """The test with trends removed from outputs and table acceleration; commands are known exactly and stay."""
    return replace(
        run,
        outputs=signal.detrend(run.outputs, axis=0, type=kind),
        ground_acceleration=signal.detrend(run.ground_acceleration, type=kind),
    )
