# SPDX-License-Identifier: Apache-2.0
"""Nodes that command nothing, killed (kill -9) while a force acts: what that costs the others. For `make verify`.

nodes                  that are killed: logger, page, viewer, and a plain node as `ros2 topic echo` and foxglove_bridge
                       are: with Fast DDS's own profile, subscribed to the streams
kills, stops           how often in all, and faults of the rig within WATCHED seconds after one
worst_samples          most samples in a row in which the rig got no new command, within WATCHED seconds after a kill
worst_at_removal       of these, when Fast DDS gives up a killed node, LEASE seconds after its end
seconds_without_kills, stops_without_kills, worst_without_kills  the same while no node had been killed: the computer's
while_stalled          the same when the machine itself stalled for 1 ms or more (machine_stalls.py), killed or not;
                       these are not among the others
more_than              by number N: how often more than N samples, at removals, and in a minute without kills

A publisher keeps the samples that a killed subscriber has not acknowledged until it gives that one up, and lets go of
all at once if nobody else is missing them. So the nodes are killed in rounds: all of a round before the first one of it
is given up, the next round after the last one is; each is the last one in turn.

python benchmarks/killed_nodes.py [ROUNDS]
"""

from __future__ import annotations

import json
import os
import sys
import time
from typing import TYPE_CHECKING, Any

import rclpy
from claims import Claim
from isolation import isolated
from joins import Node
from machine_stalls import MachineStalls
from running_graph import graph_of_its_own
from safety_by_the_clock import SHAKEN, Rig, stamp_of

from abrace_interfaces.msg import BraceCommand, Response

if TYPE_CHECKING:
    from running_graph import Graph

ROUNDS = 20
NODES = ("logger", "operator", "viewer", "plain")
LEASE = 20.0
"""Seconds after which Fast DDS gives up a participant that is no longer announced."""
AT_REMOVAL = (-1.0, 0.2)
"""Seconds about the end of the lease within which the others give it up: they heard of it last before the kill."""
APART = 1.5
"""Seconds between the kills of a round."""
ROUND = LEASE + (len(NODES) - 1) * APART + 2.0
WATCHED = 30.0
"""Seconds for which each kill is watched."""
BRIDGED = 5
"""Samples in a row that those who command bridge."""
QUIET = 30.0
"""Seconds without kills before those of a motion."""
FORCE = 1e3
"""Newtons with which the braces push when the first node is killed."""
ATTEMPTS = 10
"""To have a force act: a machine that stands still for 20 ms causes a fault, too."""
STALLED = 0.05
"""Seconds before a sample within which a stall of the machine is the cause."""
COUNTED = range(BRIDGED + 1)


class Held:
    """Finds the samples in which the rig got no new command: what acts, that of a controller, changes in each sample.

    Attributes
    ----------
    found
        (when it ended [s, wall clock], samples) of each run of them.
    stops
        When the rig did no longer run [s, wall clock].
    """

    def __init__(self) -> None:
        self.found: list[tuple[float, int]] = []
        self.stops: list[float] = []
        self.begin()

    def begin(self) -> None:
        """Forget what was before the next sample."""
        self._run, self._changed, self._command, self._running = -1, -1, 0.0, False

    def take(self, responses: list[Response]) -> None:
        """Look at the next samples."""
        for one in responses:
            command, when = one.command[0], 1e-9 * stamp_of(one)
            if command != self._command or one.run != self._run:
                held = one.sequence - self._changed - 1
                if held > 0 and one.run == self._run and self._changed >= 0:
                    self.found.append((when, held))
                self._run, self._changed, self._command = one.run, one.sequence, command
            if one.state != Response.RUNNING:
                self._changed = -1
                if self._running:
                    self.stops.append(when)
            self._running = one.state == Response.RUNNING


