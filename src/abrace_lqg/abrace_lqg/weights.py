"""The weights of an LQG design and their file, read and written.

Eq. (11) weighs the recorded quantities and the commands; the Kalman filter needs the noise of the measured ones. All
values are in SI units: the weights multiply squares of m, m/s^2 and N.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
import pydantic

from abrace_core.config_file import Checked, read_config, yaml_number
from abrace_core.errors import AbraceError
from abrace_core.files import write_text

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

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
    """

    displacement: Weight
    stroke: Weight
    acceleration: Weight
    force: Weight
    command: Positive


class Weights(Checked):
    """Weights, measured quantities and noise of an LQG design.

    Parameters
    ----------
    measured
        Names of the measured quantities y, in the order of the controller's inputs.
    weights
        By kind of signal.
    relative
        By name of a signal: factor on the weight of its kind; 1 for signals that are not named.
    noise_to_excitation
        Intensity of each measured quantity's noise (its unit squared) over that of the ground acceleration
        ((m/s^2)^2), both white.
    """

    measured: Annotated[list[str], pydantic.Field(min_length=1)]
    weights: KindWeights
    relative: dict[str, Positive] = {}
    noise_to_excitation: Positive

    @pydantic.field_validator("measured")
    @classmethod
    def _each_once(cls, names: list[str]) -> list[str]:
        if len(set(names)) != len(names):
            raise ValueError("each name once")
        return names

    @pydantic.field_validator("relative")
    @classmethod
    def _of_known_kinds(cls, relative: dict[str, float]) -> dict[str, float]:
        for name in relative:
            try:
                signal_kind(name)
            except AbraceError as error:
                raise ValueError(str(error)) from error
        return relative

    def diagonal(self, names: Sequence[str]) -> NDArray[np.float64]:
        """(len(names),) the weight of each of these signals."""
        return np.array([getattr(self.weights, signal_kind(name)) * self.relative.get(name, 1.0) for name in names])


def signal_kind(name: str) -> str:
    """The field of `KindWeights` that weighs the signal `name`.

    >>> [signal_kind(name) for name in ("x3", "xf", "a1", "f2", "U")]
    ['displacement', 'stroke', 'acceleration', 'force', 'command']
    """
    for prefix, found in (
        ("xf", "stroke"),
        ("x", "displacement"),
        ("a", "acceleration"),
        ("f", "force"),
        ("U", "command"),
    ):
        if name.startswith(prefix):
            return found
    raise AbraceError(f"signal {name!r}: no weight for it, expected a name such as x1, xf, a1, f or U")


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
    weights
        In SI units.
    path
        Of the file.
    origin
        Where the weights come from: a comment at the top of the file.
    """
    kinds = weights.weights.model_dump()
    relative = [f"  {name}: {yaml_number(factor)}" for name, factor in weights.relative.items()]
    units = {
        "displacement": "1/m^2",
        "stroke": "1/m^2",
        "acceleration": "s^4/m^2",
        "force": "1/N^2",
        "command": "1/N^2",
    }
    lines = [
        f"# {' '.join(origin.split())}",
        f"measured: [{', '.join(weights.measured)}]",
        "",
        "weights:",
        *(f"  {name}: {yaml_number(value)}  # {units[name]}" for name, value in kinds.items()),
        "",
        *(["relative:", *relative, ""] if relative else []),
        f"noise_to_excitation: {yaml_number(weights.noise_to_excitation)}",
    ]
    write_text(path, "\n".join(lines) + "\n")
