# SPDX-License-Identifier: Apache-2.0
"""Messages whose types are right and whose content is wrong, for every topic and service of the nodes of a graph.

NaN, infinities, huge, empty and long; stamps, runs and sequences from elsewhere; parameters of wrong kinds; diagnostics
of real nodes with wrong values. Topics and services are those that the graph has.
"""

from __future__ import annotations

import copy
import importlib
import math
import re
import time
from collections import Counter
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import AccelStamped
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.experimental import EventsExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from std_msgs.msg import Bool

from abrace_core.safety.rig_safety import ACTING
from abrace_interfaces.msg import BraceCommand, Response
from abrace_node.transport import profile

if TYPE_CHECKING:
    import random
    from collections.abc import Callable, Mapping, Sequence

    from rclpy.client import Client
    from running_graph import Graph

FRAME = "elsewhere"
"""Frame of the wrong Responses and DiagnosticArrays, which distinguishes them from the nodes' own."""
NUMBERS = (float("nan"), float("inf"), float("-inf"), 1.7e308, -1.7e308, 5e-324, 1e9, -1e9, 0.0, 1.0)
FINITE = tuple(number for number in NUMBERS if math.isfinite(number))
TEXTS = ("", "x", "x" * 5000, "\n", "../../..", "el_centro ", "nan", "ä", "²", "-1", "1e999", "9" * 5000)
LENGTHS = (0, 0, 1, 1, 2, 3, 3, 5) * 3 + (300,)
MOST_MESSAGES = 5
"""Messages in a sequence of messages."""
TRANSITIONS = (0, 8, 9, 10, 11, 60, 97, 98, 99, 200, 255)
"""Numbers of transitions that do not exist or may not be requested: a node that is shut down as it should be ends."""
OFFERED = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Of the publishers: every subscription is matched."""
AT_ONCE = 8
"""Calls of a service in progress; a service queues ten."""
SLOW = "/zero_sensors"
"""A service that takes a second while the rig is at rest, and is called once at a time: all others of its node wait."""
GROUP, PAUSE = 5, 0.004
"""Messages that are published in a row, and seconds after them: subscriptions keep ten."""
HELD = 0.1
"""Probability with which the next answer has another value."""
TURN = 100
"""Messages after which the rig is made to act again."""
TURN_PERIOD = 2.0
"""Seconds after which it is, while services are called."""
AGAIN = 3.0
"""Seconds after which a first call is repeated: a server drops its answer to a client that it has not discovered."""
LOST = 10.0
"""Seconds after which unanswered calls are repeated."""
PATIENCE = 60.0
"""Seconds without any answer of a service that has been called."""


@cache
def interface(name: str, folder: str) -> type:
    """The class of a message or service of this name, such as std_msgs/Header or std_srvs/srv/Trigger."""
    package, *_, kind = name.split("/")
    kind, _, part = kind.partition("_")
    found: Any = getattr(importlib.import_module(f"{package}.{'action' if part else folder}"), kind)
    if not part:
        return found  # type: ignore[no-any-return]
    return getattr(found.Impl, f"{part}Service") if folder == "srv" else getattr(found, part)  # type: ignore[no-any-return]


@cache
def _maker(kind: str) -> Callable[[random.Random], Any]:
    """What makes a wrong value of a field of this `kind`, as rclpy calls it: sequence<double>, uint8[16], string."""
    if match := re.fullmatch(r"sequence<(.+?)(?:, (\d+))?>", kind):
        make, most = _maker(match[1]), int(match[2] or (MOST_MESSAGES if "/" in match[1] else max(LENGTHS)))
        return lambda chance: [make(chance) for _ in range(min(chance.choice(LENGTHS), most))]
    if match := re.fullmatch(r"(.+)\[(\d+)\]", kind):
        make, count = _maker(match[1]), int(match[2])
        return lambda chance: [make(chance) for _ in range(count)]
    if match := re.fullmatch(r"(u?)int(\d+)", kind):
        bits = int(match[2])
        lowest, highest = (0, 2**bits - 1) if match[1] else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        return lambda chance: chance.choice((lowest, highest, 0, 1, chance.randint(lowest, highest)))
    if kind == "double":
        return lambda chance: chance.choice(NUMBERS)
    if kind == "float":
        return lambda chance: chance.choice(NUMBERS[:3])
    if kind == "boolean":
        return lambda chance: chance.random() < 0.5
    if kind == "octet":
        return lambda chance: bytes([chance.randrange(256)])
    if kind.startswith("string"):
        return lambda chance: chance.choice(TEXTS)
    return partial(wrong, interface(kind, "msg"))


@cache
def _fields(kind: type) -> list[tuple[str, Callable[[random.Random], Any]]]:
    fields = kind.get_fields_and_field_types()  # type: ignore[attr-defined]
    return [(name, _maker(field)) for name, field in fields.items()]


def wrong(kind: type, chance: random.Random) -> Any:
    """A message or a request of a `kind` with meaningless fields."""
    message = kind()
    for name, make in _fields(kind):
        setattr(message, name, make(chance))
    return message


def wrong_message(kind: type, chance: random.Random, last: Response | None) -> Any:
    """A message of the loop: also one whose run, sequence or stamp are those of the rig's `last` sample, or nearly."""
    message = wrong(kind, chance)
    if isinstance(message, Response):
        message.header.frame_id = FRAME
    if last is not None and kind in (Response, BraceCommand, AccelStamped) and chance.random() < 0.7:
        message.header.stamp = last.header.stamp
        if not isinstance(message, AccelStamped):
            message.run, message.sequence = last.run, last.sequence + chance.randrange(3)
        if isinstance(message, BraceCommand) and chance.random() < 0.3:
            message.fault = ""
    return message


