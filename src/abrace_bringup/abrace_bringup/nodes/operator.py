# SPDX-License-Identifier: Apache-2.0
"""The node `operator`: a page in the browser on which a person watches a rig, arms it, records, and stops it.

With operate:=false the page only watches, and the node commands nothing.

abrace run abrace_bringup operator --ros-args -r __ns:=/rig -p rig:=ncree_three_storey
"""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any

from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.clock import Clock, ClockType
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from abrace.nodes.graph_operator import STOP_TOPIC, GraphOperator, StopButton
from abrace.report.node_table import NodeReports
from abrace_bringup.page import actions, view
from abrace_bringup.page.access import make_access
from abrace_bringup.page.samples import ResponseReader, Samples
from abrace_bringup.page.server import PageServer
from abrace_bringup.page.stop_request import StopRequest
from abrace_bringup.page.traces import Traces
from abrace_bringup.viewing.layout import foxglove_layout
from abrace_core import AbraceError
from abrace_core.files.installed import find_file
from abrace_interfaces.msg import Response
from abrace_node.node import AbraceNode
from abrace_node.parameters import Parameter
from abrace_node.process import run
from abrace_node.transport import TRANSIENT_LOCAL_QOS
from abrace_plant.rig.file import load_rig

PARAMETERS = [
    Parameter(
        "rig",
        "ncree_three_storey",
        "rig whose floors and capacity are shown: a name in abrace_plant's configuration or a file",
        required=True,
    ),
    Parameter(
        "address",
        "127.0.0.1",
        "IP address that the page is served on; to operate beyond loopback only with token_file, certificate and key",
        required=True,
    ),
    Parameter("port", 8642, "port of the page; 0: a free one", minimum=0, maximum=65535),
    Parameter("hosts", [], "further host names by which browsers reach this machine", element=str),
    Parameter("operate", True, "false: pages only watch, and the node commands nothing"),
    Parameter("token_file", "", "file with the token that a page has to give to operate; empty: none"),
    Parameter("certificate", "", "PEM file with the certificate, for TLS; empty: none"),
    Parameter("key", "", "PEM file with the certificate's key"),
    Parameter(
        "page_heartbeat",
        0.0,
        "s within which every page that operates has to answer, at least 0.5; a lost one is a stop; 0: pages may come "
        "and go",
        minimum=0.0,
        maximum=60.0,
    ),
]
SHORTEST_HEARTBEAT = 0.5
"""Seconds: a page answers ten times a second, a busy browser less often."""
WATCH_PERIOD = 0.05
"""Seconds between looks whether a page is lost."""
LOOK_PERIOD = 1.0
"""Seconds between looks for nodes and their services."""
FIND_TIME = 3.0
"""Seconds in which a node that has just started is found: it is shown by its reports before its services are known."""
WAITING = 8
"""Actions that may wait for their turn."""
SAMPLES_PERIOD = 0.04
"""Seconds between looks at the samples that have come."""
DISPLAY_QOS = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Of the page's subscription to samples: it must not hold up a rig."""
TYPES = {"change_state": ChangeState}


