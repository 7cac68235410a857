# SPDX-License-Identifier: Apache-2.0
"""The node `viewer`: the running graph for Foxglove and Lichtblick.

abrace run abrace_bringup viewer --ros-args -p port:=8765
"""

from __future__ import annotations

import os
import time

from rclpy.clock import Clock, ClockType

from abrace_bringup.nodes.live_topics import LiveTopics
from abrace_bringup.viewing.server import ViewServer
from abrace_node.node import DISPLAY_PERIOD, AbraceNode
from abrace_node.parameters import Parameter
from abrace_node.process import run

PARAMETERS = [
    Parameter("host", "127.0.0.1", "address to listen on; beyond this machine anyone can see it", required=True),
    Parameter("port", 8765, "port of the WebSocket server for Foxglove and Lichtblick", minimum=0, maximum=65535),
]
NICENESS = 5
"""Niceness of the process: nodes of the loop go first."""
DISCOVERY_PERIOD = 0.5
"""Seconds between searches for topics, and for the topics that viewers have subscribed to."""


class Viewer(AbraceNode):
    """Passes messages on to viewers."""

    def __init__(self) -> None:
        super().__init__("viewer", PARAMETERS)
        given = self.parameters
        self.server = ViewServer(given.host, given.port, "abrace")
        self.topics = LiveTopics(self, self.server)
        self.create_timer(DISCOVERY_PERIOD, self.look_around, clock=Clock(clock_type=ClockType.STEADY_TIME))
        print(f"viewer: Foxglove, Lichtblick: ws://{given.host}:{self.server.port}", flush=True)
        self.due = time.monotonic()

    def tick(self) -> None:
        """Pass on the messages received."""
        self.due = max(time.monotonic(), (self.due or 0.0) + DISPLAY_PERIOD)
        self.server.greet()
        self.topics.receive()

    def look_around(self) -> None:
        """Offer new topics, and subscribe to the topics that viewers have subscribed to."""
        self.topics.discover()
        self.topics.subscribe()

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `/diagnostics`."""
        return None, "running", {"topics": len(self.server.topics), "lost": self.topics.lost}

    def close(self) -> None:
        """Disconnect all viewers, and remove the subscriptions."""
        self.server.close()
        self.topics.close()


def main() -> int:
    """Entry point."""
    os.nice(NICENESS)
    return run(Viewer)