def wrong_diagnostics(chance: random.Random, reported: Sequence[DiagnosticStatus]) -> DiagnosticArray:
    """Diagnostics in the names of those who have `reported`, with some of the values, messages and levels wrong."""
    array = wrong(DiagnosticArray, chance)
    array.header.frame_id = FRAME
    for status in chance.choices(reported, k=2):
        spoiled = copy.deepcopy(status)
        for entry in spoiled.values:
            if chance.random() < 0.5:
                entry.value = chance.choice(TEXTS)
        if chance.random() < 0.5:
            spoiled.message = chance.choice(TEXTS)
        if chance.random() < 0.5:
            spoiled.level = bytes([chance.randrange(256)])
        array.status.append(spoiled)
    return array


def wrong_request(kind: type, chance: random.Random, parameters: list[str]) -> Any:
    """A request of a service `kind`; of a life cycle none that is a transition, of parameters those that there are."""
    request = wrong(kind.Request, chance)  # type: ignore[attr-defined]
    if kind is ChangeState:
        request.transition.id = chance.choice(TRANSITIONS)
    elif kind in (SetParameters, SetParametersAtomically):
        for one in request.parameters:
            one.name = chance.choice([*parameters, "nobody's"])
            one.value.type = chance.randrange(11)
    elif kind in (GetParameters, GetParameterTypes, DescribeParameters):
        request.names = [chance.choice([*parameters, "nobody's"]) for _ in range(3)]
    return request


class _Calls:
    """A service that is called again with each answer, `count` times in all, with `at_once` calls in progress.

    `also` is called after each answer.
    """

    def __init__(
        self, client: Client, make: Callable[[], Any], count: int, at_once: int, also: Callable[[], object]
    ) -> None:
        self._client, self._make, self._left, self._also = client, make, count, also
        self._at_once = at_once
        self._open: set[Future] = set()
        self.answered = self.repeated = 0
        self.last = self.asked = time.monotonic()
        self._begin()

    def _begin(self) -> None:
        for _ in range(self._at_once):
            self._call()

    def repeat(self) -> None:
        """Make the calls in progress again: whose service was cleaned up and configured has lost them."""
        self.repeated += len(self._open)
        self._left += len(self._open)
        self._open.clear()
        self.asked = time.monotonic()
        self._begin()

    def _call(self) -> None:
        if self._left:
            self._left -= 1
            future = self._client.call_async(self._make())
            self._open.add(future)
            future.add_done_callback(self._take)

    def _take(self, future: Future) -> None:
        self.last = self.asked = time.monotonic()
        if future in self._open:
            self._open.remove(future)
            self.answered += 1
            self._call()
        self._also()


