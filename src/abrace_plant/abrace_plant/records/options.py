# SPDX-License-Identifier: Apache-2.0
"""Options of a record that is played: for the nodes `ground_motion` and `record`, campaigns and `abrace.simulate`."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import AfterValidator, Field

from abrace_core.files.options import Count, NonNegative, Options

BAND_LIMIT = 25.0
"""Highest frequency of the motions that nodes play, unless another is given [Hz]."""
LOWEST_BAND_LIMIT = 0.1
"""[Hz]; no earthquake is left below it, and the filter, whose length grows as it falls, would take minutes."""


def _not_too_low(limit: float) -> float:
    if 0 < limit < LOWEST_BAND_LIMIT:
        raise ValueError(f"0 or at least {LOWEST_BAND_LIMIT:g} Hz")
    return limit


BandLimit = Annotated[NonNegative, AfterValidator(_not_too_low)]


class PlayedOptions(Options):
    """How a record is treated before it is played, in the order of the steps.

    Times and frequencies are those of the played motion, after the time scaling.

    Parameters
    ----------
    baseline
        The polynomial in the acceleration whose removal leaves the least mean square velocity (Berg and Housner, 1961;
        of its limits, Boore and Bommer, 2005).
    time_scale
        Time of the played motion over time of the record: the square root of the length scale for a model under the
        same gravity and the same accelerations.
    taper
        Length of the linear taper at each end of the record [s]. Without a low cut it makes velocity and displacement
        drift.
    low_cut
        Frequency below which the motion is removed [Hz], without a shift in time; the amplitude is half there, as after
        a Butterworth filter of order 4 forwards and backwards. The motion begins and ends with velocity zero.
    band_limit
        End of the low-pass filter [Hz]; below 0.79 times it the motion is unchanged within 1e-5. 0, or more than half
        of the record's or of the rig's sample rate: that half, below 0.8 times which it is unchanged within 1e-5, and
        no filter where the two rates are equal.
    peak_acceleration
        Greatest absolute value of the whole treated motion [m/s^2], met exactly, before a longer motion is cut.
    """

    who: ClassVar[str] = "ground motion"

    baseline: Literal["none", "constant", "linear", "quadratic"] = Field(
        default="none", description="polynomial removed from an acceleration"
    )
    time_scale: Annotated[float, Field(ge=0.001)] = Field(
        default=1.0, description="played duration over the record's; 1.0: as recorded"
    )
    taper: NonNegative = Field(
        default=0.0, description="s, length of a linear taper at each end of a record; 0.0: none"
    )
    low_cut: NonNegative = Field(default=0.0, description="Hz, high-pass filter of a record; 0.0: none")
    band_limit: BandLimit = Field(default=BAND_LIMIT, description="Hz, low-pass filter of a record; 0.0: none")
    peak_acceleration: NonNegative = Field(default=0.0, description="m/s^2, PGA of a motion; 0.0: as recorded")


class Treatment(PlayedOptions):
    """The same with no low-pass filter unless one is given, and a length.

    Parameters
    ----------
    duration
        [s]; a shorter motion is followed by zeros, a longer one is cut and comes to rest (acceleration and
        velocity zero) over its last 0.5 s. 0: the whole record.
    """

    band_limit: BandLimit = 0.0
    duration: NonNegative = 0.0


class RecordOptions(PlayedOptions):
    """How a record is played, and how a file is read."""

    unit: Literal["g", "m/s^2", "cm/s^2", "mm/s^2", "mg", "in/s^2", ""] = Field(
        default="", description="unit of the acceleration, for a file that does not state it"
    )
    record_sample_period: NonNegative = Field(
        default=0.0, description="s, sample period of a file that does not state it, or rounds its times"
    )
    channel: str = Field(
        default="", description="of a file with several: name or number of a column, variable, channel; of a bag as a3"
    )


class SimulateOptions(RecordOptions):
    """Options of a simulated test; a motion that is an array or a Run has no band limit unless one is given."""

    who: ClassVar[str] = "simulate"

    duration: NonNegative = Field(
        default=0.0, description="s, to which record and command are padded or cut, or of the noise; 0: all of them"
    )
    seed: Count = Field(default=0, description="seed of the sensors; white noise has the next ones")
    sample_period: NonNegative = Field(
        default=0.0, description="s, of a simulated model; 0: that of the controller, or of the tests of the model"
    )
    disturbance: str = Field(
        default="",
        description="of a model: name of the input that the record drives; empty: w, or the only one that is no "
        "command, or the command's own place",
    )
