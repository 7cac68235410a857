# SPDX-License-Identifier: Apache-2.0
"""What follows from a test with noise or a multisine itself: the band that it excites, and its slowest resonance."""

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
"""Power of a line, as a share of the mean of those that carry the excitation, from which on it is excited."""

LEAST_PERIODS = 20
"""Of the slowest motion that is identified within the record: slower ones hardly repeat themselves, sensors drift."""

LOWEST = 0.25
"""Where the band begins as a share of the slowest resonance's frequency."""

EXPECTED_DAMPING = 0.015
"""Damping ratio that is expected of the slowest resonance."""

SMOOTHED = 9
"""Lines over which power is averaged where a resonance is sought."""


def excited_band(run: Run, name: str) -> tuple[float, float]:
    """Lowest and highest frequency [Hz] that an input excites.

    Parameters
    ----------
    run
        The test.
    name
        The input; of one that is zero all frequencies are returned.
    """
    excitation = np.nan_to_num(held_input(run, name), posinf=0.0, neginf=0.0)
    power = np.abs(transform(excitation[:, None])[:, 0]) ** 2
    frequency = np.arange(len(power)) / (len(excitation) * run.sample_period)
    if not power.any():
        return 0.0, 0.5 / run.sample_period
    # of noise the power's own mean, weighted by itself, is twice that of the lines that carry it
    excited = frequency[power > EXCITED * np.sum(power**2) / np.sum(power) / 2]
    return float(excited[0]), float(excited[-1])


def common_band(runs: Sequence[Run], names: Sequence[str]) -> tuple[float, float]:
    """Of all tests and inputs that are excited in them: `excited_band`, where they overlap.

    It begins where LEAST_PERIODS are within the longest test, and at LOWEST of the slowest resonance: below that a
    building only follows statically, and what sensors drift counts.

    Parameters
    ----------
    runs
        The tests, one at least.
    names
        Of the inputs.
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
    """Frequency [Hz] at which the floors' displacements are greatest; of measured data, where most channels are.

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
    """2 zeta omega [rad/s] of the slowest resonance, with the damping that is expected of it.

    `run`, `band`: as in slowest_resonance.
    """
    return 2 * EXPECTED_DAMPING * 2 * np.pi * slowest_resonance(run, band)
