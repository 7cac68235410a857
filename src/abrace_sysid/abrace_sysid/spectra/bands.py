# SPDX-License-Identifier: Apache-2.0
"""The band that a test with noise or a multisine excites, and the slowest resonance in its responses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from abrace_core.model import signals
from abrace_sysid.spectra.fourier import lines_within

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_sysid.recorded.test import Test


EXCITED = 0.02
"""A line is excited if its power exceeds this share of the mean power of the lines that carry the excitation."""

LEAST_PERIODS = 20
"""The band begins where at least this many periods fit into the record; slower motion is masked by sensor drift."""

LOWEST = 0.25
"""The band does not begin below this share of the slowest resonance's frequency."""

EXPECTED_DAMPING = 0.015
"""Expected damping ratio of the slowest resonance."""

STEADY, AROUND = 2e-3, 21
"""An input is excited where its power, averaged over so many lines, is above this share of the greatest."""

SMOOTHED = 9
"""Number of lines over which power is averaged before the slowest resonance is searched."""

HEARD = 10.0
"""Times the least power in the band at which an acceleration is more than noise."""


def excited_band(test: Test, name: str) -> tuple[float, float]:
    """Lowest and highest frequency [Hz] that an input excites.

    Parameters
    ----------
    test
    name
        The input; for an input that is zero, 0 and half the sample rate are returned.
    """
    power = np.abs(test.spectra([name])[:, 0]) ** 2
    frequency = np.arange(len(power)) / test.seconds
    if not power.any():
        return 0.0, 0.5 / test.sample_period
    # for noise the power's mean weighted by itself is twice the mean power of the excited lines
    excited = frequency[power > EXCITED * np.sum(power**2) / np.sum(power) / 2]
    return float(excited[0]), float(excited[-1])


def steady_band(test: Test, names: Sequence[str], lowest: float) -> tuple[float, float]:
    """The widest band [Hz] from `lowest` on in which all of these inputs are excited without a gap.

    Parameters
    ----------
    test
    names
        Names of the inputs; one that is constant does not count, and is refused where it is used.
    lowest
        Lowest frequency [Hz].
    """
    frequency = np.arange(len(test.outputs) // 2 + 1) / test.seconds
    first = int(np.searchsorted(frequency, lowest))
    excited = np.ones(len(frequency), dtype=np.bool_)
    for name in names:
        power = np.abs(test.spectra([name])[:, 0]) ** 2
        smooth = ndimage.uniform_filter1d(power, AROUND, mode="nearest")
        excited &= smooth >= STEADY * smooth[first:].max(initial=0.0)
    excited[:first] = False
    edges = np.flatnonzero(np.diff(excited.astype(np.int8), prepend=0, append=0))
    if not len(edges):
        return lowest, 0.5 / test.sample_period
    start, end = max(zip(edges[::2], edges[1::2], strict=True), key=lambda edge: edge[1] - edge[0])
    return max(lowest, float(frequency[start])), min(float(frequency[end - 1]), 0.5 / test.sample_period)


def common_band(tests: Sequence[Test], names: Sequence[str]) -> tuple[float, float]:
    """The overlap of the excited bands of all tests and inputs; inputs that are zero do not count.

    The band begins at the higher of two limits: where LEAST_PERIODS fit into the longest test, and LOWEST times the
    slowest resonance. Below these the building follows quasi-statically, and sensor drift matters.

    Parameters
    ----------
    names
    tests
        The tests, at least one.
    """
    moving = [(test, name) for test in tests for name in names if np.any(test.channel(name))]
    bands = [excited_band(test, name) for test, name in moving or [(tests[0], names[0])]]
    low, high = max(low for low, _ in bands), min(high for _, high in bands)
    longest = max(tests, key=lambda test: len(test.outputs))
    low = max(low, LEAST_PERIODS / (len(longest.outputs) * longest.sample_period))
    if low >= high:
        return low, high
    return max(low, LOWEST * slowest_resonance(longest, (low, high))), high


def slowest_resonance(test: Test, band: tuple[float, float]) -> float:
    """Frequency [Hz] of the greatest displacement spectrum, median over floors (measured data: all outputs).

    Of a rig without displacement sensors it is that of (a - w) / s^2, where this is more than noise.

    Parameters
    ----------
    test
    band
        Lowest and highest frequency [Hz].
    """
    lines, omega = lines_within(test, len(test.outputs), band)
    of_kind = {kind: [name for name in test.names if name[0] == kind and name[1:].isdigit()] for kind in "xa"}
    derived = bool(test.floors and of_kind["a"] and not of_kind["x"] and signals.GROUND in test.inputs)
    chosen = of_kind["a" if derived else "x"] if test.floors else ()
    spectra = test.spectra(chosen or test.names)[lines]
    if derived:
        spectra = spectra - test.spectra([signals.GROUND])[lines]
    smooth = ndimage.uniform_filter1d(np.abs(spectra) ** 2, min(SMOOTHED, len(lines)), axis=0, mode="nearest")
    if derived:
        smooth = np.where(smooth > HEARD * smooth.min(axis=0), smooth, 0.0) / omega[:, None] ** 4
    return float(np.median(omega[np.argmax(smooth, axis=0)])) / (2 * np.pi)


def slowest_bandwidth(test: Test, band: tuple[float, float]) -> float:
    """Half-power bandwidth 2 zeta omega [rad/s] of the slowest resonance, with EXPECTED_DAMPING as zeta.

    `test`, `band`: as in `slowest_resonance`.
    """
    return 2 * EXPECTED_DAMPING * 2 * np.pi * slowest_resonance(test, band)
