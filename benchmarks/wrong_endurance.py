# SPDX-License-Identifier: Apache-2.0
"""Endurance of the nodes that stream: messages of right types and wrong content on every topic and service of each.

topics, services, messages  how many were tried, and the messages of all
not_finite                  samples at which what acted was not finite
greatest_force, worst_step  of what acted [N], the latter in a sample period; capacity and rate limit allow 24516.625
                            and 10000
worst_between               the two samples between which it changed most
died                        nodes; the measurement ends where one does

python benchmarks/wrong_endurance.py [MESSAGES]    # on each topic and service
"""

from __future__ import annotations

import json
import os
import random
import sys
from typing import Any

from geometry_msgs.msg import AccelStamped
from isolation import isolated
from rcl_interfaces.srv import ListParameters
from running_graph import Graph, graph_of_its_own
from wrong_messages import WrongMessages

from abrace_interfaces.msg import BraceCommand, Response

CAPACITY, RATE_STEP = 24516.625, 5.0e6 / 500
MESSAGES = 10_000
NODES = ("plant", "ground_motion", "excitation", "controller")


def wrong_endurance(graph: Graph, messages: int, requests: int, chance: random.Random) -> dict[str, Any]:
    """So many `messages` on each topic and `requests` of each service of a plant and all that command it."""
    from controller_speed import lqg3

    from abrace_core.controller_file import save_controller

    save_controller(lqg3(), graph.folder / "lqg3.yaml")
    graph.by_the_clock = True
    graph.start("plant")
    graph.start("excitation", rms=3000.0, duration=600.0)
    graph.start("ground_motion", record="white_noise", rms=0.1, duration=100.0)
    # two senders are a fault: the controller receives the rig's samples, but its own commands reach no node
    graph.start("controller", "--params-file", graph.folder / "lqg3.yaml", "-r", "brace_command:=unheard")
    fuzz = WrongMessages(graph, chance)
    graph.until(lambda: len(graph.statuses) == len(NODES), "all nodes")

    def go_on() -> None:
        """Let the rig act again, as a person would that knows no better."""
        for name in ("excitation", "ground_motion", "controller", "plant"):
            graph.clear_fault(name)
        if fuzz.last is not None and fuzz.last.state == Response.RUNNING:
            for transition in ("deactivate", "activate"):
                graph.change_state("excitation", transition)

    def running() -> bool:
        """Whether commands act, with some patience."""
        acting = (Response.RUNNING, Response.FADING_IN)
        if fuzz.last is None or fuzz.last.state not in acting:
            go_on()
        return fuzz.last is not None and fuzz.last.state in acting

    graph.until(running, "the rig to run")
    topics = {"brace_command": BraceCommand, "ground_motion": AccelStamped, "response": Response}
    for topic, kind in topics.items():
        fuzz.send(kind, topic, messages, go_on)
    sent, services = len(topics) * messages, 0
    for name in NODES:
        listed = graph.call(ListParameters, f"{name}/list_parameters", ListParameters.Request())
        for service, service_type in fuzz.services(name):
            fuzz.ask(service, service_type, requests, list(listed.result.names))
            services += 1
            sent += requests
    # each of them still does what it is for
    graph.until(running, "the rig to run")
    return {
        "topics": len(topics),
        "services": services,
        "messages": sent,
        "samples": fuzz.samples,
        "not_finite": fuzz.not_finite,
        "greatest_force": fuzz.greatest,
        "worst_step": fuzz.worst_step,
        "worst_between": fuzz.worst_between,
        "died": sum(process.returncode is not None for process in graph.started.values()),
    }


def measure(messages: int = MESSAGES) -> dict[str, Any]:
    """All of it; call it on a domain of one's own."""
    with graph_of_its_own("/wrong") as graph:
        return wrong_endurance(graph, messages, messages, random.Random(1))


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with isolated():
        print(json.dumps(measure(int(sys.argv[1]) if len(sys.argv) > 1 else MESSAGES), indent=1))
