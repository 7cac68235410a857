# SPDX-License-Identifier: Apache-2.0
"""The node `viewer`: the running graph, or a bag, for Foxglove, Lichtblick and any browser.

abrace run abrace_bringup viewer --ros-args -p rig:=five_storey -p exaggeration:=50.0
"""

from __future__ import annotations

import os
import secrets
import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import NameValidationException

from abrace.report.node_table import NodeReports
from abrace_bags import read_facts
from abrace_bringup.nodes.live_topics import LiveTopics
from abrace_bringup.nodes.markers import Markers
from abrace_bringup.nodes.viewer_operations import Operations
from abrace_bringup.operator_page.access import read_token
from abrace_bringup.viewing.bag_source import BagSource
from abrace_bringup.viewing.display import Display
from abrace_bringup.viewing.guard import Guard, own_origins
from abrace_bringup.viewing.layout import layout, plotjuggler_layout
from abrace_bringup.viewing.named_channels import RESPONSE_TYPE, names_of
from abrace_bringup.viewing.page import PageServer, facts
from abrace_bringup.viewing.server import NODES, ViewServer
from abrace_core.errors import AbraceError
from abrace_core.node import DIAGNOSTICS, DISPLAY_PERIOD, AbraceNode, Parameter, RCLError, find_file, rcl_message, run
from abrace_plant.rig.file import load_rig, recorded_rig
from abrace_plant.rig.model import Rig

PARAMETERS = [
    Parameter("bag", "", "bag to play: a directory or a file; empty: the running graph"),
    Parameter("rig", "", "rig: a name or a file; empty: the bag's own, of the graph ncree_three_storey"),
    Parameter("response", "", "topic of the rig's samples; empty: the first that is found"),
    Parameter("exaggeration", 20.0, "factor by which displacements are enlarged", minimum=1.0, maximum=1e4, live=True),
    Parameter("host", "127.0.0.1", "address to listen on; beyond this machine anyone can see it", required=True),
    Parameter("port", 8765, "port of the WebSocket server for Foxglove and Lichtblick", minimum=0, maximum=65535),
    Parameter("page_port", 8766, "port of the page for a browser", minimum=0, maximum=65535),
    Parameter("rate", 1.0, "bag time over time", minimum=0.001, maximum=1e3),
    Parameter("loop", True, "play the bag again after its last message"),
    Parameter("operate", False, "let viewers call services of the graph, set its parameters, and stop it"),
    Parameter("token_file", "", "with operate: file with the token that viewers have to give; empty: a new one"),
]
DEFAULT_RIG = "ncree_three_storey"
LAUNCHED_RIG = "/rig/response"
"""Topic of a rig's samples as the launch files have it."""
LOOPBACK = ("127.0.0.1", "localhost", "::1")
NICENESS = 5
"""Niceness of the process: nodes of the loop go first."""
DISCOVERY_PERIOD = 0.5
"""Seconds between searches for topics, and for the topics that viewers have subscribed to."""
REFUSAL_PERIOD = 5.0
"""Seconds between warnings of refused connections, which a page may repeat as often as it likes."""
REPORT_PERIOD = 1.0
"""Seconds between the states of nodes, as viewers get them."""


