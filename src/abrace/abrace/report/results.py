# SPDX-License-Identifier: Apache-2.0
"""The files of results that a report is made from: JSON objects.

A campaign always writes timing.json and origin.json (its file, command and versions);
poles.json where it has an identify step. Of each identify step the validity.json, of each validate step the
comparison.json and of each ambient step the ambient.json of its node is in a folder of the step's name.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, TypeVar

import pydantic

from abrace_core import AbraceError
from abrace_core.files.config_file import Checked, validated
from abrace_core.files.reading import read_json
from abrace_core.model.response import PAPER_RIG, TABLE_1_EXPERIMENT
from abrace_lqg.proof.checks import Proof
from abrace_sysid.fitting.pole_estimate import PoleInterval
from abrace_sysid.validation import Agreement
from abrace_sysid.validity.finding import Finding, Validity

Positive = Annotated[float, pydantic.Field(gt=0)]
NonNegative = Annotated[float, pydantic.Field(ge=0)]
Count = Annotated[int, pydantic.Field(ge=0)]


class Poles(Checked):
    """Poles identified from one test, and the rig's own."""

    identified: Annotated[tuple[PoleInterval, ...], pydantic.Field(min_length=1)]
    true: tuple[PoleInterval, ...]


class AllPoles(Checked):
    """poles.json: of the rig of this name."""

    rig: str = ""
    table: Poles
    command: Poles


class Facts(Checked):
    """What was compared."""

    record: str
    peak_acceleration: NonNegative
    controller: str
    rig: str = ""

    @property
    def motion(self) -> tuple[str, float]:
        """The record, and its peak acceleration [m/s^2], 0: as recorded."""
        return self.record, self.peak_acceleration


class Cells(Checked):
    """Peak and rms of a quantity [cm, g or kgf]; None: its channel has values that are not finite."""

    peak: NonNegative | None
    rms: NonNegative | None


class Prediction(Checked):
    """Agreement of a model's simulation."""

    simulated_vs_measured: dict[str, Agreement]
    peak_rms_error: NonNegative | None


class ComparedTest(Checked):
    """comparison.json; `simulated` None: no model predicted the test; `uncontrolled` None: there is no such test."""

    test: Facts
    measured: dict[str, Cells]
    simulated: dict[str, Cells] | None
    uncontrolled: dict[str, Cells] | None
    simulated_vs_measured: dict[str, Agreement] = {}
    peak_rms_error: NonNegative | None = None
    clipped: dict[str, dict[str, Count | None] | None] = {}
    validity: Finding | None = None
    other_models: dict[str, Prediction] = {}

    @pydantic.model_validator(mode="after")
    def _same_rows(self) -> ComparedTest:
        rows = list(self.measured)
        if self.uncontrolled is not None and list(self.uncontrolled) != rows:
            raise ValueError(f"uncontrolled with the rows of measured, {' '.join(rows)}")
        if self.simulated is not None and list(self.simulated) != [row for row in rows if row in self.simulated]:
            raise ValueError(f"simulated with rows of measured, in their order, {' '.join(rows)}")
        agreements = [self.simulated_vs_measured, *(one.simulated_vs_measured for one in self.other_models.values())]
        for agreement in agreements:
            if not set(agreement) <= set(rows):
                raise ValueError(f"simulated_vs_measured with rows of measured, {' '.join(rows)}")
        return self

    @property
    def is_the_papers(self) -> bool:
        """Whether this is the test of Table 1: LQG3, El Centro at 0.1 g."""
        facts = self.test
        is_its_motion = facts.record == "el_centro" and abs(facts.peak_acceleration - 0.980665) < 1e-3
        is_its_test = is_its_motion and facts.controller == "lqg3" and facts.rig == PAPER_RIG
        return is_its_test and set(TABLE_1_EXPERIMENT) <= set(self.measured)


