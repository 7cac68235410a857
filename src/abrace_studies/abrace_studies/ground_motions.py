# SPDX-License-Identifier: Apache-2.0
"""Ground motions of a study: records, as they are played, and banded noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_core.model.noise import banded_noise
from abrace_plant.records.files import read_record
from abrace_plant.records.options import BAND_LIMIT, Treatment
from abrace_plant.records.record import Record
from abrace_plant.records.treatment import prepare

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from numpy.typing import NDArray

    from abrace_studies.options import StudyOptions


@dataclass(frozen=True)
class GroundMotion:
    """A ground motion: the name of its record or noise, and its acceleration (samples,) [m/s^2]."""

    name: str
    ground_acceleration: NDArray[np.float64]

    def scaled(self, peak_acceleration: float) -> GroundMotion:
        """The motion scaled to a peak of `peak_acceleration` [m/s^2]; one of zeros is refused."""
        peak = np.abs(self.ground_acceleration).max(initial=0.0)
        if not peak > 0:
            raise AbraceError(f"record {self.name}: the ground does not move, expected an earthquake")
        return GroundMotion(self.name, self.ground_acceleration * (peak_acceleration / peak))


def ground_motions(
    records: Iterable[Record | Path | str], options: StudyOptions, sample_period: float
) -> list[GroundMotion]:
    """The motions of `records` (known names, files, bags) and of the noise in the `options`; `sample_period` [s]."""
    found = []
    for each in records:
        record = each if isinstance(each, Record) else read_record(each)
        ground = prepare(record, 1 / sample_period, Treatment(band_limit=BAND_LIMIT))
        found.append(GroundMotion(record.name, ground))
    seconds, band = options.noise_duration, options.noise_band
    return found + [noise_motion(seed, seconds, band, sample_period) for seed in options.noise]


def noise_motion(seed: int, seconds: float, band: tuple[float, float], sample_period: float) -> GroundMotion:
    """Noise of a `seed` as ground acceleration with an rms of 1 m/s^2.

    So many `seconds`, a `band` [Hz], every `sample_period` [s].
    """
    noise = banded_noise(round(seconds / sample_period), 1 / sample_period, band, 1.0, seed)
    return GroundMotion(f"noise {seed}", noise)
