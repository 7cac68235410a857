# SPDX-License-Identifier: Apache-2.0
"""Ground motions for an exploration: those of recorded tests, and banded noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError
from abrace_core.noise import banded_noise

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.run import Run


@dataclass(frozen=True)
class Record:
    """A ground motion.

    Parameters
    ----------
    name
        Its bag, or the seed of its noise.
    ground_acceleration
        (samples,) [m/s^2].
    """

    name: str
    ground_acceleration: NDArray[np.float64]

    def scaled(self, peak_acceleration: float) -> Record:
        """The record scaled to a peak of `peak_acceleration` [m/s^2]; a record of zeros is refused."""
        peak = np.abs(self.ground_acceleration).max(initial=0.0)
        if not peak > 0:
            raise AbraceError(f"{self.name}: the ground does not move, expected a record of a test on the table")
        return Record(self.name, self.ground_acceleration * (peak_acceleration / peak))


def recorded_motion(run: Run, sample_period: float) -> Record:
    """The ground acceleration of a recorded test.

    Parameters
    ----------
    run
        The test.
    sample_period
        Of the controllers [s]; the test must have the same.
    """
    if abs(run.sample_period - sample_period) > 1e-9 * sample_period:
        raise AbraceError(
            f"{run.source}: sampled every {run.sample_period} s, expected the controller's {sample_period} s"
        )
    return Record(run.source, run.ground_acceleration)


def noise_motion(seed: int, seconds: float, band: tuple[float, float], sample_period: float) -> Record:
    """Banded white noise as ground acceleration, with an rms of 1 m/s^2.

    Parameters
    ----------
    seed
        Of the noise.
    seconds
        Length [s].
    band
        Lowest and highest frequency [Hz].
    sample_period
        [s].
    """
    noise = banded_noise(round(seconds / sample_period), 1 / sample_period, band, 1.0, seed)
    return Record(f"noise {seed}", noise)
