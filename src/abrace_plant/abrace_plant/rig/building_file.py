# SPDX-License-Identifier: Apache-2.0
"""The building in the rig file: its forms of stiffness and damping, and the effects beyond a linear frame."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Annotated

import numpy as np
import pydantic

from abrace_core import AbraceError
from abrace_core.files.config_file import Checked
from abrace_core.files.quantity import Quantity
from abrace_plant.rig.building import (
    Building,
    gravity_stiffness,
    modal_damping,
    rayleigh_damping,
    shear_stiffness,
    stiffness_of_modes,
    storey_direction,
)
from abrace_plant.rig.checks import (
    AngularFrequency,
    DampingRatio,
    Mass,
    Real,
    SomeForce,
    Stiffness,
    expect,
    expect_one_each,
)
from abrace_plant.rig.hysteresis import Hysteresis

if TYPE_CHECKING:
    from numpy.typing import NDArray


Stated = tuple[str, list[float]]
"""The key of a stiffness, and the numbers there: of each storey, a matrix's diagonal, or frequencies."""


def _as_list(value: object) -> object:
    """One height as a list of it, so that a mistake is named by a single key."""
    return value if isinstance(value, list) else [value]


Height = Annotated[float, pydantic.Field(ge=0.1, le=10), Quantity("m")]


class _Modes(Checked):
    frequencies: list[AngularFrequency]
    shapes: list[list[Real]]


class _Rayleigh(Checked):
    modes: Annotated[list[Annotated[int, pydantic.Field(ge=1)]], pydantic.Field(min_length=2, max_length=2)]
    damping_ratios: Annotated[list[DampingRatio], pydantic.Field(min_length=2, max_length=2)]


class BuildingContent(Checked):
    """The key `building`."""

    storey_height: Annotated[list[Height], pydantic.BeforeValidator(_as_list)]
    masses: Annotated[list[Mass], pydantic.Field(min_length=1)]
    storey_stiffness: list[Stiffness] | None = None
    stiffness: list[list[Annotated[Real, Quantity("N/m")]]] | None = None
    modes: _Modes | None = None
    damping_ratios: list[DampingRatio] | None = None
    rayleigh: _Rayleigh | None = None
    p_delta: bool = False
    friction: list[SomeForce] = []
    hysteresis: list[Hysteresis] = []


def read_building(content: BuildingContent) -> tuple[Building, float, Stated]:
    """The building of a rig file's `content`, its mean storey height [m], and what states its stiffness.

    Raises
    ------
    AbraceError
        Naming the key, the value and what was expected.
    """
    masses, floors = np.array(content.masses), len(content.masses)
    given = content.storey_height
    if len(given) != 1:
        expect_one_each(given, "building.storey_height", floors, "storeys")
    heights = np.broadcast_to(given, floors)
    stiffness, stated = _stiffness(content, masses)
    _expect_definite(".".join(stated[0].split(".")[:2]), masses, stiffness)
    if content.p_delta:
        expect(
            content.modes is None, "building.p_delta", True, "false: measured frequencies are those under the weight"
        )
        stiffness = stiffness - gravity_stiffness(masses, heights)
        _expect_definite("building.p_delta", masses, stiffness)
    if content.friction:
        expect_one_each(content.friction, "building.friction", floors, "storeys")
    _check_springs(content.hysteresis, masses, stiffness)
    building = Building(
        masses,
        stiffness,
        _damping(content, masses, stiffness),
        friction=tuple(content.friction),
        hysteresis=tuple(content.hysteresis),
        heights=tuple(given) if len(given) > 1 else (),
    )
    return building, float(heights.mean()), stated


def _check_springs(springs: list[Hysteresis], masses: NDArray[np.float64], stiffness: NDArray[np.float64]) -> None:
    """The frame must keep positive stiffness when all springs have yielded."""
    floors, linear = len(masses), stiffness.copy()
    for i, spring in enumerate(springs):
        key = f"building.hysteresis.{i}"
        expect(spring.storey <= floors, f"{key}.storey", spring.storey, f"a storey from 1 to {floors}")
        direction = storey_direction(spring.storey, floors)
        linear -= spring.stiffness * np.outer(direction, direction)
        _expect_definite(f"{key}.stiffness", masses, linear)


