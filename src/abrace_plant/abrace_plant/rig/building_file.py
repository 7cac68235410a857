# SPDX-License-Identifier: Apache-2.0
"""The building in the rig file: its forms of stiffness and damping, and the effects beyond a linear frame."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated

import numpy as np
import pydantic

from abrace_core.config_file import Checked
from abrace_core.errors import AbraceError
from abrace_core.installed import find_file
from abrace_plant.frames.file import load_frame
from abrace_plant.frames.model import level_building
from abrace_plant.rig.building import (
    Building,
    gravity_stiffness,
    modal_damping,
    rayleigh_damping,
    shear_stiffness,
    stiffness_of_modes,
    storey_direction,
)
from abrace_plant.rig.checks import DampingRatio, NotNegative, Positive, Real, expect, expect_one_each
from abrace_plant.rig.hysteresis import Hysteresis
from abrace_plant.rig.plausibility import Number

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

OF_FRAME = ("storey_height", "masses", "storey_stiffness", "stiffness", "modes", "damping_ratios", "rayleigh")
"""Keys in whose place a frame file stands."""


class _Modes(Checked):
    frequencies: list[Positive]
    shapes: list[list[Real]]


class _Rayleigh(Checked):
    modes: Annotated[list[Annotated[int, pydantic.Field(ge=1)]], pydantic.Field(min_length=2, max_length=2)]
    damping_ratios: Annotated[list[DampingRatio], pydantic.Field(min_length=2, max_length=2)]


class _Hysteresis(Checked):
    storey: Annotated[int, pydantic.Field(ge=1)]
    stiffness: Positive
    yield_drift: Positive
    exponent: Annotated[float, pydantic.Field(ge=1, le=20)] = 2.0
    beta: Annotated[float, pydantic.Field(ge=0.5, le=1)] = 0.5


class BuildingContent(Checked):
    """The key `building`."""

    frame: str | None = None
    storey_height: Positive | None = None
    masses: Annotated[list[Positive], pydantic.Field(min_length=1)] | None = None
    storey_stiffness: list[Positive] | None = None
    stiffness: list[list[Real]] | None = None
    modes: _Modes | None = None
    damping_ratios: list[DampingRatio] | None = None
    rayleigh: _Rayleigh | None = None
    p_delta: bool = False
    friction: list[NotNegative] = []
    hysteresis: list[_Hysteresis] = []


def read_building(
    content: BuildingContent, frame: Path | None = None
) -> tuple[Building, float, list[Number], list[Number]]:
    """The building of a rig file's `content`, its storey height [m], and the numbers that state stiffness and damping.

    `frame`: the frame file; None: the one that `content` names, if it names one.

    Raises
    ------
    AbraceError
        Naming the key, the value and what was expected.
    """
    linear, height, stiffness, damping = _stated(content) if content.frame is None else _of_frame(content, frame)
    if content.friction:
        expect_one_each(content.friction, "building.friction", linear.floors, "storeys")
    springs = _springs(content, linear.masses, linear.stiffness)
    return replace(linear, friction=tuple(content.friction), hysteresis=springs), height, stiffness, damping


def frame_file(name: str) -> Path:
    """The frame file of this name or path."""
    return find_file(name, "abrace_plant", "config/frames", ".yaml", "frame")


def _stated(content: BuildingContent) -> tuple[Building, float, list[Number], list[Number]]:
    """A building that the rig file itself describes: as from `read_building`, without friction and springs."""
    for key in ("storey_height", "masses"):
        if getattr(content, key) is None:
            raise AbraceError(f"building.{key}: key is missing")
    assert content.masses is not None
    assert content.storey_height is not None
    masses, height = np.array(content.masses), content.storey_height
    stiffness, stated_stiffness = _stiffness(content, masses)
    _expect_definite(".".join(stated_stiffness[0].key.split(".")[:2]), masses, stiffness)
    if content.p_delta:
        expect(
            content.modes is None, "building.p_delta", True, "false: measured frequencies are those under the weight"
        )
        stiffness = _leaning(masses, stiffness, height)
    damping, stated_damping = _damping(content, masses, stiffness)
    return Building(masses, stiffness, damping), height, stated_stiffness, stated_damping


def _of_frame(content: BuildingContent, path: Path | None) -> tuple[Building, float, list[Number], list[Number]]:
    """A building that a frame file describes: as from `read_building`, without friction and springs."""
    for key in OF_FRAME:
        expect(getattr(content, key) is None, f"building.{key}", "given", "none: building.frame has it")
    assert content.frame is not None
    frame = load_frame(path or frame_file(content.frame))
    levels = level_building(frame)
    stiffness = _leaning(frame.masses, levels.stiffness, frame.heights) if content.p_delta else levels.stiffness
    building = Building(
        frame.masses,
        stiffness,
        levels.damping,
        heights=tuple(frame.heights.tolist()),
        frequency_errors=tuple(levels.frequency_errors.tolist()),
    )
    frequencies = [Number("building.frame", float(value), "rad/s") for value in building.modes()[0]]
    ratio = Number("building.frame", frame.damping_ratio, "of critical")
    return building, float(frame.heights.mean()), frequencies, [ratio]


def _leaning(
    masses: NDArray[np.float64], stiffness: NDArray[np.float64], heights: float | NDArray[np.float64]
) -> NDArray[np.float64]:
    """The stiffness under the building's weight."""
    found = stiffness - gravity_stiffness(masses, heights)
    _expect_definite("building.p_delta", masses, found)
    return found


