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

from abrace_core import signals
from abrace_core.errors import AbraceError
from abrace_core.linear_model import takes_models
from abrace_core.model_ensemble import draw_models
from abrace_lqg.loop import sampled

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from abrace_core.controller_file import Controller
    from abrace_core.linear_model import LinearModel
    from abrace_core.loop_extremes import Motions

ZERO_COMMAND = "zero command"
INTACT = "none"
STUCK = "stuck"
"""Quantity of an interlock: 1 where the failing sensor repeats its reading, as a dead one does, else 0."""
BATCH_STEPS = 50_000_000
"""Steps of a batch, at most unless one case has more: a second or two of work."""


@dataclass(frozen=True)
class Fault:
    """What a sensor reads when it fails: a factor of the truth. 0: it is dead; -1: it is turned around.

    Parameters
    ----------
    sensor
        Name of the measured quantity.
    factor
        Reading over truth.
    """

    sensor: str
    factor: float

    @property
    def name(self) -> str:
        """As it is given: `a2=0`."""
        return f"{self.sensor}={self.factor:g}"


@dataclass(frozen=True)
class Interlock:
    """A limit of a measured quantity, after which the command is ramped to zero and stays so.

    Parameters
    ----------
    quantity
        An output of the models as its sensor reads it, a drift of such readings, an output of the study's
        `implausibility`, or STUCK.
    value
        Its limit [SI unit].
    samples
        For which it has to be exceeded without a break.
    settling
        Samples from the start on in which it does not act.
    """

    quantity: str
    value: float
    samples: int
    settling: int = 0


class Case(NamedTuple):
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
        Of one sensor each.
    motions
        Scaled to a measure of intensity of 1.
    motion_names
        Of each.
    intensities
        Factors of the motions: peak ground acceleration [m/s^2].
    interlocks
        Of controlled loops; the zero command needs none.
    sample_period
        [s] of controllers and motions.
    implausibility
        Discrete, from the errors of readings to the quantities by which interlocks compare sensors with each other;
        None: none is compared.

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
    interlocks: tuple[Interlock, ...]
    sample_period: float
    implausibility: LinearModel | None = None

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
        outputs = with_drifts(model).outputs
        compared = self.implausibility.outputs if self.implausibility else ()
        for interlock in self.interlocks:
            if not interlock.value > 0:
                raise AbraceError(f"interlock {interlock.quantity}={interlock.value:g}: expected a limit above 0")
            if interlock.quantity not in (*outputs, *compared, STUCK):
                raise AbraceError(
                    f"interlock {interlock.quantity}: the model has no such quantity, "
                    f"expected one of {', '.join(outputs)}"
                )

    def plant(self, number: int) -> LinearModel:
        """The model with this `number` at the sample period, with the drift of every storey among its outputs."""
        return with_drifts(sampled(self.models[number], self.sample_period))

    def cases(self) -> list[Case]:
        """All cases, model by model; a case has at most BATCH_STEPS steps unless one motion has more."""
        each = max(1, BATCH_STEPS // int(self.motions.samples.max() * len(self.intensities)))
        motions = len(self.motion_names)
        slices = [(first, min(first + each, motions)) for first in range(0, motions, each)]
        tried: list[tuple[int | None, int | None]] = [(None, None)]
        for i, controller in enumerate(self.controllers):
            tried += [(i, None)]
            tried += [(i, j) for j, fault in enumerate(self.faults) if fault.sensor in controller.law.inputs]
        return [Case(model, *one, *span) for model in range(len(self.models)) for one in tried for span in slices]

    def batches(self) -> list[tuple[Case, ...]]:
        """The cases in groups of up to BATCH_STEPS steps."""
        found: list[tuple[Case, ...]] = []
        group: list[Case] = []
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

    >>> from abrace_core.linear_model import LinearModel
    >>> frame = LinearModel([[-1.0]], [[1.0]], [[1.0], [3.0]], [[0.0], [0.0]], ("w",), ("x1", "x2"))
    >>> with_drifts(frame).outputs, with_drifts(frame).c.ravel().tolist()
    (('x1', 'x2', 'd1', 'd2'), [1.0, 3.0, 1.0, 2.0])
    """
    floors: list[int] = []
    while f"x{len(floors) + 1}" in model.outputs:
        floors.append(model.outputs.index(f"x{len(floors) + 1}"))
    rows = np.array(floors, dtype=np.intp)
    between = np.eye(len(floors)) - np.eye(len(floors), k=-1)
    names = tuple(f"d{i + 1}" for i in range(len(floors)))
    return replace(
        model,
        c=np.vstack([model.c, between @ model.c[rows]]),
        d=np.vstack([model.d, between @ model.d[rows]]),
        outputs=(*model.outputs, *names),
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
        Of models, `model` itself included.
    seed
        Of the draws.
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


def named_numbers(what: str, texts: Sequence[str]) -> dict[str, list[float]]:
    """Numbers by name from `texts` such as a1=0, which give `what`.

    >>> named_numbers("fault", ["a1=0", "a3=-1", "a1=1.2"])
    {'a1': [0.0, 1.2], 'a3': [-1.0]}

    Raises
    ------
    AbraceError
        If a text is not NAME=NUMBER, or the number not finite.
    """
    found: dict[str, list[float]] = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            number = float(value)
        except ValueError:
            number = np.nan
        if not np.isfinite(number):
            raise AbraceError(f"{what} {text}: expected NAME=NUMBER, such as a1=0")
        found.setdefault(name, []).append(number)
    return found


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


def unit(name: str) -> str:
    """SI unit of a signal or of a drift, from its `name`."""
    return "m" if name[0] == "d" else signals.unit(name)