def _stiffness(building: BuildingContent, masses: NDArray[np.float64]) -> tuple[NDArray[np.float64], Stated]:
    """The condensed stiffness (floors, floors) [N/m], and what states it."""
    floors = len(masses)
    _expect_one_of(building, "storey_stiffness", "stiffness", "modes")
    if building.storey_stiffness is not None:
        key, storeys = "building.storey_stiffness", building.storey_stiffness
        expect_one_each(storeys, key, floors, "storeys")
        return shear_stiffness(np.array(storeys)), (key, storeys)
    if building.stiffness is not None:
        key, rows = "building.stiffness", [len(row) for row in building.stiffness]
        expect(rows == [floors] * floors, key, f"rows of {rows} numbers", f"{floors} rows of {floors}")
        matrix = np.array(building.stiffness)
        asymmetry = np.abs(matrix - matrix.T)
        i, j = divmod(int(np.argmax(asymmetry)), floors)
        pair = f"not symmetric: {matrix[i, j]:.9g} in row {i + 1}, column {j + 1}, and {matrix[j, i]:.9g} opposite"
        expect(asymmetry.max() <= 1e-9 * np.abs(matrix).max(), key, pair, "symmetry")
        return (matrix + matrix.T) / 2, (key, np.diag(matrix).tolist())
    modes = building.modes
    assert modes is not None
    key, frequencies = "building.modes.frequencies", modes.frequencies
    expect_one_each(frequencies, key, floors, "modes, as many as floors")
    ascending = all(slower < faster for slower, faster in pairwise(frequencies))
    expect(ascending, key, frequencies, "frequencies in ascending order, the slowest first")
    expect_one_each(modes.shapes, "building.modes.shapes", floors, "modes, as many as floors", "shapes")
    for i, shape in enumerate(modes.shapes):
        expect_one_each(shape, f"building.modes.shapes.{i}", floors, "floors")
    try:
        matrix = stiffness_of_modes(masses, np.array(frequencies), np.array(modes.shapes).T)
    except AbraceError as error:
        raise AbraceError(f"building.modes.shapes: {error}") from error
    return matrix, (key, frequencies)


def _damping(
    building: BuildingContent, masses: NDArray[np.float64], stiffness: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The condensed damping (floors, floors) [N s/m]."""
    floors = len(masses)
    _expect_one_of(building, "damping_ratios", "rayleigh")
    if building.damping_ratios is not None:
        key, ratios = "building.damping_ratios", building.damping_ratios
        expect_one_each(ratios, key, floors, "floors")
        return modal_damping(masses, stiffness, np.array(ratios))
    rayleigh = building.rayleigh
    assert rayleigh is not None
    one, other = rayleigh.modes
    possible = one != other and max(one, other) <= floors
    expect(possible, "building.rayleigh.modes", rayleigh.modes, f"two different modes from 1 to {floors}")
    first, second = rayleigh.damping_ratios
    try:
        return rayleigh_damping(masses, stiffness, (one, other), (first, second))
    except AbraceError as error:
        raise AbraceError(f"building.rayleigh: {error}") from error


def _expect_definite(key: str, masses: NDArray[np.float64], stiffness: NDArray[np.float64]) -> None:
    """The stiffness must be positive definite, by more than rounding errors."""
    root = np.sqrt(masses)
    squares = np.linalg.eigvalsh(stiffness / np.outer(root, root))
    found = f"squares of the frequencies {', '.join(f'{square:.4g}' for square in squares)} 1/s^2"
    expect(squares[0] > 1e-12 * squares[-1], key, found, "positive ones: a positive definite matrix")


def _expect_one_of(building: BuildingContent, *keys: str) -> None:
    given = [key for key in keys if getattr(building, key) is not None]
    alternatives = f"{', '.join(keys[:-1])} or {keys[-1]}"
    expect(len(given) == 1, "building", " and ".join(given) or "none of them", f"exactly one of {alternatives}")
