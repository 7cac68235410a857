# SPDX-License-Identifier: Apache-2.0
"""The frame file: YAML that describes a plane frame of bays and storeys, checked key by key."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import pydantic

from abrace_core import AbraceError
from abrace_core.files.config_file import Checked, read_config
from abrace_studies.frames.frame import Frame, Member, Section

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

Positive = Annotated[float, pydantic.Field(gt=0, le=1e15)]
SPLICE = "/"
"""Between the two sections of a spliced column."""


class _Section(Checked):
    EA: Positive
    EI: Positive
    yield_curvature: Positive | None = None


class _Storey(Checked):
    height: Positive
    columns: list[str]


class _Level(Checked):
    mass: Positive
    beams: list[str]
    hinged: list[Annotated[int, pydantic.Field(ge=1)]] = []
    hinged_right: list[Annotated[int, pydantic.Field(ge=1)]] = []
    held: bool = False


class _Damping(Checked):
    ratio: Annotated[float, pydantic.Field(gt=0, lt=1)]
    modes: Annotated[list[Annotated[int, pydantic.Field(ge=1)]], pydantic.Field(min_length=2, max_length=2)]


class _File(Checked):
    name: str
    frames: Annotated[int, pydantic.Field(ge=1)]
    bays: Annotated[list[Positive], pydantic.Field(min_length=1)]
    sections: dict[str, _Section]
    feet: Literal["pinned", "fixed"]
    splice: Annotated[float, pydantic.Field(gt=0, lt=1)] = 0.5
    storeys: Annotated[list[_Storey], pydantic.Field(min_length=1)]
    levels: Annotated[list[_Level], pydantic.Field(min_length=1)]
    damping: _Damping


@dataclass(frozen=True)
class FrameBuilding:
    """A building whose resistance along one axis is that of some equal plane frames with rigid floors.

    Parameters
    ----------
    name
        Name of the building.
    frame
        One of the frames.
    frames
        How many.
    levels
        (levels,) a node of each level above the ground, the lowest first.
    masses
        (levels,) of these levels, of the whole building [kg].
    heights
        (levels,) of the storeys below them [m].
    damping_ratio, damped_modes
        Rayleigh damping: the ratio, and the two modes that have it, 1 the slowest.
    """

    name: str
    frame: Frame
    frames: int
    levels: tuple[int, ...]
    masses: NDArray[np.float64]
    heights: NDArray[np.float64]
    damping_ratio: float
    damped_modes: tuple[int, int]


def load_frame(path: Path | str) -> FrameBuilding:
    """Read and check a frame file.

    Raises
    ------
    AbraceError
        Naming the file, the key, the value and what was expected.
    """
    content = read_config(path, _File, "frame")
    try:
        return _building(content)
    except AbraceError as error:
        raise AbraceError(f"frame file {path}: {error}") from error


def _building(content: _File) -> FrameBuilding:
    bays, storeys = len(content.bays), len(content.storeys)
    lines = bays + 1
    _expect_count("levels", content.levels, storeys, "storeys")
    x = np.concatenate([[0.0], np.cumsum(content.bays)])
    y = np.concatenate([[0.0], np.cumsum([storey.height for storey in content.storeys])])
    nodes = np.array([(across, up) for up in y for across in x])
    members = []
    for i, storey in enumerate(content.storeys):
        _expect_count(f"storeys.{i}.columns", storey.columns, lines, "column lines")
        for line, name in enumerate(storey.columns):
            section = _section(content, name, f"storeys.{i}.columns.{line}")
            members.append(Member(i * lines + line, (i + 1) * lines + line, section))
    supports = np.zeros((len(nodes), 3), dtype=bool)
    supports[:lines] = (True, True, content.feet == "fixed")
    masses = np.zeros((len(nodes), 3))
    for i, level in enumerate(content.levels):
        _expect_count(f"levels.{i}.beams", level.beams, bays, "bays")
        for key, named in (("hinged", level.hinged), ("hinged_right", level.hinged_right)):
            beyond = [bay for bay in named if bay > bays]
            if beyond:
                raise AbraceError(f"levels.{i}.{key}: bay {beyond[0]}, expected one from 1 to {bays}")
        first = (i + 1) * lines
        for bay, name in enumerate(level.beams):
            section, both = _section(content, name, f"levels.{i}.beams.{bay}"), bay + 1 in level.hinged
            right = both or bay + 1 in level.hinged_right
            members.append(Member(first + bay, first + bay + 1, section, (both, right)))
            # the floor's mass hangs on its beams: half of each one's share at either end
            share = level.mass * content.bays[bay] / sum(content.bays) / 2
            masses[first + bay, :2] += share
            masses[first + bay + 1, :2] += share
        supports[first : first + lines, 0] = level.held
    held = [i for i, level in enumerate(content.levels) if level.held]
    ground = held[-1] + 1 if held else 0
    if ground == storeys:
        raise AbraceError(f"levels.{storeys - 1}.held: true, expected a level above the ground that moves")
    floors = tuple(
        tuple(range((i + 1) * lines, (i + 2) * lines)) for i, level in enumerate(content.levels) if not level.held
    )
    one, other = content.damping.modes
    if one == other:
        raise AbraceError(f"damping.modes: {content.damping.modes}, expected two different modes")
    return FrameBuilding(
        name=content.name,
        frame=Frame(nodes, tuple(members), supports, masses, floors),
        frames=content.frames,
        levels=tuple((i + 1) * lines for i in range(ground, storeys)),
        masses=content.frames * np.array([level.mass for level in content.levels[ground:]]),
        heights=np.array([storey.height for storey in content.storeys[ground:]]),
        damping_ratio=content.damping.ratio,
        damped_modes=(one, other),
    )


def _section(content: _File, name: str, key: str) -> Section:
    """A section by its name; of two with a splice between them, a share of each."""
    names = name.split(SPLICE)
    unknown = [one for one in names if one not in content.sections]
    if unknown or len(names) > 2:
        known = ", ".join(content.sections)
        raise AbraceError(f"{key}: {name!r}, expected a section, or two with a {SPLICE!r} between them: {known}")
    parts = [content.sections[one] for one in names]
    shares = [1.0] if len(parts) == 1 else [content.splice, 1 - content.splice]
    axial, bending, curvature = (
        sum(share * value for share, value in zip(shares, values, strict=True))
        for values in zip(*((part.EA, part.EI, part.yield_curvature or np.inf) for part in parts), strict=True)
    )
    return Section(axial, bending, curvature)


def _expect_count(key: str, found: list[str] | list[_Level], count: int, of: str) -> None:
    if len(found) != count:
        raise AbraceError(f"{key}: {len(found)}, expected one for each of {count} {of}")