class WrongMessages:
    """Sends wrong messages to all nodes of a graph, and watches what acts on its rig.

    Parameters
    ----------
    graph
        The graph, alone on its domain, whose rig takes samples by the clock.
    chance
        Where the content comes from.
    """

    def __init__(self, graph: Graph, chance: random.Random) -> None:
        self.graph, self.chance = graph, chance
        context = graph.node.context
        with profile(streams=False):
            self.node = rclpy.create_node("wrong", namespace=graph.namespace, context=context)
        self.executor = EventsExecutor(context=context)
        self.executor.add_node(self.node)
        self._rig = self.node.resolve_topic_name("response")
        self.last: dict[str, Response] = {}
        """The last sample on each topic of samples."""
        self._over, self._end = Future(), 0.0
        self._respond: Callable[[Response], object] = lambda _: None
        self._clients: dict[str, Client] = {}
        self.reported: dict[str, DiagnosticStatus] = {}
        """What each node has reported last."""
        self.samples = self.acting = self.faults = 0
        """Samples of the rig, those with a force, and times that it was stopped."""
        self.worst_step = self.greatest = 0.0
        """The greatest change of the acting force in a sample period, and the greatest force [N]."""
        self.worst_between = ""
        """The two samples between which the change was greatest."""
        self.not_finite = 0
        self.topics: Counter[str] = Counter()
        """Topics to which messages have been sent, and how many."""
        self.services: Counter[str] = Counter()
        """Services that have been called, and how many times."""
        self.repeated = 0
        """Calls that were lost, because the node was cleaned up meanwhile, and made again."""
        self.node.create_subscription(Response, "response", self._watch, 5000)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._note, 100)

    def close(self) -> None:
        """Leave the graph."""
        self.executor.shutdown()
        self.node.destroy_node()

    def _watch(self, response: Response) -> None:
        if response.header.frame_id == FRAME:
            return
        last = self.last.get(self._rig)
        now = np.array(response.command)
        self.samples += 1
        self.acting += bool(now.any())
        self.not_finite += not np.isfinite(now).all()
        self.greatest = max(self.greatest, float(np.abs(now).max()))
        self.faults += last is not None and last.state in ACTING and response.state == Response.RAMPING_DOWN
        if last is not None and last.run == response.run:
            # of samples that did not reach us, each may have changed it
            periods = max(response.sequence - last.sequence, 1)
            step = float(np.abs(now - last.command).max()) / periods
            if step > self.worst_step:
                self.worst_step = step
                forces = f"{last.command.tolist()} and {now.tolist()} N"
                self.worst_between = f"samples {last.sequence} and {response.sequence}: {forces}"
        self.last[self._rig] = response
        self._respond(response)
        self._stop_late()

    @property
    def rig(self) -> Response:
        """The last sample of the rig, once there has been one."""
        return self.last[self._rig]

    def listen(self, topic: str) -> None:
        """Take the samples on another `topic` as well: commands on the one beside it answer them."""

        def note(response: Response) -> None:
            if response.header.frame_id != FRAME:
                self.last[topic] = response
            self._stop_late()

        self.node.create_subscription(Response, topic, note, 100)

    def _note(self, array: DiagnosticArray) -> None:
        if array.header.frame_id != FRAME:
            self.reported.update((status.name, status) for status in array.status)
        self._stop_late()

    def spin(self, seconds: float) -> None:
        """Receive for so long; fail where a node has died."""
        self._over, self._end = Future(), time.monotonic() + seconds
        self.executor.spin_until_future_complete(self._over, seconds)
        for process in self.graph.started.values():
            if process.returncode is not None:
                raise process.died()

    def _stop_late(self) -> None:
        """End a spin that should be over: an executor that is never idle does not look at the time."""
        if time.monotonic() > self._end:
            self._over.set_result(None)

    def until(self, holds: Callable[[], Any], what: str) -> None:
        """Receive until something holds."""
        deadline = time.monotonic() + PATIENCE
        while not holds():
            assert time.monotonic() < deadline, f"waited {PATIENCE:.0f} s for {what}; {self.graph.reported()}"
            self.spin(0.02)

    def call(self, kind: type, service: str, request: Any) -> Any:
        """Call a `service` of the namespace, again while there is no answer, and receive; returns the answer."""
        if service not in self._clients:
            self._clients[service] = self.node.create_client(kind, service)
            self.until(self._clients[service].service_is_ready, f"service {service}")
        return self._first_answers(self._clients, {service: lambda: request})[service]

    def nodes(self) -> list[tuple[str, str]]:
        """Name and namespace of every node but our own."""
        own = {(one.get_name(), one.get_namespace()) for one in (self.node, self.graph.node)}
        return sorted(set(self.node.get_node_names_and_namespaces()) - own)

    def find_topics(self) -> dict[str, type]:
        """Every topic to which a node has subscribed, and its type."""
        found = [self.node.get_subscriber_names_and_types_by_node(*node) for node in self.nodes()]
        return {name: interface(types[0], "msg") for one in found for name, types in sorted(one)}

    def find_services(self, wanted: Callable[[str], bool]) -> dict[str, type]:
        """Every service that a node of a `wanted` name offers, those of actions as well, and its type."""
        hidden = "_"  # nodes that are only inputs, and answer nothing
        nodes = [node for node in self.nodes() if wanted(node[0]) and not node[0].startswith(hidden)]
        found = [self.node.get_service_names_and_types_by_node(*node) for node in nodes]
        return {name: interface(types[0], "srv") for one in found for name, types in sorted(one)}

    def send(self, count: int, alternate: Callable[[], object], tell: Callable[[float, str], object]) -> None:
        """Send `count` messages on every topic; `alternate` is called after every TURN of them.

        `tell` is called with the share that is done and with words.
        """
        self.until(lambda: self.reported, "diagnostics, from which wrong ones are made")
        topics = self.find_topics()
        publishers = {name: self.node.create_publisher(kind, name, OFFERED) for name, kind in topics.items()}
        for name, publisher in publishers.items():
            self.until(
                lambda name=name, publisher=publisher: (  # type: ignore[misc]
                    publisher.get_subscription_count() >= self.node.count_subscribers(name)
                ),
                f"subscribers of {name}",
            )
        for place, (name, publisher) in enumerate(publishers.items()):
            for number in range(1, count + 1):
                message = self._message(name, topics[name])
                if (number % TURN == 0 or number == count) and isinstance(message, Bool):
                    message.data = False  # a stop is released before the fault is cleared
                publisher.publish(message)
                self.topics[name] += 1
                if number % GROUP == 0:
                    self.spin(PAUSE)
                if number % TURN == 0:
                    tell((place + number / count) / len(topics), name)
                    alternate()
            alternate()
        for publisher in publishers.values():
            self.node.destroy_publisher(publisher)

    def answer(self, count: int, alternate: Callable[[], object], tell: Callable[[float, str], object]) -> None:
        """Answer `count` samples in which the rig acts, as its only sender: in right form, with any finite values.

        `alternate` and `tell` as of `send`.
        """
        topics = (BraceCommand, "brace_command"), (AccelStamped, "ground_motion")
        command, motion = (self.node.create_publisher(*topic, OFFERED) for topic in topics)
        self.until(lambda: command.get_subscription_count() and motion.get_subscription_count(), "the rig")
        left, last, values = count, time.monotonic(), [0.0, 0.0]

        def respond(response: Response) -> None:
            nonlocal left, last, values
            acting = response.state in ACTING
            if self.chance.random() < HELD:
                values = self.chance.choices(FINITE, k=2)
            force, acceleration = values if acting else (0.0, 0.0)
            run, sequence = response.run, response.sequence
            command.publish(BraceCommand(run=run, sequence=sequence, force=[force] * len(response.command)))
            message = AccelStamped(header=response.header)
            message.accel.linear.x = acceleration
            motion.publish(message)
            if acting:
                left, last = left - 1, time.monotonic()

        self._respond = respond
        while left > 0:
            self.spin(0.1)
            assert time.monotonic() < last + PATIENCE, f"the rig does not act; {self.graph.reported()}"
            tell(1 - max(left, 0) / count, f"{self.faults} faults")
            alternate()
        self._respond = lambda _: None
        for publisher in (command, motion):
            self.node.destroy_publisher(publisher)

    def _message(self, name: str, kind: type) -> Any:
        if kind is DiagnosticArray:
            return wrong_diagnostics(self.chance, list(self.reported.values()))
        return wrong_message(kind, self.chance, self.last.get(f"{name.rpartition('/')[0]}/response"))

    def ask(
        self,
        wanted: Callable[[str], bool],
        count: int,
        alternate: Callable[[], object],
        tell: Callable[[float, str], object],
    ) -> None:
        """Call every service of nodes of `wanted` names `count` times; `alternate` and `tell` as of `send`."""
        services = self.find_services(wanted)
        clients = {name: self.node.create_client(kind, name) for name, kind in services.items()}
        self.until(lambda: all(client.service_is_ready() for client in clients.values()), "all services")
        lists = {name: ListParameters.Request for name in services if name.endswith("/list_parameters")}
        listed = self._first_answers(clients, lists)
        parameters = {name.rpartition("/")[0]: list(answer.result.names) for name, answer in listed.items()}
        requests = {
            name: partial(wrong_request, kind, self.chance, parameters.get(name.rpartition("/")[0], []))
            for name, kind in services.items()
        }
        self._first_answers(clients, requests)
        calls = {
            name: _Calls(client, requests[name], count - 1, 1 if name.endswith(SLOW) else AT_ONCE, self._stop_late)
            for name, client in clients.items()
        }
        turn = time.monotonic() + TURN_PERIOD
        while left := [name for name, one in calls.items() if one.answered < count - 1]:
            self.spin(0.1)
            now = time.monotonic()
            silent = [name for name in left if now - calls[name].last > PATIENCE]
            assert not silent, f"no answer for {PATIENCE:.0f} s of {', '.join(silent)}; {self.graph.reported()}"
            for name in left:
                if now - calls[name].asked > LOST:
                    calls[name].repeat()
            if now > turn:
                answered = sum(one.answered for one in calls.values())
                tell(answered / (count * len(calls)), f"{len(left)} of {len(calls)} services")
                alternate()
                turn = time.monotonic() + TURN_PERIOD
        self.services.update(dict.fromkeys(services, count))
        self.repeated += sum(one.repeated for one in calls.values())
        for client in clients.values():
            self.node.destroy_client(client)

    def _first_answers(
        self, clients: Mapping[str, Client], requests: Mapping[str, Callable[[], Any]]
    ) -> dict[str, Any]:
        """Make these `requests`, again and again, until each has been answered; returns the answers."""
        answers: dict[str, Any] = {}

        def take(name: str, future: Future) -> None:
            answers[name] = future.result()

        deadline = time.monotonic() + PATIENCE
        while missing := requests.keys() - answers.keys():
            assert time.monotonic() < deadline, f"no answer of {', '.join(sorted(missing))}; {self.graph.reported()}"
            for name in missing:
                clients[name].call_async(requests[name]()).add_done_callback(partial(take, name))
            again = time.monotonic() + AGAIN
            while time.monotonic() < again and requests.keys() - answers.keys():
                self.spin(0.02)
        return answers
