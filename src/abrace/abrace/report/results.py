# SPDX-License-Identifier: Apache-2.0
"""The files of results that a report is made from; each is a JSON object with these keys and no others.

A campaign always writes timing.json and origin.json (its file, command and versions, `abrace.campaign.origin`);
poles.json where it has an identify step, and in a folder of the step's name the validity.json of the node `identify`;
each validate step has a comparison.json in a folder of its name, each ambient step the ambient.json of the node
`ambient`.

poles.json, from an identify step; frequencies [rad/s], slowest first; `true` is [] if the rig's own are unknown::

    {"rig": "ncree_three_storey",
     "table":   {"identified": [{"frequency": 7.28, "damping_ratio": 0.0151}, ...], "true": [...]},
     "command": {"identified": [...], "true": [...]}}

comparison.json, from a validate step; every quantity of the rig in the same order in all three; cm, g, kgf
(`abrace_core.response.in_paper_units`); channels that never move may be missing in `simulated_vs_measured`;
`uncontrolled` is null where no such test was made, `simulated` where no model predicted it (then there is no agreement
with one either); `clipped` are samples at the end of a sensor's range, null where the
bag does not say::

    {"test": {"record": "el_centro", "peak_acceleration": 0.980665, "controller": "lqg3",
              "rig": "ncree_three_storey"},
     "measured": {"x1": {"peak": 1.10, "rms": 0.16}, ..., "U": {...}}, "simulated": {...}, "uncontrolled": {...},
     "simulated_vs_measured": {"x1": {"correlation": 0.998, "normalised_rms_error": 0.05, "noise_free_error": 0.04},
                               ...},
     "peak_rms_error": 0.01,
     "clipped": {"measured": {"a2": 14}, "uncontrolled": {}},
     "validity": {"check": "prediction", "where": "a1", "value": 0.0004, "limit": 0.03, "verdict": "trust", ...},
     "other_models": {"reduced": {"simulated_vs_measured": {...}, "peak_rms_error": 0.03}, ...}}

validity.json, from an identify step; `limit` is that beyond which care is needed::

    {"verdict": "trust with care", "causes": ["friction"],
     "findings": [{"check": "friction", "where": "storey 1", "value": 0.004, "limit": 0.0002, "unit": "",
                   "verdict": "trust with care", "cause": "friction", "meaning": "...", "advice": "..."}, ...],
     "not_checked": {}}

timing.json, from the campaign; `samples`, `run_seconds` (from the first sample to the last) and `lost_samples`, which
are not in the bag, for tests alone; of those in real time `missed_deadlines`, answers that came too late to act from
the next sample on. What happened in a test is counted in samples: `clipped` by channel, at an end of its range,
`saturated`, `rate_limited`, `table_limited`, `stop_pressed`, `late`. `failed` is there where a step ended it all::

    {"lockstep": true, "sample_rate": 500.0,
     "steps": [{"name": "table_noise", "wall_seconds": 41.3, "samples": 120000, "run_seconds": 38.0, "lost_samples": 0,
                "clipped": {"a2": 14}, "saturated": 3},
               {"name": "model", "wall_seconds": 7.2}],
     "failed": {"step": "lqg3", "cause": "..."}}
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal, TypeVar

import pydantic

from abrace_core.config_file import Checked
from abrace_core.config_mistakes import mistakes
from abrace_core.errors import AbraceError, not_json
from abrace_core.response import PAPER_RIG, TABLE_1_EXPERIMENT

Positive = Annotated[float, pydantic.Field(gt=0)]
NonNegative = Annotated[float, pydantic.Field(ge=0)]
Count = Annotated[int, pydantic.Field(ge=0)]
VerdictWords = Literal["trust", "trust with care", "don't trust"]


class Pole(Checked):
    """A complex pair of poles: frequency [rad/s] and damping ratio."""

    frequency: Positive
    damping_ratio: float


class Poles(Checked):
    """Poles identified from one test, and the rig's own."""

    identified: Annotated[tuple[Pole, ...], pydantic.Field(min_length=1)]
    true: tuple[Pole, ...]


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


class Cells(Checked):
    """Peak and rms of a quantity [cm, g or kgf]."""

    peak: NonNegative
    rms: NonNegative


class Agreement(Checked):
    """Agreement of the simulation in one channel."""

    correlation: Annotated[float, pydantic.Field(ge=-1.000001, le=1.000001)]
    normalised_rms_error: NonNegative
    noise_free_error: NonNegative


class ValidityFinding(Checked):
    """What one check of an identification found."""

    check: str
    where: str
    value: float
    limit: float
    unit: str
    verdict: VerdictWords
    cause: str | None
    meaning: str
    advice: str


class Prediction(Checked):
    """Agreement of a model's simulation."""

    simulated_vs_measured: dict[str, Agreement]
    peak_rms_error: NonNegative


