"""The weights of an LQG design and the file that they are kept in.

Eq. (11) weighs the recorded quantities and the commands; the filter needs the noise of the measured ones. Everything is
in SI units: the weights multiply squares of m, m/s^2 and N.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
import pydantic

from abrace_core.config_file import Checked, read_config
from abrace_core.errors import AbraceError

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
    """What an LQG design is asked for.

    Parameters
    ----------
    measured
        Names of the measured quantities y, in the order in which the controller takes them.
    weights
        By kind of signal.
    relative
        By name of a signal: what its kind's weight is multiplied by. Signals that are not named have their kind's.
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
                kind(name)
            except AbraceError as error:
                raise ValueError(str(error)) from error
        return relative

    def diagonal(self, names: Sequence[str]) -> NDArray[np.float64]:
        """(len(names),) the weight of each of these signals."""
        return np.array([getattr(self.weights, kind(name)) * self.relative.get(name, 1.0) for name in names])


def kind(name: str) -> str:
    """Which weight a signal's name calls for.

    >>> kind("x3"), kind("xf"), kind("a1"), kind("f2"), kind("U")
    ('displacement', 'stroke', 'acceleration', 'force', 'command')
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