class Viewer(AbraceNode):
    """Passes messages on to viewers, and shows the rig's motion and forces."""

    def __init__(self) -> None:
        super().__init__("viewer", PARAMETERS)
        given = self.parameters
        if given.operate and given.host not in LOOPBACK:
            raise AbraceError(
                f"parameter operate: true with host {given.host}, expected a host of {', '.join(LOOPBACK)}"
            )
        if given.token_file and not given.operate:
            raise AbraceError("parameter token_file: given, expected operate:=true with it")
        self.bag = BagSource(given.bag, given.rate, given.loop) if given.bag else None
        rig = self.find_rig()
        self.rig_topic = self.topic_of_rig()
        self.operations = Operations(self, may_change=given.operate)
        token = self.find_token() if given.operate else ""
        self.server = ViewServer(
            given.host,
            given.port,
            f"abrace: {given.bag or rig.name}",
            Guard(given.host, given.port, token, self.on_refusal) if token else None,
            self.operations.capabilities(live=self.bag is None),
            self.operations.get_parameters,
            self.operations.set_parameters,
        )
        self.display = Display(self.server, rig, Markers(self))
        self.page = PageServer(
            given.host,
            given.page_port,
            facts(rig, self.server.port, given.exaggeration),
            layout(names_of(rig.floors, rig.braces_in_group)),
            lambda: plotjuggler_layout(rig.floors, rig.braces_in_group, self.rig_topic or LAUNCHED_RIG),
        )
        self.server.open_to(own_origins(self.page.port))
        self.topics: LiveTopics | None = None
        self.reports = NodeReports()
        self.problem = ""
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        if self.bag is None:
            self.topics = LiveTopics(self, self.server)
            self.create_subscription(DiagnosticArray, DIAGNOSTICS, self.on_diagnostics, 100)
            self.create_timer(DISCOVERY_PERIOD, self.look_around, clock=steady)
            self.create_timer(REPORT_PERIOD, self.report_nodes, clock=steady)
        else:
            self.offer_bag(self.bag)
        address = f"ws://{given.host}:{self.server.port}" + (f"/?token={token}" if token else "")
        print(f"viewer: {self.page.url} in a browser; Foxglove, Lichtblick: {address}", flush=True)
        self.due = time.monotonic()

    def find_token(self) -> str:
        """The token that clients need to operate."""
        return read_token(self.parameters.token_file) if self.parameters.token_file else secrets.token_urlsafe(16)

    def on_refusal(self, reason: str) -> None:
        """Log that a connection was refused; called in the guard's thread."""
        self.get_logger().warning(f"refused: {reason}", throttle_duration_sec=REFUSAL_PERIOD)

    def find_rig(self) -> Rig:
        """The rig that is drawn."""
        given = self.parameters
        rig = recorded_rig(read_facts(given.bag)) if given.bag and not given.rig else None
        return rig or load_rig(find_file(given.rig or DEFAULT_RIG, "abrace_plant", "config", ".yaml", "rig"))

    def topic_of_rig(self) -> str:
        """The topic of the rig's samples; empty: the first that the graph will have, or none in the bag."""
        given = self.parameters
        try:
            asked = self.resolve_topic_name(given.response) if given.response else ""
        except (RCLError, NameValidationException) as error:
            raise AbraceError(f"parameter response: {given.response}, {rcl_message(error)}") from error
        if self.bag is None:
            return asked
        rigs = [name for name, definition in self.bag.topics.items() if definition.type_name == RESPONSE_TYPE]
        if asked and asked not in rigs:
            raise AbraceError(f"parameter response: {asked}, {given.bag} has {', '.join(rigs) or 'no such topics'}")
        return asked or next(iter(rigs), "")

    def offer_bag(self, bag: BagSource) -> None:
        """Offer the topics of a bag."""
        for warning in bag.warnings:
            self.get_logger().warning(warning)
        for name, definition in bag.topics.items():
            if name not in self.server.topics:
                self.server.offer(name, definition)

    def tick(self) -> None:
        """Pass on the messages received, and show the rig."""
        self.due = max(time.monotonic(), (self.due or 0.0) + DISPLAY_PERIOD)
        self.server.greet()
        if self.topics is not None:
            self.topics.receive(self.take)
        else:
            self.play()
        self.display.show(self.parameters.exaggeration)
        if self.display.problem != self.problem:
            self.problem = self.display.problem
            self.server.warn(self.problem)
            if self.problem:
                self.get_logger().warning(self.problem)

    def take(self, topic: str, payload: bytes, received: int) -> None:
        """A message of the graph."""
        if topic == self.rig_topic:
            self.display.add(payload, received)

    def play(self) -> None:
        """Pass on the messages of the bag that are due."""
        assert self.bag is not None
        now = time.monotonic()
        for message in self.bag.messages(now, self.begin_anew):
            if self.server.wanted(message.topic):
                self.server.send(message.topic, message.payload, message.log_time)
            if message.topic == self.rig_topic and self.display.wanted:
                self.display.add(message.payload, message.log_time)
        self.server.tell_time(self.bag.time(now))

    def begin_anew(self) -> None:
        """The bag starts again from its first message."""
        self.display.finish(self.parameters.exaggeration)
        self.server.begin_anew()

    def look_around(self) -> None:
        """Offer new topics, and subscribe to the topics that viewers have subscribed to."""
        assert self.topics is not None
        self.topics.discover()
        if not self.rig_topic and self.topics.rigs:
            self.rig_topic = self.topics.rigs[0]
        if len(self.topics.rigs) > 1 and not self.parameters.response:
            others = ", ".join(self.topics.rigs[1:])
            self.get_logger().warning(f"{self.rig_topic} is shown, not {others} (parameter response)", once=True)
        self.topics.subscribe([self.rig_topic] if self.rig_topic and self.display.wanted else [])
        self.operations.offer(self.server)

    def on_diagnostics(self, array: DiagnosticArray) -> None:
        """Take the reports of nodes."""
        for status in array.status:
            self.reports.note(status, time.monotonic())

    def report_nodes(self) -> None:
        """Show viewers the state of each node, and which are stale."""
        rows = self.reports.rows(time.monotonic())
        self.server.send_json(NODES, {"nodes": rows}, self.get_clock().now().nanoseconds)

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `/diagnostics`."""
        values: dict[str, object] = {"samples": self.display.samples}
        if self.topics is not None:
            values["lost"] = self.topics.lost(self.rig_topic)
        what = self.parameters.bag or self.rig_topic or "waiting for a rig"
        shown = f"showing {what}" if self.display.wanted else f"no viewer has subscribed; {what}"
        return None, self.problem or shown, values

    def close(self) -> None:
        """Disconnect all viewers, and remove the subscriptions."""
        self.server.close()
        self.page.close()
        if self.topics is not None:
            self.topics.close()


def main() -> int:
    """Entry point."""
    os.nice(NICENESS)
    return run(Viewer)
