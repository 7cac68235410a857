# SPDX-License-Identifier: Apache-2.0
"""Parameters of a table's motion, and the motion that they describe: for `ground_motion`, `record` and campaigns."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core.errors import AbraceError
from abrace_core.multisine import LINES
from abrace_core.node import Parameter, find_file
from abrace_core.table_signals import table_multisine, table_noise
from abrace_plant.records.files import read_record
from abrace_plant.records.reading import UNITS
from abrace_plant.records.record import Record
from abrace_plant.records.table_motion import RECORD_REMEDIES, SIGNAL_REMEDIES, check_motion
from abrace_plant.records.treatment import BAND_LIMIT, BASELINES, Treatment, prepare
from abrace_plant.rig.table_file import load_table

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.safety.table_stop import Table

WHITE_NOISE, MULTISINE = "white_noise", "multisine"

DEFAULT = Treatment()

RECORD_PARAMETERS = [
    Parameter(
        "rig",
        "ncree_three_storey",
        "rig with the table: a name in the package's configuration or a file",
        required=True,
    ),
    Parameter("sample_rate", 500.0, "Hz, sample rate of the rig", minimum=1.0),
    Parameter("unit", "", "unit of the acceleration, for a file that does not state it", choices=(*UNITS, "")),
    Parameter("record_sample_period", 0.0, "s, sample period of a file without times", minimum=0.0),
    Parameter("channel", "", "for a file with several: column, variable, channel number, or topic:field of a bag"),
    Parameter("baseline", DEFAULT.baseline, "polynomial removed from an acceleration", choices=tuple(BASELINES)),
    Parameter("time_scale", DEFAULT.time_scale, "played duration over the record's; 1.0: as recorded", minimum=0.001),
    Parameter("taper", DEFAULT.taper, "s, length of a linear taper at each end of a record; 0.0: none", minimum=0.0),
    Parameter("low_cut", DEFAULT.low_cut, "Hz, high-pass filter of a record; 0.0: none", minimum=0.0),
    Parameter("band_limit", BAND_LIMIT, "Hz, low-pass filter of a record; 0.0: none", minimum=0.0),
    Parameter("peak_acceleration", DEFAULT.peak_acceleration, "m/s^2, PGA of a motion; 0.0: as recorded", minimum=0.0),
    Parameter("duration", DEFAULT.duration, "s to which a record is padded or cut; 0.0: its own length", minimum=0.0),
]
"""All but the parameter `record`, which each node describes itself."""
MOTION_PARAMETERS = [
    *RECORD_PARAMETERS,
    Parameter("rms", 0.25, "m/s^2, rms of white noise or a multisine of the given duration", minimum=0.0),
    Parameter("band", [0.1, 10.0], "Hz, lowest and highest frequency of white noise or a multisine", minimum=0.0),
    Parameter("seed", 1, "seed of white noise or a multisine", minimum=0),
    Parameter("period", 32.768, "s, of a multisine; as many as fit in duration are played", minimum=0.01),
    Parameter("lines", "odd", "frequency lines of a multisine; orthogonal to a command on other lines", choices=LINES),
    Parameter("slope", 0.0, "of a multisine: power of the frequency with which amplitudes grow"),
]
"""The same with those of white noise and multisines."""


def read_as_given(record: str, given: Any) -> Record:
    """The record of a name or file, read with the parameters.

    Parameters
    ----------
    record
        A known name or a file.
    given
        Values of `RECORD_PARAMETERS`.
    """
    return read_record(record, given.unit or None, given.record_sample_period or None, given.channel or None)


def treatment_as_given(given: Any) -> Treatment:
    """The treatment that the parameters describe.

    Parameters
    ----------
    given
        Values of `RECORD_PARAMETERS`.
    """
    return Treatment(**{field.name: getattr(given, field.name) for field in fields(Treatment)})


def table_as_given(given: Any) -> Table:
    """The table's limits, from the rig file that the parameters name.

    Parameters
    ----------
    given
        Values of `RECORD_PARAMETERS`.

    Raises
    ------
    AbraceError
        As in `load_table`; or if `sample_rate` is not the rig's.
    """
    rig = load_table(find_file(given.rig, "abrace_plant", "config", ".yaml", "rig"))
    if given.sample_rate != rig.sample_rate:
        raise AbraceError(
            f"parameter sample_rate: {given.sample_rate}, expected {rig.sample_rate}, as the rig {rig.name} has"
        )
    return rig.table.table()


def motion_as_given(
    given: Any, table: Table, record: str, peak_acceleration: float, duration: float, displacement: float = 0.0
) -> NDArray[np.float64]:
    """A motion that the table can play, (samples,) [m/s^2] at the rig's sample rate.

    Parameters
    ----------
    given
        Values of `MOTION_PARAMETERS`.
    table
        Its limits.
    record
        A known name, a file, "white_noise" or "multisine".
    peak_acceleration
        [m/s^2]; 0: as recorded, or as the rms has it.
    duration
        [s]; 0: the whole record.
    displacement
        Where the table rests before [m].

    Raises
    ------
    AbraceError
        If there is no such motion, or it exceeds the table's limits.
    """
    is_record = record not in (WHITE_NOISE, MULTISINE)
    if is_record:
        treatment = replace(treatment_as_given(given), peak_acceleration=peak_acceleration, duration=duration)
        motion = prepare(read_as_given(record, given), given.sample_rate, treatment)
    else:
        motion = _signal(given, record, duration)
        motion = motion * (peak_acceleration / np.abs(motion).max()) if peak_acceleration else motion
    remedies = RECORD_REMEDIES if is_record else SIGNAL_REMEDIES
    check_motion(motion, given.sample_rate, table, record, remedies, displacement)
    return motion


def _signal(given: Any, kind: str, duration: float) -> NDArray[np.float64]:
    """White noise or a multisine."""
    if duration == 0:
        raise AbraceError(f"parameter duration: 0.0, expected the length of the {kind} in seconds")
    if len(given.band) != 2:
        raise AbraceError(f"parameter band: {given.band}, expected two frequencies in Hz")
    rate, band, rms, seed = given.sample_rate, (given.band[0], given.band[1]), given.rms, given.seed
    if kind == WHITE_NOISE:
        return table_noise(round(duration * rate), rate, band, rms, seed)
    return table_multisine(duration, given.period, rate, band, rms, seed, given.lines, given.slope)
