# SPDX-License-Identifier: Apache-2.0
"""What is wrong with the channels of a test, and whether it can be used for identification.

A fault that makes the test unusable raises an error that names what was found and what was expected. If only a channel
is lost, a warning is given and the rest is used.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np
from scipy import fft

from abrace_bags.bag import in_brackets
from abrace_core import AbraceError
from abrace_sysid.spectra.bands import excited_band, steady_band
from abrace_sysid.spectra.welch import coherence_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_sysid.recorded.test import Test

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

LEAST_LINES = 4
"""With fewer lines in the band the segments of a short record hide a resonance, and no channel is taken for noise."""

FALSE_ALARM = 1e-3
"""Probability that a channel of pure noise is accepted as a response."""


def prepared(test: Test, bands: Mapping[str, tuple[float, float]], others: Sequence[str] = ()) -> Test:
    """The test as `examined`, if it can be used.

    Parameters
    ----------
    bands
        Lowest and highest frequency [Hz] of each excited input whose transfer functions are wanted.
    others
        Names of inputs excited at the same time on other lines.

    Raises
    ------
    AbraceError
        If not every sample was recorded, a value is not finite, an input is clipped or is not excited throughout its
        band, or no channel responds.
    """
    require_every_sample(test)
    _require_finite(test)
    for name, band in bands.items():
        require_excited(test, name, band)
    warned = test.warnings
    test = examined(test, (*bands, *others), next(iter(bands.values())))
    for name in bands:
        count, samples = test.clipped.get(name, 0), test.period or len(test.outputs)
        if count > CLIPPED_SHARE * samples:
            raise AbraceError(
                f"{test.source}: input {name} is clipped, {count} of {samples} samples are at its extremes, expected "
                f"at most {CLIPPED_SHARE:.1%}"
            )
    if len(test.faults) == len(test.names):
        reasons = ", ".join(f"{name} {reason}" for name, reason in test.faults.items())
        none = f"{test.source}: no channel is a response to {' and '.join((*bands, *others))}: {reasons}"
        raise AbraceError(f"{none}{in_brackets(warned)}")
    return test


def examined(test: Test, driving: Sequence[str], band: tuple[float, float]) -> Test:
    """The test with its `faults`, its `clipped` samples and warnings about both.

    Parameters
    ----------
    driving
        Names of all inputs that were excited.
    band
        Lowest and highest frequency [Hz] of the excitation.

    Raises
    ------
    AbraceError
        If a value is not finite.
    """
    _require_finite(test)
    faults, clipped = _faults(test, driving, band), {}
    for name in (*test.names, *test.inputs):
        # each period of a multisine reaches its peak once
        values, middle = test.channel(name), len(test.outputs) // 2
        count = at_extremes(values if test.period is None else values[middle : middle + test.period])
        # a group's force is the mean of its load cells, fa, fb, ...
        count = count or sum(number for flag, number in test.flagged.items() if flag in (name, name + flag[-1]))
        if count and name not in faults:
            clipped[name] = count
    warnings = [*test.warnings]
    warnings += [f"{test.source}: channel {name} is left out: {reason}" for name, reason in faults.items()]
    for name, count in clipped.items():
        if name in test.names or name in driving:
            kind = "channel" if name in test.names else "input"
            warnings.append(f"{test.source}: {kind} {name} is clipped in {count} samples")
    return test.examined(faults, clipped, warnings)


def _require_finite(test: Test) -> None:
    for name in (*test.names, *test.inputs):
        bad = np.flatnonzero(~np.isfinite(test.channel(name)))
        if len(bad):
            where = f"first at sample {bad[0]}"
            raise AbraceError(f"{test.source}: channel {name} has {len(bad)} values that are not finite, {where}")


def require_rig(test: Test) -> None:
    """Refuse a `test` that is not of a rig."""
    if test.hold != "rig":
        raise AbraceError(f"{test.source}: hold {test.hold!r}, expected a test of a rig (hold 'rig')")


def require_every_sample(test: Test) -> None:
    """Refuse a `test` of which the logger left out samples: what its inputs did between the others is not known."""
    every = test.facts.get("every", 1)
    if every > 1:
        raise AbraceError(
            f"{test.source}: of {every} samples one was recorded: what the inputs did between them is not known, and "
            f"motion above {0.5 / test.sample_period:g} Hz is folded into what is below; expected every sample"
        )


def require_long(test: Test) -> None:
    """Refuse a `test` of a rig that is shorter than LEAST_SECONDS."""
    if test.seconds < LEAST_SECONDS:
        raise AbraceError(f"{test.source}: {test.seconds:g} s, expected at least {LEAST_SECONDS:g} s")


def require_excited(test: Test, name: str, band: tuple[float, float]) -> None:
    """Check that an input has power in each of ten equal parts of a band.

    Parameters
    ----------
    test, name
    band
        Lowest and highest frequency [Hz].

    Raises
    ------
    AbraceError
        If the band is not within 0 to half the sample rate, or the input has no power in a part of it.
    """
    half = 0.5 / test.sample_period
    if band[0] >= band[1]:
        raise AbraceError(
            f"{test.source}: band {band[0]:g} to {band[1]:g} Hz for {name} in {test.seconds:g} s, expected the lower "
            "frequency first, or a longer test"
        )
    if not 0 <= band[0] < band[1] <= half:
        raise AbraceError(
            f"{test.source}: band {band[0]:g} to {band[1]:g} Hz for {name}, expected within 0 to {half:g} Hz"
        )
    power = np.abs(test.spectra([name])[:, 0]) ** 2
    frequency = fft.rfftfreq(len(test.outputs), test.sample_period)
    edges = np.linspace(*band, 11)
    parts = np.searchsorted(frequency, edges)
    share = np.array([power[a:b].mean() if b > a else 0.0 for a, b in itertools.pairwise(parts)])
    weak = np.flatnonzero(~(share > 1e-3 * share.max()))
    if len(weak):
        low, high = edges[weak[0]], edges[weak[0] + 1]
        message = f"{test.source}: {name} is not excited from {low:.3g} to {high:.3g} Hz, expected noise from "
        message += f"{band[0]:g} to {band[1]:g} Hz"
        if power.any():
            message += "; it is excited from {:.3g} to {:.3g} Hz".format(*steady_band(test, [name], frequency[1]))
        raise AbraceError(message)


def require_at_rest(test: Test, name: str, excited: Test) -> None:
    """Check that an input is at rest: a command must be zero, the table's rms below REST times that of its own test.

    The table's rms is that in the band which its own test excites: over all frequencies a weak test of a tall building
    is hardly more than the accelerometer's noise.

    Parameters
    ----------
    name, excited

    Raises
    ------
    AbraceError
        If it is not at rest.
    """
    if name in test.commands:
        greatest = float(np.abs(test.channel(name)).max())
        if greatest:
            raise AbraceError(f"{test.source}: {name} up to {greatest:g} N, expected 0")
        return
    band = excited_band(excited, name)
    rest, moved = (_rms_within(each, name, band) for each in (test, excited))
    if not rest < REST * moved:
        raise AbraceError(
            f"{test.source}: rms of {name} {rest:.3g} m/s^2, and {moved:.3g} in {excited.source}; "
            f"expected the first at rest (less than {REST:g} of the second)"
        )


def _rms_within(test: Test, name: str, band: tuple[float, float]) -> float:
    """Rms of an input within a band [Hz]."""
    frequency = fft.rfftfreq(len(test.outputs), test.sample_period)
    within = test.spectra([name])[(frequency >= band[0]) & (frequency <= band[1]), 0]
    return float(np.sqrt(2 * np.sum(np.abs(within) ** 2) / len(test.outputs)))


def at_extremes(values: NDArray[np.float64]) -> int:
    """How many of `values` (samples,) equal an extreme value that CLIPPED_COUNT or more samples have.

    A value that half of the samples have is rest, as before and after an impulse.
    """
    if not np.ptp(values):
        return 0
    extremes = (extreme for extreme in (values.max(), values.min()) if extreme != np.median(values))
    counts = (np.count_nonzero(values == extreme) for extreme in extremes)
    return int(sum(count for count in counts if count >= CLIPPED_COUNT))


def _faults(test: Test, inputs: Sequence[str], band: tuple[float, float]) -> dict[str, str]:
    """Outputs that never change, are stuck, or have no coherence with any input in the band, with the reason."""
    dead = {}
    samples = len(test.outputs)
    for column, name in enumerate(test.names):
        values = test.outputs[:, column]
        if not np.ptp(values):
            dead[name] = f"never changes from {values[0]:g}"
            continue
        changes = np.concatenate([[0], np.flatnonzero(np.diff(values)) + 1, [samples]])
        longest = int(np.argmax(np.diff(changes)))
        kept = int(changes[longest + 1] - changes[longest])
        if kept > STUCK_SHARE * samples:
            start = changes[longest]
            dead[name] = f"stuck for {kept * test.sample_period:.3g} s from sample {start}"
    alive = [column for column, name in enumerate(test.names) if name not in dead]
    # a coherence c of pure noise is exceeded with probability (1 - c)^(averages - 1) (Bendat and Piersol 2010, ch. 9)
    segment = 2 ** int(np.log2(samples / 16))
    if not alive or (band[1] - band[0]) * segment * test.sample_period < LEAST_LINES:
        return dead

    def answer(names: Sequence[str], comparisons: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        found = [coherence_of(test, name, band, segment) for name in names]
        chance = FALSE_ALARM / len(found[0][0]) / comparisons
        greatest = np.max([coherence for coherence, _ in found], axis=(0, 1))
        return greatest, greatest >= 1 - chance ** (1 / (found[0][1] - 1))

    greatest, heard = answer(inputs, 1)
    noise, others = ([i for i in alive if heard[i] == wanted] for wanted in (False, True))
    if noise and others:
        # segments too short for the damping of the modes hide the input's part, but not what two channels share
        _, heard = answer([test.names[i] for i in others], len(others))
    for column in noise:
        if not heard[column]:
            reason = f"noise, its coherence with {' and '.join(inputs)} is nowhere above {greatest[column]:.2f}"
            dead[test.names[column]] = reason
    return {name: dead[name] for name in test.names if name in dead}
