"""The parameters that say how a record is read and treated: one table for the nodes that play records and show them."""

from __future__ import annotations

from typing import Any

from abrace_core.node import Parameter
from abrace_plant.records.files import read_record
from abrace_plant.records.reading import UNITS
from abrace_plant.records.record import Record
from abrace_plant.records.treatment import BASELINES, Treatment

NOTHING = Treatment()

RECORD_PARAMETERS = [
    Parameter("sample_rate", 500.0, "Hz, of the rig", minimum=1.0),
    Parameter("unit", "", "of a file that does not say it", choices=(*UNITS, "")),
    Parameter("record_sample_period", 0.0, "s, of a file without times", minimum=0.0),
    Parameter("channel", "", "of a file with several: column, variable, channel number, or topic:field of a bag"),
    Parameter("baseline", NOTHING.baseline, "removed from a record's acceleration", choices=tuple(BASELINES)),
    Parameter("time_scale", NOTHING.time_scale, "played time over a record's; 1.0: as recorded", minimum=0.001),
    Parameter("taper", NOTHING.taper, "s at each end over which a record rises and falls; 0.0: none", minimum=0.0),
    Parameter("low_cut", NOTHING.low_cut, "Hz, below which a record is cut off; 0.0: not at all", minimum=0.0),
    Parameter("band_limit", 25.0, "Hz, above which a record is cut off; 0.0: not at all", minimum=0.0),
    Parameter(
        "peak_acceleration", NOTHING.peak_acceleration, "m/s^2 that a motion is scaled to; 0.0: as it is", minimum=0.0
    ),
    Parameter("duration", NOTHING.duration, "s that a record is padded or cut to; 0.0: whole", minimum=0.0),
]
"""Rows for the table of a node; how its own parameter `record` is meant is the node's to say."""


def read_as_given(record: str, given: Any) -> Record:
    """The record of a name or file, read as the parameters say.

    Parameters
    ----------
    record
        A known name or a file.
    given
        Values of `RECORD_PARAMETERS`.
    """
    return read_record(record, given.unit or None, given.record_sample_period or None, given.channel or None)


def treatment_as_given(given: Any) -> Treatment:
    """The treatment that the parameters say.

    Parameters
    ----------
    given
        Values of `RECORD_PARAMETERS`.
    """
    return Treatment(
        baseline=given.baseline,
        time_scale=given.time_scale,
        taper=given.taper,
        low_cut=given.low_cut,
        band_limit=given.band_limit,
        peak_acceleration=given.peak_acceleration,
        duration=given.duration,
    )