class Comparison(Checked):
    """comparison.json."""

    test: Facts
    measured: dict[str, Cells]
    simulated: dict[str, Cells] | None
    uncontrolled: dict[str, Cells] | None
    simulated_vs_measured: dict[str, Agreement] = {}
    peak_rms_error: NonNegative | None = None
    clipped: dict[str, dict[str, Count] | None] = {}
    validity: ValidityFinding | None = None
    other_models: dict[str, Prediction] = {}

    @pydantic.model_validator(mode="after")
    def _same_rows(self) -> Comparison:
        rows = list(self.measured)
        for name in ("simulated", "uncontrolled"):
            given = getattr(self, name)
            if given is not None and list(given) != rows:
                raise ValueError(f"{name} with the rows of measured, {' '.join(rows)}")
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


class AmbientMode(pydantic.BaseModel):
    """A mode from ambient vibration: frequency [rad/s], damping ratio, their standard deviations."""

    frequency: Positive
    damping_ratio: float
    frequency_deviation: NonNegative
    damping_ratio_deviation: NonNegative


class ModeChange(pydantic.BaseModel):
    """A mode [rad/s] before and after, relative changes, and the probability that chance makes one as large."""

    before: Positive
    after: Positive
    frequency_change: float
    damping_change: float
    probability: Annotated[float, pydantic.Field(ge=0, le=1)]


class BuildingChange(pydantic.BaseModel):
    """What has changed since an earlier ambient test."""

    changed: bool
    modes: tuple[ModeChange, ...]


class AmbientResult(pydantic.BaseModel):
    """ambient.json, as far as the report has it."""

    seconds: Positive
    channels: tuple[str, ...]
    modes: tuple[AmbientMode, ...]
    change: BuildingChange | None = None


class ValidityResult(Checked):
    """validity.json."""

    verdict: VerdictWords
    causes: tuple[str, ...]
    findings: tuple[ValidityFinding, ...]
    not_checked: dict[str, str]


class PoleInterval(pydantic.BaseModel):
    """A pole pair with the standard deviations of frequency [rad/s] and damping ratio, where the fit has them."""

    frequency: Positive
    damping_ratio: float
    frequency_deviation: NonNegative | None = None
    damping_ratio_deviation: NonNegative | None = None


class PoleIntervals(pydantic.BaseModel):
    """poles.json of the node `identify`: pairs of each test and those of both tests together."""

    table: tuple[PoleInterval, ...]
    command: tuple[PoleInterval, ...]
    common: tuple[PoleInterval, ...]


class LeastMargins(pydantic.BaseModel):
    """Gain margin [dB], phase margin [deg], delay margin [s] (None: any) and sensitivity peak."""

    gain: float | None
    phase: float | None
    delay: float | None
    sensitivity_peak: float | None


class ProofModel(pydantic.BaseModel):
    """A controller's predicted behaviour with one model."""

    name: str
    order: int
    stable: bool
    margins: dict[str, LeastMargins] | None = None


class ProofResult(pydantic.BaseModel):
    """NAME_proof.json of the node `design`, as far as the report has it."""

    summary: str
    margins: LeastMargins
    least_damping_kept: float | None
    accepted: tuple[str, ...]
    models: tuple[ProofModel, ...]


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
    comparisons: dict[str, Comparison]
    timing: Timing
    ambient: dict[str, AmbientResult]
    validity: dict[str, ValidityResult]
    intervals: dict[str, PoleIntervals] = field(default_factory=dict)
    proofs: dict[str, ProofResult] = field(default_factory=dict)
    origin: Origin | None = None

    @property
    def rigs(self) -> set[str]:
        """Names of the rigs that were identified or compared."""
        named = {one.test.rig for one in self.comparisons.values()} | ({self.poles.rig} if self.poles else set())
        return named - {""}

    @property
    def main(self) -> Comparison | None:
        """The comparison that is the paper's, or else the first."""
        comparisons = list(self.comparisons.values())
        return next((one for one in comparisons if one.is_the_papers), comparisons[0] if comparisons else None)


Content = TypeVar("Content", bound=pydantic.BaseModel)


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
        of_steps("comparison.json", Comparison),
        timing,
        of_steps("ambient.json", AmbientResult),
        of_steps("validity.json", ValidityResult),
        of_steps("poles.json", PoleIntervals),
        of_steps("{step}_proof.json", ProofResult),
        _read(origin, Origin) if origin.exists() else None,
    )


def _read(path: Path, schema: type[Content]) -> Content:
    try:
        return schema.model_validate(json.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise AbraceError(f"results file {path}: {error.strerror}") from error
    except pydantic.ValidationError as error:
        raise AbraceError(f"results file {path}: {mistakes(error, schema)[0]}") from error
    except ValueError as error:
        raise AbraceError(f"results file {path}: {not_json(error)}") from error