class ReportedModeChange(pydantic.BaseModel):
    """A mode [rad/s] before and after, relative changes, and the probability that chance makes one as large."""

    before: Positive
    after: Positive
    frequency_change: float
    damping_change: float
    probability: Annotated[float, pydantic.Field(ge=0, le=1)]


class ReportedChange(pydantic.BaseModel):
    """What has changed since an earlier ambient test."""

    changed: bool
    modes: tuple[ReportedModeChange, ...]


class AmbientResult(pydantic.BaseModel):
    """ambient.json, as far as the report has it."""

    seconds: Positive
    channels: tuple[str, ...]
    modes: tuple[PoleInterval, ...]
    change: ReportedChange | None = None


class CampaignFile(pydantic.BaseModel):
    """The campaign file, as it was."""

    path: str
    sha256: str
    text: str


class Origin(pydantic.BaseModel):
    """origin.json."""

    command: str
    begun: str
    campaign_file: CampaignFile
    versions: dict[str, str]


class StepTiming(Checked):
    """How long a step took, and what happened in a test, counted in samples."""

    name: str
    wall_seconds: NonNegative
    samples: Annotated[int, pydantic.Field(ge=1)] | None = None
    run_seconds: Positive | None = None
    lost_samples: int | None = None
    missed_deadlines: Count | None = None
    clipped: dict[str, Count] = {}
    saturated: Count = 0
    rate_limited: Count = 0
    table_limited: Count = 0
    stop_pressed: Count = 0
    late: Count = 0


class Failed(Checked):
    """The step that ended a campaign, and why."""

    step: str
    cause: str


class Timing(Checked):
    """timing.json."""

    lockstep: bool
    sample_rate: Positive
    steps: tuple[StepTiming, ...]
    failed: Failed | None = None


@dataclass(frozen=True)
class Results:
    """What a campaign measured: by step, in order, comparisons, ambient tests, validity; poles if any."""

    poles: AllPoles | None
    comparisons: dict[str, ComparedTest]
    timing: Timing
    ambient: dict[str, AmbientResult]
    validity: dict[str, Validity]
    intervals: dict[str, dict[str, tuple[PoleInterval, ...]]] = field(default_factory=dict)
    proofs: dict[str, Proof] = field(default_factory=dict)
    origin: Origin | None = None

    @property
    def rigs(self) -> set[str]:
        """Names of the rigs that were identified or compared."""
        named = {one.test.rig for one in self.comparisons.values()} | ({self.poles.rig} if self.poles else set())
        return named - {""}

    @property
    def main(self) -> ComparedTest | None:
        """The comparison that is the paper's, or else the first."""
        comparisons = list(self.comparisons.values())
        return next((one for one in comparisons if one.is_the_papers), comparisons[0] if comparisons else None)


Content = TypeVar("Content")


def read_results(directory: Path | str) -> Results:
    """Read the results in the `directory` of a campaign.

    Raises
    ------
    AbraceError
        Naming the file that is missing or malformed, the key, and what was expected.
    """
    directory = Path(directory)
    if not directory.is_dir():
        raise AbraceError(f"results directory {directory}: expected a directory that a campaign wrote")
    timing = _read(directory / "timing.json", Timing)
    poles = directory / "poles.json"

    origin = directory / "origin.json"

    def of_steps(file: str, schema: type[Content]) -> dict[str, Content]:
        paths = {step.name: directory / step.name / file.format(step=step.name) for step in timing.steps}
        return {step: _read(path, schema) for step, path in paths.items() if path.exists()}

    return Results(
        _read(poles, AllPoles) if poles.exists() else None,
        of_steps("comparison.json", ComparedTest),
        timing,
        of_steps("ambient.json", AmbientResult),
        of_steps("validity.json", Validity),
        of_steps("poles.json", dict[str, tuple[PoleInterval, ...]]),
        of_steps("{step}_proof.json", Proof),
        _read(origin, Origin) if origin.exists() else None,
    )


def _read(path: Path, schema: type[Content]) -> Content:
    return validated(read_json(path, "results"), schema, f"results file {path}")