def _springs(
    content: BuildingContent, masses: NDArray[np.float64], stiffness: NDArray[np.float64]
) -> tuple[Hysteresis, ...]:
    """The springs that yield; the frame must keep positive stiffness when all have yielded."""
    floors = len(masses)
    linear = stiffness.copy()
    for i, spring in enumerate(content.hysteresis):
        key = f"building.hysteresis.{i}"
        expect(spring.storey <= floors, f"{key}.storey", spring.storey, f"a storey from 1 to {floors}")
        direction = storey_direction(spring.storey, floors)
        linear -= spring.stiffness * np.outer(direction, direction)
        _expect_definite(f"{key}.stiffness", masses, linear)
    return tuple(Hysteresis(**dict(spring)) for spring in content.hysteresis)


def _stiffness(building: BuildingContent, masses: NDArray[np.float64]) -> tuple[NDArray[np.float64], list[Number]]:
    """The condensed stiffness (floors, floors) [N/m], and the numbers that state it."""
    floors = len(masses)
    _expect_one_of(building, "storey_stiffness", "stiffness", "modes")
    if building.storey_stiffness is not None:
        key, storeys = "building.storey_stiffness", building.storey_stiffness
        expect_one_each(storeys, key, floors, "storeys")
        return shear_stiffness(np.array(storeys)), _numbers(key, storeys, "N/m", 0.5)
    if building.stiffness is not None:
        key, rows = "building.stiffness", [len(row) for row in building.stiffness]
        expect(rows == [floors] * floors, key, f"rows of {rows} numbers", f"{floors} rows of {floors}")
        matrix = np.array(building.stiffness)
        asymmetry = np.abs(matrix - matrix.T)
        i, j = divmod(int(np.argmax(asymmetry)), floors)
        pair = f"not symmetric: {matrix[i, j]:.9g} in row {i + 1}, column {j + 1}, and {matrix[j, i]:.9g} opposite"
        expect(asymmetry.max() <= 1e-9 * np.abs(matrix).max(), key, pair, "symmetry")
        diagonal = [Number(f"{key}.{i}.{i}", value, "N/m", 0.5) for i, value in enumerate(np.diag(matrix))]
        return (matrix + matrix.T) / 2, diagonal
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
    return matrix, _numbers(key, frequencies, "rad/s", 1.0)


def _damping(
    building: BuildingContent, masses: NDArray[np.float64], stiffness: NDArray[np.float64]
) -> tuple[NDArray[np.float64], list[Number]]:
    """The condensed damping (floors, floors) [N s/m], and the ratios that state it."""
    floors = len(masses)
    _expect_one_of(building, "damping_ratios", "rayleigh")
    if building.damping_ratios is not None:
        key, ratios = "building.damping_ratios", building.damping_ratios
        expect_one_each(ratios, key, floors, "floors")
        return modal_damping(masses, stiffness, np.array(ratios)), _numbers(key, ratios, "of critical")
    rayleigh = building.rayleigh
    assert rayleigh is not None
    one, other = rayleigh.modes
    possible = one != other and max(one, other) <= floors
    expect(possible, "building.rayleigh.modes", rayleigh.modes, f"two different modes from 1 to {floors}")
    first, second = ratios = rayleigh.damping_ratios
    try:
        damping = rayleigh_damping(masses, stiffness, (one, other), (first, second))
    except AbraceError as error:
        raise AbraceError(f"building.rayleigh: {error}") from error
    return damping, _numbers("building.rayleigh.damping_ratios", ratios, "of critical")


def _expect_definite(key: str, masses: NDArray[np.float64], stiffness: NDArray[np.float64]) -> None:
    """The stiffness must be positive definite, by more than rounding errors."""
    root = np.sqrt(masses)
    squares = np.linalg.eigvalsh(stiffness / np.outer(root, root))
    found = f"squares of the frequencies {', '.join(f'{square:.4g}' for square in squares)} 1/s^2"
    expect(squares[0] > 1e-12 * squares[-1], key, found, "positive ones: a positive definite matrix")


def _numbers(key: str, values: list[float], unit: str, power: float = 1.0) -> list[Number]:
    return [Number(f"{key}.{i}", value, unit, power) for i, value in enumerate(values)]


def _expect_one_of(building: BuildingContent, *keys: str) -> None:
    given = [key for key in keys if getattr(building, key) is not None]
    alternatives = f"{', '.join(keys[:-1])} or {keys[-1]}"
    expect(len(given) == 1, "building", " and ".join(given) or "none of them", f"exactly one of {alternatives}")
