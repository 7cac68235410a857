# SPDX-License-Identifier: Apache-2.0
"""Messages whose types are right and whose content is wrong, and nodes that get them on every topic and service.

NaN, infinities, huge, empty and long; stamps, runs and sequences from elsewhere; parameters of wrong kinds.
"""

from __future__ import annotations

import importlib
import re
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from action_msgs.srv import CancelGoal
from geometry_msgs.msg import AccelStamped
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically

from abrace_interfaces.action import PlayGroundMotion
from abrace_interfaces.msg import BraceCommand, Response

if TYPE_CHECKING:
    import random
    from collections.abc import Callable, Iterator

    from rclpy.task import Future
    from running_graph import Graph

FRAME = "elsewhere"
"""Frame of the test's own Responses, which distinguishes them from the rig's."""
NUMBERS = (float("nan"), float("inf"), float("-inf"), 1.7e308, -1.7e308, 5e-324, 1e9, -1e9, 0.0, 1.0)
TEXTS = ("", "x", "x" * 5000, "\n", "../../..", "el_centro ", "nan", "ä")
LENGTHS = (0, 0, 1, 1, 2, 3, 3, 5, 300)
TRANSITIONS = (0, 8, 9, 10, 11, 60, 97, 98, 99, 200, 255)
"""Numbers of transitions that do not exist or may not be requested."""
BATCH = 8
"""Greatest number of calls in progress; a service queues ten."""


def _interface(name: str, folder: str) -> type:
    """The class of a message or service of this name, such as std_msgs/Header or std_srvs/srv/Trigger."""
    package, *_, kind = name.split("/")
    kind, _, part = kind.partition("_")
    found: type = getattr(importlib.import_module(f"{package}.{'action' if part else folder}"), kind)
    return getattr(found, part) if part else found


def _wrong_value(kind: str, chance: random.Random) -> Any:
    if kind.startswith("sequence<"):
        inner = re.sub(r",.*", "", kind[9:-1])
        return [_wrong_value(inner, chance) for _ in range(min(chance.choice(LENGTHS), 5 if "/" in inner else 300))]
    if match := re.fullmatch(r"(.+)\[(\d+)\]", kind):
        return [_wrong_value(match[1], chance) for _ in range(int(match[2]))]
    if match := re.fullmatch(r"(u?)int(\d+)", kind):
        bits = int(match[2])
        lowest, highest = (0, 2**bits - 1) if match[1] else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        return chance.choice((lowest, highest, 0, 1, chance.randint(lowest, highest)))
    if kind in ("double", "float"):
        return chance.choice(NUMBERS) if kind == "double" else chance.choice((0.0, float("nan")))
    if kind == "boolean":
        return chance.random() < 0.5
    if kind == "octet":
        return bytes([chance.randrange(256)])
    if kind.startswith("string"):
        return chance.choice(TEXTS)
    return wrong(_interface(kind, "msg"), chance)


def wrong(kind: type, chance: random.Random) -> Any:
    """A message or a request of a `kind` with meaningless fields."""
    message = kind()
    for name, field in message.get_fields_and_field_types().items():
        setattr(message, name, _wrong_value(field, chance))
    return message


def wrong_message(kind: type, chance: random.Random, last: Response | None) -> Any:
    """A message of the loop: also one whose run, sequence or stamp are those of the rig's `last` sample, or nearly."""
    message = wrong(kind, chance)
    if isinstance(message, Response):
        message.header.frame_id = FRAME
    if last is not None and chance.random() < 0.7:
        message.header.stamp = last.header.stamp
        if not isinstance(message, AccelStamped):
            message.run, message.sequence = last.run, last.sequence + chance.randrange(3)
        if isinstance(message, BraceCommand) and chance.random() < 0.3:
            message.fault = ""
    return message


def wrong_request(kind: type, chance: random.Random, parameters: list[str]) -> Any:
    """A request of a service `kind`; of a life cycle none that is a transition, of parameters those that there are."""
    request = wrong(kind.Request, chance)  # type: ignore[attr-defined]
    if kind is ChangeState:
        request.transition.id = chance.choice(TRANSITIONS)
    elif kind in (SetParameters, SetParametersAtomically):
        for one in request.parameters:
            one.name = chance.choice([*parameters, "nobody's"])
            one.value.type = chance.randrange(11)
    elif kind is GetParameters:
        request.names = [chance.choice([*parameters, "nobody's"]) for _ in range(3)]
    return request


def _done(asked: list[Future]) -> bool:
    """Whether all but one have been answered: a server drops its answer to a newly discovered client."""
    return sum(one.done() for one in asked) >= len(asked) - 1


class WrongMessages:
    """Sends wrong messages to the nodes of a graph, and watches what reaches the rig's device.

    Parameters
    ----------
    graph
        The graph, whose plant takes samples by the clock.
    chance
        Where the content comes from.
    """

    def __init__(self, graph: Graph, chance: random.Random) -> None:
        self.graph, self.chance = graph, chance
        self.last: Response | None = None
        self.samples = 0
        self.worst_step = self.greatest = 0.0
        """The greatest change of the acting force in a sample period, and the greatest force [N]."""
        self.worst_between = ""
        """The two samples between which the change was greatest."""
        self.not_finite = 0
        graph.node.create_subscription(Response, "response", self._watch, 5000)

    def _watch(self, response: Response) -> None:
        if response.header.frame_id == FRAME:
            return
        now = np.array(response.command)
        self.samples += 1
        self.not_finite += not np.isfinite(now).all()
        self.greatest = max(self.greatest, float(np.abs(now).max()))
        if self.last is not None and self.last.run == response.run:
            # of samples that did not reach us, each may have changed it
            periods = max(response.sequence - self.last.sequence, 1)
            step = float(np.abs(now - self.last.command).max()) / periods
            if step > self.worst_step:
                self.worst_step = step
                samples = f"{self.last.sequence} and {response.sequence}"
                forces = f"{self.last.command.tolist()} and {now.tolist()} N"
                self.worst_between = f"samples {samples}: {forces}"
        self.last = response

    def send(self, kind: type, topic: str, count: int, alternate: Callable[[], object]) -> None:
        """Send `count` messages on a topic; `alternate` is called after each hundred of them."""
        publisher = self.graph.publisher(kind, topic)
        for number in range(count):
            publisher.publish(wrong_message(kind, self.chance, self.last))
            self.graph.executor.spin_once(timeout_sec=0.0)
            if number % 100 == 99:
                alternate()
        self.graph.node.destroy_publisher(publisher)

    def services(self, node: str) -> Iterator[tuple[str, type]]:
        """Name and type of each service of a node, those of its actions as well."""
        found = self.graph.node.get_service_names_and_types_by_node(node, self.graph.namespace)
        for name, types in sorted(found):
            if "/_action/" not in name:
                yield name, _interface(types[0], "srv")
            elif name.endswith("send_goal"):
                yield name, PlayGroundMotion.Impl.SendGoalService
            elif name.endswith("cancel_goal"):
                yield name, CancelGoal

    def ask(self, name: str, kind: type, count: int, parameters: list[str]) -> None:
        """Call a service `count` times, and take all answers."""
        client = self.graph.node.create_client(kind, name)
        self.graph.until(client.service_is_ready, f"service {name}")
        while count:
            batch = min(BATCH, count)
            count -= batch
            asked = [client.call_async(wrong_request(kind, self.chance, parameters)) for _ in range(batch)]
            self.graph.until(partial(_done, asked), f"answers of {name}")
        self.graph.node.destroy_client(client)
