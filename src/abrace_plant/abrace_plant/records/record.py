# SPDX-License-Identifier: Apache-2.0
"""A record of ground acceleration, and the check that it can be integrated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_core.model.plotted import figure_of
from abrace_core.model.tabular import Tabular

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure
    from numpy.typing import NDArray


@dataclass(frozen=True)
class Record(Tabular):
    """A ground acceleration, as recorded or as played.

    Parameters
    ----------
    name
        A known name, or the file's name without its ending.
    sample_period
        [s].
    acceleration
        (samples,) [m/s^2], at least two samples.
    chosen
        What of the file was read, and in which unit it is.
    warnings
        One sentence each, such as of a clock that was set during the recording.
    """

    name: str
    sample_period: float
    acceleration: NDArray[np.float64]
    chosen: str = ""
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        chosen = f", from {self.chosen}" if self.chosen else ""
        peak, seconds = np.abs(self.acceleration).max(), len(self.acceleration) * self.sample_period
        return f"<Record {self.name}: {seconds:g} s, every {self.sample_period:g} s, peak {peak:.4g} m/s^2{chosen}>"

    @property
    def time(self) -> NDArray[np.float64]:
        """(samples,) seconds since the first sample."""
        return np.asarray(np.arange(len(self.acceleration)) * self.sample_period, dtype=np.float64)

    def to_pandas(self) -> pandas.DataFrame:
        """The acceleration [m/s^2] by the time since the first sample [s]; an AbraceError without pandas."""
        import pandas

        return pandas.DataFrame({"acceleration": self.acceleration}, index=pandas.Index(self.time, name="time [s]"))

    def plot(self) -> Figure:
        """The acceleration over time."""
        return figure_of(self, "plot")


def check_record(record: Record) -> None:
    """Refuse a record that cannot be integrated.

    Parameters
    ----------
    record
        As recorded or as played.

    Raises
    ------
    AbraceError
        If it has less than two samples, one that is not finite, or no sample period.
    """
    where, acceleration, period = f"ground motion {record.name}", np.asarray(record.acceleration), record.sample_period
    if acceleration.ndim != 1:
        raise AbraceError(f"{where}: of shape {acceleration.shape}, expected (samples,)")
    if len(acceleration) < 2:
        raise AbraceError(f"{where}: {len(acceleration)} samples, expected at least 2")
    finite = np.isfinite(acceleration)
    if not finite.all():
        bad = int(np.argmin(finite))
        raise AbraceError(f"{where}: sample {bad + 1} is {acceleration[bad]}, expected a finite number")
    if not (np.isfinite(period) and period > 0):
        raise AbraceError(f"{where}: sample period {period} s, expected more than 0")
