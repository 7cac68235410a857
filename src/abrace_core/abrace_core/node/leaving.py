# SPDX-License-Identifier: Apache-2.0
"""How a node leaves the ROS graph."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from rclpy.impl.implementation_singleton import rclpy_implementation

if TYPE_CHECKING:
    from rclpy.node import Node

PAUSE = 0.02
"""Seconds between the end of a node and that of its DDS participant: other processes handle the first meanwhile."""


def destroy(node: Node) -> None:
    """Destroy the only node of its context, so that no other process lists it any longer.

    Other processes receive the end of a node and that of its DDS participant in two threads. A busy process that is
    still handling the first when the second arrives lists the node for as long as it runs: 5 of 140 loggers that were
    ended by many signals. Therefore a second, hidden node keeps the participant a moment longer.
    """
    context = node.context.handle
    with context:
        keeper = rclpy_implementation.Node(
            f"_{node.get_name()}_leaves", node.get_namespace(), context, None, False, False
        )
    node.destroy_node()
    time.sleep(PAUSE)
    keeper.destroy_when_not_in_use()
