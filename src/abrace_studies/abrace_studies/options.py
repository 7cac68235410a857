# SPDX-License-Identifier: Apache-2.0
"""The options of the studies: what they vary, and where they are computed."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, ClassVar

import pydantic
from pydantic import Field

from abrace_core.files.options import Band, Count, NamedNumbers, Names, NonNegative, Options
from abrace_lqg.proof.limits import ForceLimit  # noqa: TC001 - pydantic reads the annotation
from abrace_lqg.weights import KindWeights

if TYPE_CHECKING:
    from collections.abc import Sequence

    from abrace_lqg.weights import Weights


def _rising(values: tuple[float, ...]) -> tuple[float, ...]:
    if not all(low < high for low, high in pairwise(values)):
        raise ValueError("numbers that rise")
    return values


def _lower_first(span: tuple[float, float]) -> tuple[float, float]:
    if span[0] > span[1]:
        raise ValueError("the lower power of ten first")
    return span


def _one_each(limits: dict[str, tuple[float, ...]]) -> dict[str, tuple[float, ...]]:
    for name, values in limits.items():
        if len(values) != 1 or not values[0] > 0:
            raise ValueError(f"one limit above 0 of {name}")
    return limits


Rising = Annotated[tuple[Annotated[float, Field(ge=1e-6)], ...], Field(min_length=1), pydantic.AfterValidator(_rising)]
Power = Annotated[float, Field(ge=-12, le=12)]
Span = Annotated[
    tuple[Power, Power],
    pydantic.AfterValidator(_lower_first),
    Field(description="lowest and highest power of ten that this weight is multiplied by"),
]
KEPT = (0.0, 0.0)
"""The span of a weight that is not varied."""


SPANS = (*(kind for kind in KindWeights.model_fields if kind != "command"), "noise_to_excitation")
"""Weights that can be varied; the command's cannot, as only ratios matter."""


class StudyOptions(Options):
    """Options of every study of closed loops."""

    disturbance: str = Field(
        default="",
        description="name of the input that disturbs; empty: w, or the only one that is no command, or the command's "
        "own place",
    )
    noise: tuple[Count, ...] = Field(default=(), description="seeds of banded noise, a ground motion for each")
    noise_band: Band = Field(default=(0.1, 10.0), description="Hz, lowest and highest frequency of the noise")
    noise_duration: Annotated[float, Field(ge=2)] = Field(default=40.0, description="s, of each noise")
    models: Annotated[int, Field(ge=1)] = Field(
        default=1,
        description="models: the one to simulate with, others drawn from the covariance of its parameters",
    )
    faults: NamedNumbers = Field(
        default={}, description="failing sensors, such as a1=0: reading over true value, 0 is dead; one at a time"
    )
    seed: Count = Field(default=0, description="seed of the models drawn, and of quasi-random sets")
    sample_period: NonNegative = Field(default=0.0, description="s, of the loops; 0: that of controllers and tests")
    scheduler: str = Field(default="", description="address of a Dask scheduler; empty: this machine computes")
    workers: Count = Field(
        default=0, description="processes of this machine; 0: one for some seconds of work, else one for each core"
    )


class FragilityOptions(StudyOptions):
    """Options of a fragility study."""

    who: ClassVar[str] = "fragility"

    limits: Annotated[NamedNumbers, pydantic.AfterValidator(_one_each), Field(min_length=1)] = Field(
        description="quantities and their limits, such as d1=0.02: x1, d1 (drift), xf, a1, f, U in m, m/s^2, N; those "
        "of other names in their SI unit"
    )
    intensities: Rising = Field(
        description="m/s^2, peak accelerations to which motions are scaled, rising; of another disturbance in its SI "
        "unit"
    )


class ExploreOptions(StudyOptions):
    """Options of an exploration of weights; a span for each weight that can be varied."""

    who: ClassVar[str] = "exploration"

    commands: Names = Field(
        default=(), description="names of the inputs that the controller commands; none: all but the disturbance"
    )
    measured: Names = Field(default=(), description="names of the measured quantities; none: as in the weights")
    signals: Annotated[
        Span, Field(description="lowest and highest power of ten that each weight by name is multiplied by")
    ] = (-2.0, 1.0)
    displacement: Span = (-2.0, 1.0)
    stroke: Span = KEPT
    acceleration: Span = (-2.0, 1.0)
    force: Span = KEPT
    drift: Span = KEPT
    base_shear: Span = KEPT
    noise_to_excitation: Span = (-1.0, 1.0)
    sets: Annotated[int, Field(ge=1)] = Field(default=256, description="sets tried in addition to the given weights")
    peak_acceleration: Rising = Field(
        default=(0.980665,),
        description="m/s^2, one or several, rising, to each of which motions are scaled; of another disturbance in "
        "its SI unit",
    )
    excitation_rms: Annotated[float, Field(ge=1e-9)] = Field(
        default=0.25,
        description="m/s^2, rms of the ground acceleration to which weights with a scale are scaled, as for design; of "
        "another disturbance in its own SI unit",
    )
    quantile: Annotated[float, Field(ge=0.01, le=1)] = Field(
        default=0.9, description="share of the loops that respond no more than the robust response"
    )
    force_limit: ForceLimit = Field(
        default=(),
        description="N, greatest force of one brace, of every group or of each (of a command of another unit in its SI "
        "unit); none: that of the rig of the tests",
    )

    def spans(self, weights: Weights, outputs: Sequence[str]) -> dict[str, tuple[float, float]]:
        """The span of every weight by name, of those of the `outputs` by name too: `signals.NAME`.

        With weights by name a kind that has no weight keeps none, unless its span is asked for.
        """
        kinds = weights.weights.model_dump()
        spans = {
            name: getattr(self, name)
            for name in SPANS
            if not weights.signals or name in self.model_fields_set or kinds.get(name, 1.0)
        }
        return spans | {
            f"signals.{name}": self.signals for name, one in weights.signals.items() if one and name in outputs
        }
