# SPDX-License-Identifier: Apache-2.0
"""The band that a test with noise or a multisine excites, and the slowest resonance in its responses."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from abrace_core import signals
from abrace_core.run import Run
from abrace_sysid.spectra.fourier import held_input, lines_within, transform

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_sysid.measured_data import MeasuredData

EXCITED = 0.02
"""A line is excited if its power exceeds this share of the mean power of the lines that carry the excitation."""

LEAST_PERIODS = 20
"""The band begins where at least this many periods fit into the record; slower motion is masked by sensor drift."""

LOWEST = 0.25
"""The band does not begin below this share of the slowest resonance's frequency."""

EXPECTED_DAMPING = 0.015
"""Expected damping ratio of the slowest resonance."""

SMOOTHED = 9
"""Number of lines over which power is averaged before the slowest resonance is searched."""


def excited_band(run: Run, name: str) -> tuple[float, float]:
    """Lowest and highest frequency [Hz] that an input excites.

    Parameters
    ----------
    run
        The test.
    name
        The input; for an input that is zero, 0 and half the sample rate are returned.
    """
    excitation = np.nan_to_num(held_input(run, name), posinf=0.0, neginf=0.0)
    power = np.abs(transform(excitation[:, None])[:, 0]) ** 2
    frequency = np.arange(len(power)) / (len(excitation) * run.sample_period)
    if not power.any():
        return 0.0, 0.5 / run.sample_period
    # for noise the power's mean weighted by itself is twice the mean power of the excited lines
    excited = frequency[power > EXCITED * np.sum(power**2) / np.sum(power) / 2]
    return float(excited[0]), float(excited[-1])


def common_band(runs: Sequence[Run], names: Sequence[str]) -> tuple[float, float]:
    """The overlap of the excited bands of all tests and inputs; inputs that are zero do not count.

    The band begins at the higher of two limits: where LEAST_PERIODS fit into the longest test, and LOWEST times the
    slowest resonance. Below these the building follows quasi-statically, and sensor drift matters.

    Parameters
    ----------
    runs
        The tests, at least one.
    names
        Names of the inputs.
    """
    moving = [(run, name) for run in runs for name in names if np.any(held_input(run, name))]
    bands = [excited_band(run, name) for run, name in moving or [(runs[0], names[0])]]
    low, high = max(low for low, _ in bands), min(high for _, high in bands)
    longest = max(runs, key=lambda run: len(run.outputs))
    low = max(low, LEAST_PERIODS / (len(longest.outputs) * longest.sample_period))
    if low >= high:
        return low, high
    return max(low, LOWEST * slowest_resonance(longest, (low, high))), high


def slowest_resonance(run: Run | MeasuredData, band: tuple[float, float]) -> float:
    """Frequency [Hz] of the greatest displacement spectrum, median over floors (measured data: all outputs).

    Parameters
    ----------
    run
        The test.
    band
        Lowest and highest frequency [Hz].
    """
    lines, omega = lines_within(run, len(run.outputs), band)
    floors = signals.response_names(run.floors, 0)[: run.floors] if isinstance(run, Run) else run.names
    power = np.abs(transform(np.nan_to_num(run.channels(floors), posinf=0.0, neginf=0.0))[lines]) ** 2
    smooth = ndimage.uniform_filter1d(power, min(SMOOTHED, len(lines)), axis=0, mode="nearest")
    return float(np.median(omega[np.argmax(smooth, axis=0)])) / (2 * np.pi)


def slowest_bandwidth(run: Run | MeasuredData, band: tuple[float, float]) -> float:
    """Half-power bandwidth 2 zeta omega [rad/s] of the slowest resonance, with EXPECTED_DAMPING as zeta.

    `run`, `band`: as in `slowest_resonance`.
    """
    return 2 * EXPECTED_DAMPING * 2 * np.pi * slowest_resonance(run, band)