class OperatorPage(AbraceNode):
    """Serves the page; samples and reports come in the main thread, what is pressed in the server's.

    STOP is published there at once. Everything else is done in turn in a third thread.
    """

    streams = True

    def __init__(self) -> None:
        super().__init__("operator", PARAMETERS)
        given = self.parameters
        self.rig = load_rig(find_file(given.rig, "abrace_plant", "config", ".yaml", "rig"))
        if 0 < given.page_heartbeat < SHORTEST_HEARTBEAT:
            expected = f"expected 0, or at least {SHORTEST_HEARTBEAT:g}"
            raise AbraceError(f"parameter page_heartbeat: {given.page_heartbeat:g}, {expected}")
        if given.page_heartbeat and not given.operate:
            raise AbraceError(f"parameter page_heartbeat: {given.page_heartbeat:g}, expected 0 with operate:=false")
        access = make_access(
            given.address, given.port, given.hosts, given.operate, given.token_file, given.certificate, given.key
        )
        self.closing = threading.Event()
        self.operator = GraphOperator(self, self.let_pass)
        self.request = StopRequest(given.page_heartbeat)
        response, description = (self.resolve_topic_name(name) for name in ("response", "robot_description"))
        size = self.rig.floors, self.rig.braces_in_group
        layout = foxglove_layout(*size, response, description, self.rig.not_measured)
        self.server = PageServer(access, self, {"/foxglove.json": (layout, "application/json")}, self.page_failed)
        self.button: StopButton | None = None
        if given.operate:
            publisher = self.publish_on(Bool, STOP_TOPIC, TRANSIENT_LOCAL_QOS)
            self.button = StopButton(self, publisher, lambda: bool(self.request.reason(time.monotonic())))
        self.asked = ""
        self.offers: dict[str, frozenset[str]] = {}
        self.rigs: list[str] = []
        self.reader = ResponseReader()
        self.received: list[bytes] = []
        self.last: tuple[Samples, float] | None = None
        self.traces, self.events = Traces(), view.Events()
        self.worker = ThreadPoolExecutor(1, "actions")
        self.waiting = threading.BoundedSemaphore(WAITING)
        self.subscribe_to(Response, "response", self.received.append, DISPLAY_QOS, raw=True)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(WATCH_PERIOD, self.watch, clock=steady)
        self.create_timer(LOOK_PERIOD, self.look, clock=steady)

    def autostart(self) -> None:
        """Serve the page."""
        self.server.start()
        self.due = time.monotonic()
        print(f"operator: the page is {self.server.access.url}", flush=True)

    def tick(self) -> None:
        """Take the samples that have come."""
        self.due = max(time.monotonic(), (self.due or 0.0) + SAMPLES_PERIOD)
        payloads = self.received.copy()
        self.received.clear()
        if not payloads:
            return
        try:
            samples = self.reader.read(payloads)
        except AbraceError:
            return  # of a type that this is not: the rig is shown as silent
        self.traces.add(samples.runs, samples.stamps, view.on_screen(samples, self.rig))
        self.last = samples, time.monotonic()

    def watch(self) -> None:
        """Publish at once that a stop is requested, or no longer requested."""
        reason = self.request.reason(time.monotonic())
        if reason != self.asked:
            self.asked = reason
            self.press()
            self.note(f"STOP: {reason}" if reason else "STOP released", bool(reason))
            self.publish_diagnostics()

    def press(self) -> None:
        """Publish now whether the stop is pressed; from any thread."""
        if self.button is not None:
            self.button.publish()

    def look(self) -> None:
        """Look for nodes and what they offer; clients are made before they are needed."""
        self.offers = actions.offers([name for name, _ in self.get_service_names_and_types()])
        self.rigs = self.operator.rigs()
        own = self.get_namespace().rstrip("/")
        for node, services in self.offers.items():
            if self.button is not None and node.rpartition("/")[0] == own:
                for service in services:
                    self.operator.client(TYPES.get(service, Trigger), f"{node}/{service}")
                if "change_state" in services:
                    self.operator.client(GetState, f"{node}/get_state")
        gone = [name for name, one in self.operator.reports.items() if time.monotonic() - one.heard > view.GONE]
        for name in gone:
            del self.operator.reports[name]

    # called by the server, in its thread

    def hello(self) -> dict[str, Any]:
        """What a page gets once."""
        return {"rig": view.rig_view(self.rig)}

    def frame(self, bins: int, events: int) -> dict[str, Any]:
        """What a page gets that has the `bins` and `events` up to these numbers."""
        now, reports, last = time.monotonic(), NodeReports(self.operator.reports), self.last
        rigs = [name for name in self.rigs if name.rpartition("/")[0] == self.get_namespace().rstrip("/")]
        recorders = actions.recorders(self.offers, self.get_namespace())
        done = self.events.since(events)
        return {
            "sample": view.sample_view(last and last[0], now - last[1] if last else 0.0, self.rig),
            "stop": self.request.reason(now),
            "traces": self.traces.since(bins),
            "interlocks": view.interlock_view(next((reports[name] for name in rigs if name in reports), None)),
            "latency": view.latency_view(reports),
            "recording": view.recording_view(reports, recorders, now),
            "nodes": view.node_view(reports, self.offers, now),
            "events": done,
            "event_number": done[-1]["number"] if done else events,
        }

    def hear(self, page: object) -> None:
        """A page that operates is there."""
        self.request.hear(page, time.monotonic())

    def lose(self, page: object) -> None:
        """A page that operates is gone."""
        self.request.lose(page)

    def ask(self, action: str, node: str) -> None:
        """A person requests an `action`; STOP is published at once."""
        if action == "stop":
            self.request.press("pressed on the page")
            self.press()
        elif action == "release":
            try:
                self.request.release()
            except AbraceError as error:
                self.note(f"release STOP: {error}", True)
        elif not self.waiting.acquire(blocking=False):
            self.note(f"{action}: not done, {WAITING} others wait", True)
        else:
            self.worker.submit(self.catching(self.act), action, node)

    # in the thread of actions

    def act(self, action: str, node: str) -> None:
        """Carry it out, and note the result."""
        try:
            if action != "clear":  # whose nodes are known by their reports
                self.operator.wait(FIND_TIME, lambda: self.finds(action, node))
            for name in self.targets(action, node):
                self.note(f"{name}: {self.do(action, name)}")
        except AbraceError as error:
            self.note(f"{actions.WORDS.get(action, action)}: {error}", True)
        finally:
            self.waiting.release()

    def targets(self, action: str, node: str) -> list[str]:
        """Full names of the nodes to which it is done; an AbraceError says that there is none."""
        failed = [name for name, one in NodeReports(self.operator.reports).items() if one.failed]
        return actions.targets(action, node, self.offers, self.get_namespace(), self.rigs, failed)

    def finds(self, action: str, node: str) -> bool:
        """Whether a node is known to which it can be done."""
        with suppress(AbraceError):
            return bool(self.targets(action, node))
        return False

    def do(self, action: str, name: str) -> str:
        """Carry it out on a node; returns the node's answer."""
        if action == "arm":
            return self.operator.arm(name)
        if action == "disarm":
            return self.operator.disarm(name)
        return self.operator.trigger(f"{name}/{actions.NEEDS[action]}")

    def let_pass(self) -> None:
        """Wait a moment, while the main thread receives."""
        if self.closing.wait(0.01):
            raise AbraceError("not done: the operator's node is ending")

    def note(self, text: str, bad: bool = False) -> None:
        """Show it on the pages and in the log; from any thread."""
        self.events.add(time.time(), text, bad)
        # rclpy has one severity for each line of code
        if bad:
            self.get_logger().warning(text)
        else:
            self.get_logger().info(text)

    def page_failed(self, error: BaseException) -> None:
        """The server's thread has died: STOP can no longer be pressed there."""
        self.request.press(f"the page's server has failed: {error}")
        self.fail(error)

    def diagnose(self) -> tuple[str | None, str, dict[str, object]]:
        """State for `/diagnostics`."""
        pages = self.server.open_pages
        values: dict[str, object] = {"pages": pages, "refused requests": self.server.refused}
        if self.server.refused:
            values["last refusal"] = self.server.last_refusal
        if self.asked:
            values["asks for a stop"] = self.asked
        return None, f"{pages} page{'' if pages == 1 else 's'} open at {self.server.access.url}", values

    def close(self) -> None:
        """Close the pages; where they had to stay, that is a stop."""
        self.closing.set()
        self.worker.shutdown(cancel_futures=True)
        self.server.stop()
        self.press()


def main() -> int:
    """Entry point."""
    return run(OperatorPage)
