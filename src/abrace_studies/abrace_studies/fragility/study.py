# SPDX-License-Identifier: Apache-2.0
"""What a fragility study varies, and the batches in which its closed loops are computed.

Every model is tried with zero command, and with every controller, its sensors intact and with each fault, under every
ground motion at every intensity. A batch is fixed by the study alone, so that its numbers are the same whoever computes
it, and whatever else was computed before.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from abrace_core import AbraceError
from abrace_core.model.linear_model import takes_models
from abrace_core.model.model_ensemble import draw_models
from abrace_lqg.loop import sampled

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_core.model.controller_file import Controller
    from abrace_core.model.linear_model import LinearModel
    from abrace_studies.batches.loop_extremes import Motions

ZERO_COMMAND = "zero command"
INTACT = "none"
BATCH_STEPS = 50_000_000
"""Steps of a batch, at most unless one case has more: a second or two of work."""


@dataclass(frozen=True)
class Fault:
    """What a sensor reads when it fails, as a factor of the truth. 0: it is dead; -1: it is turned around."""

    sensor: str
    factor: float

    @property
    def name(self) -> str:
        """As it is given: `a2=0`."""
        return f"{self.sensor}={self.factor:g}"


class LoopCase(NamedTuple):
    """A model with a controller and a fault, by their numbers, under the motions `first` to `last` (excluded)."""

    model: int
    controller: int | None
    fault: int | None
    first: int
    last: int


@dataclass(frozen=True)
class FragilityStudy:
    """Models, controllers, faults, motions and intensities.

    Parameters
    ----------
    models
        From the ground acceleration and the commands to the outputs, all with the same names.
    controllers
        With different names and one sample period.
    faults
        Faults of one sensor each.
    motions
        Scaled to a measure of intensity of 1.
    motion_names
        Name of each motion.
    intensities
        Factors of the motions: peak ground acceleration [m/s^2].
    sample_period
        [s] of controllers and motions.

    Raises
    ------
    AbraceError
        If they do not fit each other.
    """

    models: tuple[LinearModel, ...]
    controllers: tuple[Controller, ...]
    faults: tuple[Fault, ...]
    motions: Motions
    motion_names: tuple[str, ...]
    intensities: tuple[float, ...]
    sample_period: float

    def __post_init__(self) -> None:
        if not self.models:
            raise AbraceError("fragility: no models, expected one at least")
        if not self.motion_names:
            raise AbraceError("fragility: no ground motions, expected a record or a noise at least")
        rising = all(low < high for low, high in pairwise((0.0, *self.intensities)))
        if not self.intensities or not rising or not np.isfinite(self.intensities[-1]):
            raise AbraceError(f"fragility: intensities {list(self.intensities)}, expected numbers above 0 that rise")
        if len(set(self.motion_names)) < len(self.motion_names):
            raise AbraceError(f"fragility: ground motions {', '.join(self.motion_names)}: expected each once")
        names = [controller.name for controller in self.controllers]
        if len({ZERO_COMMAND, *names}) < 1 + len(names):
            raise AbraceError(f"fragility: controllers {', '.join(names)}: expected a different name for each")
        model = self.models[0]
        for controller in self.controllers:
            if abs(controller.law.sample_period - self.sample_period) > 1e-9 * self.sample_period:
                raise AbraceError(
                    f"controller {controller.name}: every {controller.law.sample_period:g} s, "
                    f"expected the motions' {self.sample_period:g} s"
                )
            missing = [name for name in controller.law.inputs if name not in model.outputs]
            if missing or controller.law.outputs != model.inputs[1:]:
                raise AbraceError(
                    f"controller {controller.name}: from {', '.join(controller.law.inputs)} to "
                    f"{', '.join(controller.law.outputs)}, the model has {', '.join(model.outputs)} and "
                    f"{', '.join(model.inputs[1:])}"
                )
        measured = {name for controller in self.controllers for name in controller.law.inputs}
        for fault in self.faults:
            if fault.sensor not in measured:
                known = ", ".join(sorted(measured)) or "none, as there is no controller"
                raise AbraceError(f"fault {fault.name}: no controller measures {fault.sensor}, expected one of {known}")

    def plant(self, number: int) -> LinearModel:
        """The model with this `number` at the sample period, with the drift of every storey among its outputs."""
        return with_drifts(sampled(self.models[number], self.sample_period))

    def cases(self) -> list[LoopCase]:
        """All cases, model by model; a case has at most BATCH_STEPS steps unless one motion has more."""
        each = max(1, BATCH_STEPS // int(self.motions.samples.max() * len(self.intensities)))
        motions = len(self.motion_names)
        slices = [(first, min(first + each, motions)) for first in range(0, motions, each)]
        tried: list[tuple[int | None, int | None]] = [(None, None)]
        for i, controller in enumerate(self.controllers):
            tried += [(i, None)]
            tried += [(i, j) for j, fault in enumerate(self.faults) if fault.sensor in controller.law.inputs]
        return [LoopCase(model, *one, *span) for model in range(len(self.models)) for one in tried for span in slices]

    def batches(self) -> list[tuple[LoopCase, ...]]:
        """The cases in groups of up to BATCH_STEPS steps."""
        found: list[tuple[LoopCase, ...]] = []
        group: list[LoopCase] = []
        steps = 0
        for case in self.cases():
            own = int(self.motions.samples[case.first : case.last].sum()) * len(self.intensities)
            if group and steps + own > BATCH_STEPS:
                found.append(tuple(group))
                group, steps = [], 0
            group.append(case)
            steps += own
        return [*found, tuple(group)]

    @property
    def loops(self) -> int:
        """Number of closed loops."""
        return sum(case.last - case.first for case in self.cases()) * len(self.intensities)


@takes_models
def with_drifts(model: LinearModel) -> LinearModel:
    """The `model` with the drift of each storey, d1, d2, ..., behind its outputs: x1, x2 - x1, ... [m].

    Names that the model's own outputs have are left to these.

    >>> from abrace_core.model.linear_model import LinearModel
    >>> frame = LinearModel([[-1.0]], [[1.0]], [[1.0], [3.0]], [[0.0], [0.0]], ("w",), ("x1", "x2"))
    >>> with_drifts(frame).outputs, with_drifts(frame).c.ravel().tolist()
    (('x1', 'x2', 'd1', 'd2'), [1.0, 3.0, 1.0, 2.0])
    """
    floors: list[int] = []
    while f"x{len(floors) + 1}" in model.outputs and f"d{len(floors) + 1}" not in model.outputs:
        floors.append(model.outputs.index(f"x{len(floors) + 1}"))
    rows = np.array(floors, dtype=np.intp)
    between = np.eye(len(floors)) - np.eye(len(floors), k=-1)
    names = tuple(f"d{i + 1}" for i in range(len(floors)))
    return replace(
        model,
        c=np.vstack([model.c, between @ model.c[rows]]),
        d=np.vstack([model.d, between @ model.d[rows]]),
        outputs=(*model.outputs, *names),
        units={**model.units, **dict.fromkeys(names, "m")},
    )


@takes_models
def ensemble(
    model: LinearModel, covariance: NDArray[np.float64] | None, count: int, seed: int, source: str
) -> tuple[LinearModel, ...]:
    """A model, and others drawn from the covariance of its parameters.

    Parameters
    ----------
    model, covariance
        As `identify` writes them; None: it is not known.
    count
        Count of models, `model` itself included.
    seed
        Seed of the draws.
    source
        Where the model came from, for messages.

    Raises
    ------
    AbraceError
        If models are to be drawn without a covariance, or as `draw_models`.
    """
    if count < 1:
        raise AbraceError(f"models {count}: expected 1 (the model alone) or more")
    if count == 1:
        return (model,)
    if covariance is None:
        raise AbraceError(
            f"models {count}: {source} has no covariance to draw models from, expected 1, or one of identify"
        )
    return (model, *draw_models(model, covariance, count - 1, seed))


def faults_of(given: Mapping[str, float | Sequence[float]]) -> tuple[Fault, ...]:
    """The faults that were `given`: factors by sensor.

    Raises
    ------
    AbraceError
        If a factor is not finite, or given twice.
    """
    faults = tuple(Fault(name, float(factor)) for name, factors in given.items() for factor in np.atleast_1d(factors))
    for number, fault in enumerate(faults):
        if not np.isfinite(fault.factor):
            raise AbraceError(f"fault {fault.name}: expected a finite factor, reading over truth")
        if fault in faults[:number]:
            raise AbraceError(f"fault {fault.name}: given twice, expected each once")
    return faults
