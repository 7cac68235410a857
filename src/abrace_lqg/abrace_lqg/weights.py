# SPDX-License-Identifier: Apache-2.0
"""The weights of an LQG design and their file, read and written.

Eq. (11) weighs the recorded quantities and the commands, and sums of the former: the drift of each storey and the base
shear. The Kalman filter needs the noise of the measured ones. All values are in SI units: the weights multiply squares
of m, m/s^2 and N. With `scale` they are relative, and scaled to a rig from one number (`abrace_lqg.scaling`).

Signals of any other names are weighed one by one (`signals`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
import pydantic
import yaml

from abrace_core import AbraceError
from abrace_core.files.config_file import Checked, read_config
from abrace_core.files.writing import write_text

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

KINDS = {
    "displacement": "x[0-9]+",
    "stroke": "xf[0-9]*",
    "acceleration": "a[0-9]+",
    "force": "f[0-9]*",
    "command": "U[0-9]*",
    "drift": "d[0-9]+",
    "base_shear": "V",
}
"""The names of the signals of each kind: the whole name, so that a model's own names are not taken for others."""

Weight = Annotated[float, pydantic.Field(ge=0)]
Positive = Annotated[float, pydantic.Field(gt=0)]


class KindWeights(Checked):
    """One weight for each kind of signal: Q and R of Eq. (11) are diagonal.

    Parameters
    ----------
    displacement, stroke
        [1/m^2]; zero: not weighed.
    acceleration
        [s^4/m^2].
    force
        [1/N^2].
    command
        [1/N^2], greater than zero.
    drift
        Drift of each storey, d1 = x1, d2 = x2 - x1 ... [1/m^2].
    base_shear
        V, the sum of all floors' masses times accelerations [1/N^2].
    """

    displacement: Weight
    stroke: Weight
    acceleration: Weight
    force: Weight
    command: Positive
    drift: Weight = 0.0
    base_shear: Weight = 0.0


class Scale(Checked):
    """The target by which weights are scaled to a rig; one of the two.

    Parameters
    ----------
    reduction
        Reduction of the displacements' rms under the design's excitation, mean of the floors: 0.5 halves them. Without
        displacements that of the outputs in `signals`, or of the accelerations.
    force
        Share of the force limit that three times the rms of a command takes, of the command that needs most.
    """

    reduction: Annotated[float, pydantic.Field(gt=0, lt=1)] | None = None
    force: Annotated[float, pydantic.Field(gt=0, le=1)] | None = None

    @pydantic.model_validator(mode="after")
    def _one(self) -> Scale:
        if (self.reduction is None) == (self.force is None):
            raise ValueError("either reduction or force")
        return self


