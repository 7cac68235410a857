# SPDX-License-Identifier: Apache-2.0
"""The ground motions and brace excitations that a campaign file may ask for."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import pydantic

from abrace.campaign.names import Band, OfGroups, Positive, Text, Whole, from_folder
from abrace_core.files.config_file import Checked
from abrace_plant.records.files import KNOWN_RECORDS
from abrace_plant.records.options import RecordOptions

Lines = Literal["all", "odd", "even"]

WHITE_NOISE, MULTISINE = "white_noise", "multisine"


class Drive(Checked):
    """A motion of the table, or an excitation of the braces."""

    @property
    def parameters(self) -> dict[str, Any]:
        """Parameters of its node that the file gives: key and parameter have the same name."""
        given = self.model_dump(exclude_none=True)
        return {key: list(value) if isinstance(value, tuple) else value for key, value in given.items()}


class BandedNoise(Drive):
    """Banded white noise: band [Hz], seed. The rms is that of the table or of the braces, below."""

    band: Band
    seed: Whole


class Multisine(BandedNoise):
    """A periodic multisine: as many whole periods [s] as fit in a test, on "all", "odd" or "even" lines."""

    period: Positive = 32.768
    lines: Lines = "odd"

    @pydantic.model_validator(mode="after")
    def _above_zero(self) -> Multisine:
        if self.band[0] == 0:
            raise ValueError("a band that begins above 0 Hz: displacement grows with 1 / frequency^2")
        return self


class ExcitationNoise(BandedNoise):
    """Brace commands of banded white noise: rms [N] of all groups or of each; 0: a group at rest."""

    rms: OfGroups
    signal: Literal["white_noise"] = "white_noise"


class ExcitationMultisine(Multisine):
    """Brace commands of a multisine: rms as of `ExcitationNoise`."""

    rms: OfGroups
    signal: Literal["multisine"]


def _signal(content: object) -> object:
    return content.get("signal", WHITE_NOISE) if isinstance(content, dict) else getattr(content, "signal", None)


Excitation = Annotated[
    Annotated[ExcitationNoise, pydantic.Tag(WHITE_NOISE)] | Annotated[ExcitationMultisine, pydantic.Tag(MULTISINE)],
    pydantic.Discriminator(_signal),
]


class WhiteNoise(BandedNoise):
    """A table motion of banded white noise: rms [m/s^2]."""

    rms: Positive
    record: Literal["white_noise"]


class MultisineMotion(Multisine):
    """A table motion of a multisine: rms [m/s^2]."""

    rms: Positive
    record: Literal["multisine"]


def _known_or_file(record: str, info: pydantic.ValidationInfo) -> str:
    return record if record in KNOWN_RECORDS else from_folder(record, info)


class RecordMotion(RecordOptions):
    """A table motion from a record: a known name or a file, how it is read, and how it is treated.

    Every other key is the parameter of the same name of the node `ground_motion`, with its default.
    """

    record: Annotated[Text, pydantic.AfterValidator(_known_or_file)]

    @property
    def parameters(self) -> dict[str, Any]:
        """Parameters of its node that the file gives, and its peak."""
        return self.model_dump(include={*self.model_fields_set, "peak_acceleration"})


def _motion_kind(content: object) -> object:
    record = content.get("record") if isinstance(content, dict) else getattr(content, "record", None)
    return record if record in (WHITE_NOISE, MULTISINE) else "record"


GroundMotion = Annotated[
    Annotated[WhiteNoise, pydantic.Tag(WHITE_NOISE)]
    | Annotated[MultisineMotion, pydantic.Tag(MULTISINE)]
    | Annotated[RecordMotion, pydantic.Tag("record")],
    pydantic.Discriminator(_motion_kind),
]
