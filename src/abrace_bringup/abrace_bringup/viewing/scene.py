# SPDX-License-Identifier: Apache-2.0
"""The building as a viewer draws it: frames of the floors, columns, and braces coloured by how much they are loaded.

Floors are moved by their measured displacements relative to the table, enlarged. What does not move is in the robot
description (`abrace_plant.rig.robot_description`), whose links these frames move.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, NamedTuple

from foxglove.messages import (
    ArrowPrimitive,
    Color,
    FrameTransform,
    FrameTransforms,
    LinePrimitive,
    LinePrimitiveLineType,
    Point3,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    TextPrimitive,
    Timestamp,
    Vector3,
)

from abrace_bringup.viewing.named_channels import UTILISATION
from abrace_core.signals import load_cell_names
from abrace_plant.rig.robot_description import PLATE, joint_names

if TYPE_CHECKING:
    from collections.abc import Mapping

    from abrace_plant.rig.model import BraceGroup, Rig

Point = tuple[float, float, float]

FRAME = "table"
"""The frame in which all is drawn: the root of the robot description."""

COLUMN_PARTS = 6
"""Straight pieces of which a bent column is drawn."""

COLUMN, BRACE, SHAFT, HEAD, TEXT = 0.12, 0.2, 0.3, 0.4, 0.4
"""Thickness of columns and braces, diameter of an arrow's shaft, length of its head, height of letters [m]."""
FULL_ARROW = 2.0
"""Length of the arrow of a force that is the capacity [m]."""
GREY = (0.45, 0.5, 0.55)
"""Colour of the columns (red, green, blue)."""
FULL, HALF, NONE = (0.85, 0.1, 0.1), (0.95, 0.75, 0.1), (0.15, 0.65, 0.3)
"""Colours of a brace at its capacity, at half of it, and without force (red, green, blue)."""


def colour(utilisation: float) -> tuple[float, float, float]:
    """Red, green and blue of a `utilisation`: from green over yellow at a half to red at 1 and above.

    >>> colour(0.0), colour(0.5), colour(1.0) == colour(3.0)
    ((0.15, 0.65, 0.3), (0.95, 0.75, 0.1), True)
    """
    share = min(max(utilisation, 0.0), 1.0) if math.isfinite(utilisation) else 1.0
    low, high, part = (NONE, HALF, 2 * share) if share <= 0.5 else (HALF, FULL, 2 * share - 1)
    red, green, blue = (a + part * (b - a) for a, b in zip(low, high, strict=True))
    return red, green, blue


class Brace(NamedTuple):
    """A brace as drawn.

    Parameters
    ----------
    cell
        Name of its load cell.
    foot, head
        Its ends on the floor below and on its own, (x, y, z) [m].
    force
        [N], tension positive.
    utilisation
        Force over capacity.
    """

    cell: str
    foot: Point
    head: Point
    force: float
    utilisation: float

    @property
    def middle(self) -> Point:
        """Position of the force's arrow and number [m]."""
        (x, y, z), (u, v, w) = self.foot, self.head
        return (x + u) / 2, (y + v) / 2, (z + w) / 2

    @property
    def direction(self) -> float:
        """Slope [rad] of the arrow in the plane of the frame: along the brace, for tension upwards."""
        slope = math.atan2(self.head[2] - self.foot[2], self.head[0] - self.foot[0])
        return slope if self.force >= 0 else slope + math.pi

    @property
    def arrow(self) -> float:
        """Length of the arrow [m]."""
        return FULL_ARROW * min(self.utilisation, 1.0) if math.isfinite(self.utilisation) else 0.0

    @property
    def tip(self) -> Point:
        """Where the arrow ends [m]."""
        x, y, z = self.middle
        return x + self.arrow * math.cos(self.direction), y, z + self.arrow * math.sin(self.direction)

    @property
    def colour(self) -> tuple[float, float, float]:
        """Red, green and blue."""
        return colour(self.utilisation)

    @property
    def text(self) -> str:
        """Force and utilisation in words."""
        return f"{self.cell} {self.force / 1000:.2f} kN, {100 * self.utilisation:.0f} %"


class Picture(NamedTuple):
    """Columns, as both ends (x, y, z) [m] of each straight piece, and braces."""

    columns: list[Point]
    braces: list[Brace]


