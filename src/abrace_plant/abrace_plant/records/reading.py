# SPDX-License-Identifier: Apache-2.0
"""Common parts of the readers of all formats: units of acceleration, lines of text, and checks of the values read.

In every format a reading has at least two finite values.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_core.files.units import ACCELERATION, unit_in_header

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike, NDArray

UNITS = ("g", "m/s^2", "cm/s^2", "mm/s^2", "mg", "in/s^2")
"""Units of acceleration that a user can give."""
LEAST = 50
"""Samples of a record that is chosen among the arrays of a file; a shorter one has to be named."""


@dataclass(frozen=True)
class Reading:
    """The content of a file.

    Parameters
    ----------
    acceleration
        (samples,) in `unit`, at least two, all finite.
    sample_period
        [s]; None where the file does not state it.
    unit
        As written; None where the file does not state it.
    chosen
        What of the file it is, such as its column; empty: all.
    warnings
        One sentence each, of the times of the samples.
    header
        First line above the values of a text; empty: there is none.
    """

    acceleration: NDArray[np.float64]
    sample_period: float | None
    unit: str | None
    chosen: str = ""
    warnings: tuple[str, ...] = ()
    header: str = ""


def factor_of(unit: str) -> float | None:
    """The factor to m/s^2 of a unit in any spelling of a header; None: it is none of acceleration."""
    known = unit_in_header(unit)
    return known.factor if known is not None and known.dimension == ACCELERATION else None


def record_error(name: str, message: str, where: str = "") -> AbraceError:
    """An error with this message about the record of this name, and where in it, as `line 3`."""
    return AbraceError(f"ground motion {name}{where and ', '}{where}: {message}")


def checked_reading(
    values: ArrayLike,
    error_at: Callable[[str, int | None], AbraceError],
    *,
    unit: str | None,
    sample_period: float | None = None,
    chosen: str = "",
) -> Reading:
    """Values as a reading, after checks.

    Parameters
    ----------
    values
        (samples,) in `unit`.
    error_at
        Makes the error of a message about a sample (the first is 0), or about the whole file (None).
    unit, sample_period, chosen
        As of `Reading`.

    Raises
    ------
    AbraceError
        If there are fewer than two values, or one is not finite.
    """
    acceleration = np.asarray(values, dtype=np.float64)
    if len(acceleration) < 2:
        raise error_at(f"{len(acceleration)} values, expected at least 2", None)
    wrong = np.flatnonzero(~np.isfinite(acceleration))
    if wrong.size:
        raise error_at(f"{acceleration[wrong[0]]:g}, expected a finite acceleration", int(wrong[0]))
    return Reading(acceleration, sample_period, unit, chosen)


class RecordText:
    """The lines of a text file, and errors that name a line.

    Parameters
    ----------
    name
        Of the record, as the user gave it.
    text
        The file.
    """

    def __init__(self, name: str, text: str) -> None:
        self.name = name
        self.lines = text.split("\n")

    def error(self, message: str, line: int | None = None) -> AbraceError:
        """An error with this message about a line (the first is 1), or about the whole file."""
        return record_error(self.name, message, f"line {line}" if line else "")

    def errors_at(self, lines: Sequence[int]) -> Callable[[str, int | None], AbraceError]:
        """The `error_at` of `checked_reading` for samples that are in these `lines`."""
        return lambda message, sample: self.error(message, None if sample is None else lines[sample])

    def number(self, word: str, line: int) -> float:
        """A word in a line as a finite number."""
        try:
            value = float(word) if word.isascii() and "_" not in word else math.nan
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.error(f"{word[:20]!r}, expected a finite number", line)
        return value
