# SPDX-License-Identifier: Apache-2.0
"""Parameters of a table's motion, and the motion that they describe: for `ground_motion`, `record` and campaigns."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core import AbraceError
from abrace_core.files.installed import find_file
from abrace_core.model.multisine import LINES
from abrace_core.model.noise import LONGEST_SIGNAL
from abrace_core.model.table_signals import table_multisine, table_noise
from abrace_node.parameters import Parameter, parameters_of
from abrace_plant.records.asked import parameter
from abrace_plant.records.files import read_record
from abrace_plant.records.options import RecordOptions, Treatment
from abrace_plant.records.record import Record
from abrace_plant.records.table_motion import RECORD_REMEDIES, SIGNAL_REMEDIES, check_motion
from abrace_plant.records.treatment import prepare
from abrace_plant.rig.table_file import TableOfRig, load_table

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.safety.table_stop import Table

WHITE_NOISE, MULTISINE = "white_noise", "multisine"

RECORD_PARAMETERS = [
    Parameter(
        "rig",
        "ncree_three_storey",
        "rig with the table: a name in the package's configuration or a file",
        required=True,
    ),
    *parameters_of(RecordOptions),
    Parameter(
        "duration", 0.0, "s to which a record is padded or cut; 0.0: its own", minimum=0.0, maximum=LONGEST_SIGNAL
    ),
]
"""All but the parameter `record`, which each node describes itself."""
MOTION_PARAMETERS = [
    *RECORD_PARAMETERS,
    Parameter("rms", 0.25, "m/s^2, rms of white noise or a multisine of the given duration", minimum=0.0),
    Parameter("band", [0.1, 10.0], "Hz, lowest and highest frequency of white noise or a multisine", minimum=0.0),
    Parameter("seed", 1, "seed of white noise or a multisine", minimum=0),
    Parameter(
        "period",
        32.768,
        "s, of a multisine; as many as fit in duration are played",
        minimum=0.01,
        maximum=LONGEST_SIGNAL,
    ),
    Parameter("lines", "odd", "frequency lines of a multisine; orthogonal to a command on other lines", choices=LINES),
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
    unit, period, channel = given.unit or None, given.record_sample_period or None, given.channel or None
    return read_record(record, unit, period, channel, parameter)


def rig_as_given(given: Any) -> TableOfRig:
    """Table and sample rate, from the rig file that the parameters name.

    Parameters
    ----------
    given
        Values of `RECORD_PARAMETERS`.

    Raises
    ------
    AbraceError
        As in `load_table`.
    """
    return load_table(find_file(given.rig, "abrace_plant", "config", ".yaml", "rig"))


def motion_as_given(
    given: Any,
    table: Table,
    sample_rate: float,
    record: str,
    peak_acceleration: float,
    duration: float,
    displacement: float = 0.0,
) -> NDArray[np.float64]:
    """A motion that the table can play, (samples,) [m/s^2] at the rig's sample rate.

    Parameters
    ----------
    given
        Values of `MOTION_PARAMETERS`.
    table
        Its limits.
    sample_rate
        Of the rig [Hz].
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
        changed = {"peak_acceleration": peak_acceleration, "duration": duration}
        treatment = Treatment.of_values(given).model_copy(update=changed)
        recorded = read_as_given(record, given)
        length = len(recorded.acceleration) * recorded.sample_period * treatment.time_scale
        if length > LONGEST_SIGNAL:
            raise AbraceError(f"ground motion {recorded.name}: {length:g} s, expected at most {LONGEST_SIGNAL:g} s")
        motion = prepare(recorded, sample_rate, treatment)
    else:
        motion = _signal(given, sample_rate, record, duration)
        motion = motion * (peak_acceleration / np.abs(motion).max()) if peak_acceleration else motion
    remedies = RECORD_REMEDIES if is_record else SIGNAL_REMEDIES
    check_motion(motion, sample_rate, table, record, remedies, displacement)
    return motion


def _signal(given: Any, rate: float, kind: str, duration: float) -> NDArray[np.float64]:
    """White noise or a multisine."""
    if duration == 0:
        raise AbraceError(f"parameter duration: 0.0, expected the length of the {kind} in seconds")
    if len(given.band) != 2:
        raise AbraceError(f"parameter band: {given.band}, expected two frequencies in Hz")
    band, rms, seed = (given.band[0], given.band[1]), given.rms, given.seed
    if kind == WHITE_NOISE:
        return table_noise(round(duration * rate), rate, band, rms, seed)
    return table_multisine(duration, given.period, rate, band, rms, seed, given.lines)