class Scene:
    """A rig's building.

    Parameters
    ----------
    rig
        What is drawn.
    """

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._levels = [0.0, *rig.storey_heights.cumsum().tolist()]
        self._joints = joint_names(rig)

    def frames(self, sway: Mapping[str, float], exaggeration: float, time: int) -> FrameTransforms:
        """Where the floors are.

        Parameters
        ----------
        sway
            Values of a sample by their names, as `Samples.last`.
        exaggeration
            Times which displacements are enlarged.
        time
            Of the sample [ns].
        """
        stamp = _stamp(time)
        places = self._places(sway, exaggeration)[1:]
        return FrameTransforms(
            transforms=[
                FrameTransform(
                    timestamp=stamp,
                    parent_frame_id=FRAME,
                    child_frame_id=f"{joint}_link",
                    translation=Vector3(x=x, y=0.0, z=z),
                    rotation=Quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
                )
                for joint, (x, z) in zip(self._joints, places, strict=True)
            ]
        )

    def picture(self, sample: Mapping[str, float], exaggeration: float) -> Picture:
        """Columns and braces, with force and utilisation of each.

        Parameters
        ----------
        sample
            Values by their names, as `Samples.loaded`.
        exaggeration
            As for `frames`.
        """
        places = self._places(sample, exaggeration)
        cells = iter(load_cell_names(self._rig.braces_in_group))
        return Picture(
            _columns(places),
            [
                self._brace(next(cells), group, number, sample, places)
                for group in self._rig.braces
                for number in range(group.count)
            ],
        )

    def _places(self, sample: Mapping[str, float], exaggeration: float) -> list[tuple[float, float]]:
        """Of the table and each floor: along x as drawn, and height [m]."""
        moved = [sample.get(f"x{floor}", 0.0) for floor in range(1, self._rig.floors + 1)]
        x = [0.0, *(exaggeration * value if math.isfinite(value) else 0.0 for value in moved)]
        return list(zip(x, self._levels, strict=True))

    def _brace(
        self,
        cell: str,
        group: BraceGroup,
        number: int,
        sample: Mapping[str, float],
        places: list[tuple[float, float]],
    ) -> Brace:
        """A brace from the floor below to its own."""
        (below, bottom), (above, top) = places[group.floor - 1], places[group.floor]
        run = min((top - bottom) * group.cosine / math.sqrt(max(1 - group.cosine**2, 1e-6)), 0.95 * PLATE[0])
        y = PLATE[1] * (0.5 if group.count == 1 else number / (group.count - 1)) - PLATE[1] / 2
        foot, head = (below - run / 2, y, bottom), (above + run / 2, y, top)
        return Brace(cell, foot, head, sample.get(cell, math.nan), sample.get(f"{cell}{UTILISATION}", math.nan))


def scene_update(picture: Picture, time: int) -> SceneUpdate:
    """A `picture` as Foxglove draws it: a brace is a line, with an arrow of its force along it, and both numbers.

    Parameters
    ----------
    picture
        What is drawn.
    time
        Of the sample [ns].
    """
    stamp = _stamp(time)
    points = [Point3(x=x, y=y, z=z) for x, y, z in picture.columns]
    red, green, blue = GREY
    grey = Color(r=red, g=green, b=blue, a=1.0)
    lines = [LinePrimitive(type=LinePrimitiveLineType.LineList, thickness=COLUMN, color=grey, points=points)]
    columns = SceneEntity(timestamp=stamp, frame_id=FRAME, id="columns", lines=lines)
    return SceneUpdate(entities=[columns, *(_entity(brace, stamp) for brace in picture.braces)])


def _entity(brace: Brace, stamp: Timestamp) -> SceneEntity:
    red, green, blue = brace.colour
    paint = Color(r=red, g=green, b=blue, a=1.0)
    x, y, z = brace.middle
    middle, length = Vector3(x=x, y=y, z=z), brace.arrow
    ends = [Point3(x=x, y=y, z=z) for x, y, z in (brace.foot, brace.head)]
    return SceneEntity(
        timestamp=stamp,
        frame_id=FRAME,
        id=brace.cell,
        lines=[LinePrimitive(type=LinePrimitiveLineType.LineStrip, thickness=BRACE, color=paint, points=ends)],
        arrows=[
            ArrowPrimitive(
                pose=Pose(position=middle, orientation=_about_y(brace.direction)),
                shaft_length=length,
                shaft_diameter=SHAFT,
                head_length=HEAD if length else 0.0,
                head_diameter=2 * SHAFT,
                color=paint,
            )
        ],
        texts=[
            TextPrimitive(
                pose=Pose(position=middle, orientation=_about_y(0.0)),
                billboard=True,
                font_size=TEXT,
                color=paint,
                text=brace.text,
            )
        ],
    )


def _columns(places: list[tuple[float, float]]) -> list[Point]:
    """Both ends of every piece of the columns at the four corners, each clamped in both its floors."""
    points = []
    for (below, bottom), (above, top) in itertools.pairwise(places):
        parts = [part / COLUMN_PARTS for part in range(COLUMN_PARTS + 1)]
        line = [(below + (above - below) * (3 * s**2 - 2 * s**3), bottom + (top - bottom) * s) for s in parts]
        for x, y in itertools.product((-PLATE[0] / 2, PLATE[0] / 2), (-PLATE[1] / 2, PLATE[1] / 2)):
            for piece in itertools.pairwise(line):
                points += [(x + sway, y, z) for sway, z in piece]
    return points


def _about_y(slope: float) -> Quaternion:
    """Turns the x axis to a `slope` [rad] in the plane of the frame."""
    return Quaternion(x=0.0, y=-math.sin(slope / 2), z=0.0, w=math.cos(slope / 2))


def _stamp(time: int) -> Timestamp:
    return Timestamp(sec=time // 10**9, nsec=time % 10**9)