class Weights(Checked):
    """Weights, measured quantities and noise of an LQG design.

    Parameters
    ----------
    measured
        Names of the measured quantities y, in the order of the controller's inputs; "a*": all accelerations.
    weights
        Weights by kind of signal; without them, where there are `signals`, of the commands alone: 1.
    signals
        By name of an output or a command of the model: its own weight, in place of that of its kind. Outputs of other
        names than a rig's have a weight only so. With a `scale` these are relative, too.
    relative
        By name of a signal: factor on the weight of its kind; 1 for signals that are not named.
    noise_to_excitation
        Intensity of each measured quantity's noise (its unit squared) over that of the disturbance, of a rig the ground
        acceleration ((m/s^2)^2), both white.
    noise
        By name of a measured quantity: factor on that intensity; 1 for those that are not named.
    masses
        Masses of the floors, the lowest first [kg], for the base shear.
    scale
        The target by which the weights are scaled to a rig. The weights are then only relative: each is divided by the
        mean square of its signal with zero command, a command's by the square of its force limit.
    """

    who: ClassVar[str] = "weights"

    measured: Annotated[list[str], pydantic.Field(min_length=1)]
    weights: KindWeights
    signals: dict[str, Weight] = {}
    relative: dict[str, Positive] = {}
    noise_to_excitation: Positive
    noise: dict[str, Positive] = {}
    masses: list[Positive] = []
    scale: Scale | None = None

    @pydantic.field_validator("measured")
    @classmethod
    def _each_once(cls, names: list[str]) -> list[str]:
        if len(set(names)) != len(names):
            raise ValueError("each name once")
        return names

    @pydantic.field_validator("relative")
    @classmethod
    def _of_known_kinds(cls, relative: dict[str, float], info: pydantic.ValidationInfo) -> dict[str, float]:
        for name in relative if not info.data.get("signals") else ():  # a model's own names are known with it
            try:
                signal_kind(name)
            except AbraceError as error:
                raise ValueError(str(error)) from error
        return relative

    @pydantic.model_validator(mode="before")
    @classmethod
    def _by_name_alone(cls, given: Any) -> Any:
        if isinstance(given, Mapping) and given.get("signals") and "weights" not in given:
            return {**given, "weights": dict.fromkeys(KINDS, 0.0) | {"command": 1.0}}
        return given

    @pydantic.model_validator(mode="after")
    def _with_masses(self) -> Weights:
        if self.weights.base_shear and not self.masses:
            raise ValueError("masses of all floors [kg] where base_shear has a weight")
        return self

    def of(self, outputs: Sequence[str], commands: Sequence[str]) -> Weights:
        """These weights for a model with such `outputs` and `commands`: names with a wildcard are expanded.

        Raises
        ------
        AbraceError
            If a name is none of the model's, a quantity is measured twice, or there is not one mass for each floor.
        """
        measured: list[str] = []
        for name in self.measured:
            several = [one for one in outputs if name.endswith("*") and re.fullmatch(name[:-1] + r"[0-9]+", one)]
            measured += several or [name]
        if len(set(measured)) < len(measured):
            raise AbraceError(f"weights: measured: {', '.join(self.measured)}, expected each quantity once")
        known = (*outputs, *commands, *self._combined(outputs)[0])
        for what, names, expected in (
            ("measured", measured, outputs),
            ("signals", list(self.signals), (*outputs, *commands)),
            ("noise", list(self.noise), measured),
            ("relative", list(self.relative), known),
        ):
            unknown = [name for name in names if name not in expected]
            if unknown:
                raise AbraceError(f"weights: {what}: {', '.join(unknown)}, expected some of {', '.join(expected)}")
        free = [name for name in commands if self.signals.get(name) == 0]
        if free:
            raise AbraceError(f"weights: signals.{free[0]}: 0, expected more for a command")
        return self.model_copy(update={"measured": measured})

    def weighed(self, outputs: Sequence[str]) -> tuple[tuple[str, ...], NDArray[np.float64]]:
        """What is weighed of some `outputs`: names, and (names, outputs) each as a sum of outputs.

        Raises
        ------
        AbraceError
            If the outputs do not have what drift and base shear are made of, or none has a weight.
        """
        names, rows = self._combined(outputs)
        if not self.diagonal([*outputs, *names]).any():
            known = ", ".join([*outputs, *names])
            raise AbraceError(f"weights: all weights but that of the command are zero, expected one above 0 of {known}")
        return (*outputs, *names), np.vstack([np.eye(len(outputs)), *rows])

    def _combined(self, outputs: Sequence[str]) -> tuple[list[str], list[NDArray[np.float64]]]:
        """Drifts and base shear where they have a weight: names, and each as a sum of outputs."""
        sums: dict[str, dict[str, float]] = {}
        floors = sum(bool(re.fullmatch("x[0-9]+", name)) for name in outputs)
        if self.weights.drift:
            sums |= {f"d{i + 1}": {f"x{i + 1}": 1.0} | ({f"x{i}": -1.0} if i else {}) for i in range(floors)}
        if self.weights.base_shear:
            if len(self.masses) != floors:
                raise AbraceError(f"weights: masses: {len(self.masses)} of {floors} floors, expected one for each")
            sums["V"] = {f"a{i + 1}": mass for i, mass in enumerate(self.masses)}
        missing = [name for one in sums.values() for name in one if name not in outputs]
        if missing:
            raise AbraceError(f"weights: drift and base_shear need {', '.join(missing)}, which the model does not have")
        return list(sums), [np.array([one.get(name, 0.0) for name in outputs]) for one in sums.values()]

    def noise_intensity(self) -> NDArray[np.float64]:
        """(measured,) intensity of each measured quantity's noise over that of the excitation."""
        return np.array([self.noise_to_excitation * self.noise.get(name, 1.0) for name in self.measured])

    def diagonal(self, names: Sequence[str]) -> NDArray[np.float64]:
        """(len(names),) the weight of each of these outputs."""
        return np.array([self._weight(name) * self.relative.get(name, 1.0) for name in names])

    def of_commands(self, names: Sequence[str]) -> NDArray[np.float64]:
        """(len(names),) the weight of each of these commands, whatever their names."""
        own = [self.signals.get(name, self.weights.command) for name in names]
        return np.array([weight * self.relative.get(name, 1.0) for name, weight in zip(names, own, strict=True)])

    def _weight(self, name: str) -> float:
        if name in self.signals:
            return self.signals[name]
        if self.signals and not is_of_kind(name):
            return 0.0
        return float(getattr(self.weights, signal_kind(name)))

    def __repr_args__(self) -> Any:
        return [(key, value) for key, value in super().__repr_args__() if key != "signals" or value]


def signal_kind(name: str) -> str:
    """The field of `KindWeights` that weighs the signal `name`.

    >>> [signal_kind(name) for name in ("x3", "xf", "a1", "f2", "U", "d2", "V")]
    ['displacement', 'stroke', 'acceleration', 'force', 'command', 'drift', 'base_shear']
    """
    for kind, pattern in KINDS.items():
        if re.fullmatch(pattern, name):
            return kind
    raise AbraceError(
        f"signal {name!r}: no weight for it, expected a name such as x1, xf, a1, f, d2, V or U, or weights by name in "
        "signals"
    )


def is_of_kind(name: str, *kinds: str) -> bool:
    """Whether the signal `name` is of one of these `kinds`, of `KINDS`; none given: of any."""
    return any(re.fullmatch(KINDS[kind], name) for kind in kinds or KINDS)


def load_weights(path: Path | str) -> Weights:
    """Read and check a weights file.

    Raises
    ------
    AbraceError
        Naming the file, the key, the value and what was expected.
    """
    return read_config(path, Weights, "weights")


def save_weights(weights: Weights, path: Path | str, origin: str) -> None:
    """Write a weights file, as `load_weights` reads it.

    Parameters
    ----------
    path
    weights
        The weights, in SI units.
    origin
        Where the weights come from: a comment at the top of the file.
    """
    content = weights.model_dump(exclude_unset=True, exclude_none=True)
    text = yaml.safe_dump(content, default_flow_style=None, sort_keys=False)
    write_text(path, f"# {' '.join(origin.split())}\n{text}")
