# SPDX-License-Identifier: Apache-2.0
"""The building for RViz: columns, braces coloured by their utilisation, an arrow and a number for each force."""

from __future__ import annotations

from typing import TYPE_CHECKING

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from abrace_bringup.viewing.scene import BRACE, COLUMN, FRAME, GREY, HEAD, SHAFT, TEXT

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rclpy.node import Node

    from abrace_bringup.viewing import scene

TOPIC = "markers"


class Markers:
    """Publishes pictures of the building while anybody has subscribed to them.

    Parameters
    ----------
    node
        That publishes them.
    """

    def __init__(self, node: Node) -> None:
        self._publisher = node.create_publisher(MarkerArray, TOPIC, 10)

    @property
    def wanted(self) -> bool:
        """Whether anybody has subscribed."""
        return bool(self._publisher.get_subscription_count() > 0)

    def take(self, picture: scene.Picture, time: int) -> None:
        """Publish a `picture` of a `time` [ns]."""
        self._publisher.publish(marker_array(picture, time))


def marker_array(picture: scene.Picture, time: int) -> MarkerArray:
    """A picture as RViz draws it.

    Parameters
    ----------
    picture
        What is drawn.
    time
        Of the sample [ns].
    """
    stamp = Time(sec=time // 10**9, nanosec=time % 10**9)
    markers = [_marker("columns", 0, Marker.LINE_LIST, GREY, (COLUMN, 0.0, 0.0), picture.columns)]
    for number, brace in enumerate(picture.braces):
        paint = brace.colour
        markers.append(_marker("braces", number, Marker.LINE_STRIP, paint, (BRACE, 0.0, 0.0), (brace.foot, brace.head)))
        ends = (brace.middle, brace.tip)
        markers.append(_marker("forces", number, Marker.ARROW, paint, (SHAFT, 2 * SHAFT, HEAD), ends))
        if not brace.arrow:
            markers[-1].action = Marker.DELETE
        text = _marker("numbers", number, Marker.TEXT_VIEW_FACING, paint, (0.0, 0.0, TEXT), ())
        x, y, z = brace.middle
        text.pose.position, text.text = Point(x=x, y=y, z=z), brace.text
        markers.append(text)
    for marker in markers:
        marker.header.frame_id, marker.header.stamp = FRAME, stamp
    return MarkerArray(markers=markers)


def _marker(
    of: str,
    number: int,
    kind: int,
    colour: tuple[float, float, float],
    scale: tuple[float, float, float],
    points: Sequence[tuple[float, float, float]],
) -> Marker:
    red, green, blue = colour
    paint = ColorRGBA(r=red, g=green, b=blue, a=1.0)
    marker = Marker(ns=of, id=number, type=kind, action=Marker.ADD, color=paint)
    marker.pose.orientation.w = 1.0
    marker.scale.x, marker.scale.y, marker.scale.z = scale
    marker.points = [Point(x=x, y=y, z=z) for x, y, z in points]
    return marker
