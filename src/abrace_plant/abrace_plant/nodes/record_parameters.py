"""Parameters of reading and treating a record: rows of the tables of the nodes `ground_motion` and `record`."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from abrace_core.node import Parameter
from abrace_plant.records.files import read_record
from abrace_plant.records.reading import UNITS
from abrace_plant.records.record import Record
from abrace_plant.records.treatment import BASELINES, Treatment

DEFAULT = Treatment()

RECORD_PARAMETERS = [
    Parameter("sample_rate", 500.0, "Hz, of the rig", minimum=1.0),
    Parameter("unit", "", "unit of the acceleration, for a file that does not state it", choices=(*UNITS, "")),
    Parameter("record_sample_period", 0.0, "s, for a file without times", minimum=0.0),
    Parameter("channel", "", "which of several in a file: column, variable, channel number, or topic:field of a bag"),
    Parameter("baseline", DEFAULT.baseline, "polynomial removed from an acceleration", choices=tuple(BASELINES)),
    Parameter("time_scale", DEFAULT.time_scale, "played duration over the record's; 1.0: as recorded", minimum=0.001),
    Parameter("taper", DEFAULT.taper, "s, length of a linear taper at each end of a record; 0.0: none", minimum=0.0),
    Parameter("low_cut", DEFAULT.low_cut, "Hz, high-pass filter of a record; 0.0: none", minimum=0.0),
    Parameter("band_limit", 25.0, "Hz, low-pass filter of a record; 0.0: none", minimum=0.0),
    Parameter("peak_acceleration", DEFAULT.peak_acceleration, "m/s^2, PGA of a motion; 0.0: as recorded", minimum=0.0),
    Parameter("duration", DEFAULT.duration, "s to which a record is padded or cut; 0.0: whole", minimum=0.0),
]
"""All but the parameter `record`, which each node describes itself."""


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