class Killing:
    """A rig with a controller and a shaken table, and those who look on, who are killed and started again.

    Attributes
    ----------
    kills
        When [s, wall clock] which node was killed.
    quiet
        (begin, end) [s, wall clock] of the times without kills.
    held
        Samples without a new command, and stops.
    """

    def __init__(self, graph: Graph) -> None:
        self.graph, self.held = graph, Held()
        self.kills: list[tuple[float, str]] = []
        self.quiet: list[tuple[float, float]] = []
        self._loggers = 0
        self.ends = 0.0
        """When the motion ends [s, monotonic]."""
        self.rig = Rig(graph, "controller")
        for name in NODES:
            self._start(name)

    def _start(self, name: str) -> None:
        graph = self.graph
        if name == "plain":
            command = [sys.executable, __file__, "look", graph.namespace]
            graph.started[name] = graph.processes.start(name, command, graph.folder / "plain.log")
        elif name == "logger":
            self._loggers += 1
            graph.start(name, output=str(graph.folder / f"bag_{self._loggers}"))
        else:
            graph.start(name, port=0)

    def drive(self) -> None:
        """Let the table shake and the controller push; the motion is SHAKEN's."""
        for attempt in range(ATTEMPTS):
            try:
                if attempt:
                    self._move_to_the_middle()
                self.rig.begin()
                self.rig.until_driven(FORCE)
                break
            except AssertionError as error:
                print(f"once more: {error}", file=sys.stderr, flush=True)
                if attempt + 1 == ATTEMPTS:
                    raise
        self.ends = time.monotonic() + SHAKEN["duration"]
        del self.rig.responses[:-1], self.rig.commands[:-1]
        self.held.begin()

    def _move_to_the_middle(self) -> None:
        """Begin anew at rest: where stops have left the table there may be no room for the motion."""
        rig = self.rig
        rig.take("plant", "deactivate", "cleanup", "configure")
        self.graph.until(rig.cleared, "the rig to be cleared")
        rig.take("plant", "activate")
        rig.take("ground_motion", "deactivate", "cleanup", "configure", "activate")

    def wait(self, seconds: float) -> None:
        """Watch for so long; a fault is noted and cleared, as a person does, and all is driven on."""
        rig, end = self.rig, time.monotonic() + seconds
        while time.monotonic() < end:
            look = min(end, time.monotonic() + 1.0)
            self.graph.until(lambda: time.monotonic() >= look, "the next look")  # noqa: B023
            self.held.take(rig.responses[:-1])
            del rig.responses[:-1], rig.commands[:-1]
            if rig.last.state != Response.RUNNING:
                self.held.take(rig.responses)
                print(f"a stop, {self.since(1e-9 * stamp_of(rig.last))}: {rig.last.cause}", file=sys.stderr, flush=True)
                self.drive()

    def since(self, when: float) -> str:
        """How long before a moment [s, wall clock] who was killed."""
        return ", ".join(f"{when - kill:.2f} s after {name}" for kill, name in self.kills if 0 < when - kill < WATCHED)

    def without_kills(self, seconds: float) -> None:
        """Watch when all kills are long past."""
        if self.kills:
            self.wait(self.kills[-1][0] + WATCHED - time.time())
        begin = time.time()
        self.wait(seconds)
        self.quiet.append((begin, time.time()))

    def round(self, number: int) -> None:
        """Kill each node once, and start it again; each is the last one in turn."""
        self.graph.until_matched("plant", response=len(NODES) + 1)
        begin = time.monotonic()
        for place in range(len(NODES)):
            self.wait(begin + place * APART - time.monotonic())
            name = NODES[(number + place) % len(NODES)]
            self.graph.kill(name)
            self.kills.append((time.time(), name))
            self.graph.processes.stop(name)
            self._start(name)
        self.wait(begin + ROUND - time.monotonic())


def killed_nodes(rounds: int = ROUNDS) -> dict[str, Any]:
    """All rounds; call it on a domain of one's own."""
    with graph_of_its_own("/killed") as graph, MachineStalls() as stalls:
        killing = Killing(graph)
        for number in range(rounds):
            left = killing.ends - time.monotonic()
            if left < ROUND:
                killing.wait(left)
                killing.drive()
                killing.without_kills(QUIET)
            killing.round(number)
        killing.wait(WATCHED)
        return _found(killing, stalls)


def _found(killing: Killing, stalls: MachineStalls) -> dict[str, Any]:
    ahead = time.time() - time.monotonic()

    def stalled(when: float) -> bool:
        return bool(stalls.since(when - ahead - STALLED, when - ahead))

    def after_kill(when: float, begin: float = 0.0, end: float = WATCHED) -> bool:
        return any(begin < when - kill < end for kill, _ in killing.kills)

    def quiet(when: float) -> bool:
        return any(begin < when < end for begin, end in killing.quiet)

    of_machine = [held for when, held in killing.held.found if held > 1 and stalled(when)]
    own = [(when, held) for when, held in killing.held.found if held <= 1 or not stalled(when)]
    watched = [held for when, held in own if after_kill(when)]
    removal = [held for when, held in own if after_kill(when, LEASE + AT_REMOVAL[0], LEASE + AT_REMOVAL[1])]
    without = [held for when, held in own if quiet(when)]
    stops = [when for when in killing.held.stops if not stalled(when)]
    seconds = sum(end - begin for begin, end in killing.quiet)
    for when, held in own:
        if held > BRIDGED - 2:
            print(f"{held} samples without a command: {killing.since(when)}", file=sys.stderr, flush=True)
    return {
        "nodes": list(NODES),
        "kills": len(killing.kills),
        "stops": sum(map(after_kill, stops)),
        "worst_samples": max(watched, default=0),
        "worst_at_removal": max(removal, default=0),
        "seconds_without_kills": round(seconds),
        "stops_without_kills": sum(map(quiet, stops)),
        "worst_without_kills": max(without, default=0),
        "while_stalled": {
            "stops": len(killing.held.stops) - len(stops),
            "worst_samples": max(of_machine, default=0),
        },
        "more_than": {
            str(count): {
                "at_removals": sum(held > count for held in removal),
                "a_minute_without_kills": round(sum(held > count for held in without) * 60 / seconds, 1),
            }
            for count in COUNTED
        },
    }


def look(namespace: str) -> None:
    """A plain node that subscribes to the streams, until it is killed."""
    node = Node("plain")
    for message_type, topic in ((Response, "response"), (BraceCommand, "brace_command")):
        node.listen(message_type, f"{namespace}/{topic}", lambda _: None)
    node.until(lambda: not rclpy.ok(context=node.context))


def verify_killed_nodes() -> tuple[dict[str, Any], list[Claim]]:
    """Values for verify.json, and claims."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with isolated():
        found = killed_nodes()
    peer = f"without kills {found['worst_without_kills']}"
    stops = f"{found['kills']} kills; {found['while_stalled']['stops']} stops by the machine itself"
    return found, [
        Claim("killed nodes that command nothing: stops of the rig", found["stops"], 0, stops),
        Claim("killed nodes: most samples without a command", found["worst_samples"], BRIDGED, peer),
    ]


if __name__ == "__main__":
    if sys.argv[1:2] == ["look"]:
        look(sys.argv[2])
    else:
        os.environ.setdefault("OMP_NUM_THREADS", "1")
        with isolated():
            print(json.dumps(killed_nodes(*map(int, sys.argv[1:])), indent=1))
