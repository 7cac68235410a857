# SPDX-License-Identifier: Apache-2.0
"""The logger under load: three topics on a machine with a loaded core, floods, `kill -9` and power losses.

For `make verify` and `make soak`, and in a short form for `make test`. Run as a program it is the bare subscription
with which floods are compared: it counts messages and writes nothing.
"""

from __future__ import annotations

import contextlib
import os
import random
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import AccelStamped
from isolation import own_shared_memory
from power_loss import Disk, Recorder
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions

from abrace_bags import Bag
from abrace_core import AbraceError
from abrace_core.safety import wire
from abrace_interfaces.msg import BraceCommand, Response
from abrace_node.node import DIAGNOSTICS
from abrace_node.transport import KEPT_STREAM_QOS

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from abrace_core.files.progress import Step

RATE = 500.0
PATIENCE = 60.0
NUMBERED = {"response": "sequence", "brace_command": "sequence", "ground_motion": "accel.linear.x"}
"""Topics, and the field that counts their messages."""
FLOOD_GROWTH = 1.25
LOGGER = [sys.executable, "-m", "abrace_bags.nodes.logger"]
LOAD = [sys.executable, "-c", "while True: pass"]
BARE = [sys.executable, str(Path(__file__).resolve())]


class Publishers:
    """Three topics of a rig, whose messages are numbered from 0."""

    def __init__(self, namespace: str) -> None:
        self.namespace = namespace
        self.context = rclpy.Context()
        self.context.init()
        self.node = rclpy.create_node("publishers", namespace=namespace, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.matched: dict[str, str] = {}
        self.node.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, 10)
        x = [0.1, 0.2, 0.3]
        response = Response(braces=[1], displacement=x, acceleration=x, stroke=x[:1], force=x[:1], command=x[:1])
        messages = {"response": response, "brace_command": BraceCommand(force=x[:1]), "ground_motion": AccelStamped()}
        self.topics = {}
        self.publishers = {}
        for topic, message in messages.items():
            publisher = self.node.create_publisher(type(message), topic, KEPT_STREAM_QOS)
            self.publishers[topic] = publisher
            payload = bytearray(serialize_message(message))
            number = struct.Struct("<d" if topic == "ground_motion" else "<Q")
            self.topics[topic] = (publisher.publish, payload, number, wire.read_header(bytes(payload)).offset)
        self.count = 0

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.startswith(f"{self.namespace[1:]}/"):
                self.matched.update((entry.key, entry.value) for entry in status.values)

    def wait_for_match(self, topics: Sequence[str]) -> None:
        """Wait until subscriber and publishers are matched, as both report."""
        deadline = time.monotonic() + PATIENCE
        while not all(
            self.matched.get(f"publishers of {topic}") == "1" and self.publishers[topic].get_subscription_count() == 1
            for topic in topics
        ):
            if time.monotonic() > deadline:
                raise AbraceError(f"no subscriber within {PATIENCE:g} s, it reported {self.matched}")
            self.executor.spin_once(timeout_sec=0.02)

    def publish(self, rate: float, duration: float, topics: Sequence[str]) -> float:
        """Publish at a rate [Hz] for a time [s], each message at its due time; returns the rate reached."""
        chosen = [self.topics[topic] for topic in topics]
        begin = time.monotonic()
        for k in range(round(rate * duration)):
            wait = begin + k / rate - time.monotonic()
            # sleeps are late by some 0.1 ms: in a flood, messages come in small bursts
            if wait > 0.0:
                time.sleep(wait)
            for send, payload, number, offset in chosen:
                number.pack_into(payload, offset, self.count)
                send(bytes(payload))
            self.count += 1
        return round(rate * duration) / (time.monotonic() - begin)

    def wait_for_receipt(self) -> None:
        """Wait until the subscriber's middleware has acknowledged all messages; lost ones are sent again."""
        for topic, publisher in self.publishers.items():
            if not publisher.wait_for_all_acked(Duration(seconds=PATIENCE)):
                raise AbraceError(f"{topic} was not received whole within {PATIENCE:g} s")

    def close(self) -> None:
        """Leave the graph."""
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()


@contextlib.contextmanager
def publishers() -> Iterator[tuple[Publishers, Path]]:
    """Publishers in a namespace of their own, and a folder for bags."""
    with tempfile.TemporaryDirectory() as folder:
        found = Publishers(f"/endurance_{os.getpid()}_{time.monotonic_ns()}")
        rclpy.signals.install_signal_handlers(SignalHandlerOptions.NO)
        try:
            yield found, Path(folder)
        finally:
            found.close()


@contextlib.contextmanager
def running(
    command: Sequence[str], log: Path, environment: dict[str, str] | None = None
) -> Iterator[subprocess.Popen[bytes]]:
    """A process, in this environment or another, that is killed at the end if it still runs."""
    with log.open("wb") as output:
        process = subprocess.Popen(
            command, stdout=output, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, env=environment
        )
        try:
            yield process
        finally:
            process.kill()
            process.wait()


def logger_command(namespace: str, bag: Path, topics: Sequence[str], *parameters: str) -> list[str]:
    """A logger of these topics, with further `parameters`, each as name:=value."""
    given = [f"output:={bag}", f"topics:=[{', '.join(topics)}]", *parameters]
    return [*LOGGER, "--ros-args", "-r", f"__ns:={namespace}", *(word for one in given for word in ("-p", one))]


def stop(process: subprocess.Popen[bytes], log: Path) -> str:
    """End a process by SIGINT; returns its output."""
    process.send_signal(signal.SIGINT)
    code = process.wait(PATIENCE)
    output = log.read_text(errors="replace")
    if code:
        raise AbraceError(f"{process.args!r} ended with {code}: {output}")
    return output


def cpu_seconds(process: int) -> float:
    """Processor time that a process, by its number, has used [s]."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def recorded(bag: Path, namespace: str) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """(numbers, times of arrival [ns]) of each topic in a bag."""
    found = Bag(bag).arrays()
    return {
        topic: (found[f"{namespace}/{topic}"].fields[field].astype(int), found[f"{namespace}/{topic}"].log_time)
        for topic, field in NUMBERED.items()
        if f"{namespace}/{topic}" in found
    }


def kills(count: int, seed: int = 1, shown: Step | None = None) -> dict[str, Any]:
    """Kill loggers, each at a random moment of its first two seconds of messages.

    `missing`: messages that a bag lacks before its end. `worst_gap_seconds`: from a bag's last message to the kill.
    """
    moments = random.Random(seed)
    opened = missing = 0
    worst = 0.0
    for k in range(count):
        if shown is not None:
            shown.update(k / count)
        with publishers() as (rig, folder):
            bag = folder / "bag"
            with running(logger_command(rig.namespace, bag, list(NUMBERED)), folder / "log") as process:
                rig.wait_for_match(list(NUMBERED))
                rig.publish(RATE, moments.uniform(0.3, 2.0), list(NUMBERED))
                left = own_shared_memory(process.pid)
                killed = time.time_ns()
                process.kill()
                process.wait()
            for file in left:
                file.unlink(missing_ok=True)
            try:
                found = recorded(bag, rig.namespace)
            except AbraceError as error:
                print(f"kill {k}: {error}", file=sys.stderr)
                continue
        opened += 1
        for topic in NUMBERED:
            numbers, times = found.get(topic, (np.zeros(0, int), np.zeros(0, int)))
            missing += int(numbers[-1]) + 1 - numbers.size if numbers.size else 0
            worst = max(worst, (killed - int(times[-1])) * 1e-9 if numbers.size else float("inf"))
    return {"kills": count, "opened": opened, "missing": missing, "worst_gap_seconds": worst}


def power_losses(
    count: int, loggers: int = 5, duration: float = 6.0, seed: int = 1, shown: Step | None = None
) -> dict[str, Any]:
    """Simulate power losses at random moments: while a logger records, splits its bag and closes it, or just after.

    Each moment is tried twice: all unsynced data are lost, or each unsynced write at random. `opened`: number of
    moments after which both bags can be read. `worst_missing_seconds`: from the first missing message of a bag to that
    moment, or to the last message.
    """
    chance = random.Random(seed)
    opened, worst = 0, 0.0
    for k in range(loggers):
        with publishers() as (rig, folder):
            disk = folder.resolve() / "disk"
            disk.mkdir()
            recorder = Recorder(disk, folder)
            command = logger_command(rig.namespace, disk / "bag", list(NUMBERED), f"split_duration:={duration / 3}")
            with running(command, folder / "log", recorder.environment) as process:
                rig.wait_for_match(list(NUMBERED))
                begin = time.time_ns()
                rig.publish(RATE, duration, list(NUMBERED))
                published = time.time_ns()
                rig.wait_for_receipt()
                stop(process, folder / "log")
            events = recorder.events()
            for number in range(k, count, loggers):
                if shown is not None:
                    shown.update((k + number / count) / loggers)
                lost = chance.uniform(begin, time.time_ns() if number == k else published)
                after = Disk(disk, [event for event in events if event.time <= lost])
                try:
                    for way in (None, chance):
                        left = folder / f"left_{number}_{way is None}"
                        after.write(left, way)
                        first = first_missing(left / "bag", rig.namespace, begin)
                        worst = max(worst, (min(lost, published) - first) * 1e-9)
                except AbraceError as error:
                    print(f"power loss {number}: {error}", file=sys.stderr)
                    continue
                opened += 1
    return {"runs": count, "opened": opened, "worst_missing_seconds": worst}


def first_missing(bag: Path, namespace: str, begin: int) -> int:
    """Arrival [ns] of the last message before the first missing one, of the topic in which that is earliest."""
    found = recorded(bag, namespace)
    last = []
    for topic in NUMBERED:
        numbers, times = found.get(topic, (np.zeros(0, int), np.zeros(0, int)))
        whole = int(np.flatnonzero(np.append(numbers, -1) != np.arange(numbers.size + 1))[0])
        last.append(int(times[whole - 1]) if whole else begin)
    return min(last)


def record_steadily(duration: float) -> dict[str, Any]:
    """Three topics at 500 Hz for some seconds while another process loads a core: numbers of messages and losses.

    The logger is stopped once its middleware has received the last message.
    """
    topics = list(NUMBERED)
    with publishers() as (rig, folder):
        bag, log = folder / "bag", folder / "logger.log"
        with (
            running(LOAD, folder / "load.log"),
            running(logger_command(rig.namespace, bag, topics), log) as process,
        ):
            rig.wait_for_match(topics)
            rig.publish(RATE, duration, topics)
            rig.wait_for_receipt()
            stop(process, log)
        found = recorded(bag, rig.namespace)
        messages = rig.count * len(topics)
        whole = sum(np.unique(numbers).size for numbers, _ in found.values())
    return {"messages": messages, "lost": messages - whole}


def flood_rate(bare: bool, duration: float, first: float, highest: float) -> tuple[float, bool]:
    """The highest rate [Hz] of `Response` messages without loss, and whether a higher rate was tried and lost some."""
    best, rate = 0.0, first
    while rate <= highest:
        with publishers() as (rig, folder):
            bag, log = folder / "bag", folder / "log"
            command = [*BARE, rig.namespace] if bare else logger_command(rig.namespace, bag, ["response"])
            with running(command, log) as process:
                rig.wait_for_match(["response"])
                reached = rig.publish(rate, duration, ["response"])
                rig.wait_for_receipt()
                output = stop(process, log)
            count = (
                int(output.splitlines()[-1]) if bare else np.unique(recorded(bag, rig.namespace)["response"][0]).size
            )
        if count < rig.count:
            return best, True
        best = max(best, reached)
        if reached < 0.9 * rate:
            break
        rate *= FLOOD_GROWTH
    return best, False


def flood_rates(duration: float = 5.0, first: float = 5000.0, highest: float = 200000.0) -> dict[str, Any]:
    """The highest rates without loss of the logger and of a bare subscription; whether higher rates lost some."""
    ours, ours_lost = flood_rate(False, duration, first, highest)
    bare, bare_lost = flood_rate(True, duration, first, highest)
    return {
        "flood_rate": ours,
        "flood_lost_above": ours_lost,
        "bare_subscription_rate": bare,
        "bare_lost_above": bare_lost,
    }


def bare_subscription(namespace: str) -> None:
    """A raw subscription that only counts; reports on diagnostics when it is matched, prints its count on SIGINT."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("bare", namespace=namespace)
    count = 0

    def on_response(_: bytes) -> None:
        nonlocal count
        count += 1

    subscription = node.create_subscription(Response, "response", on_response, KEPT_STREAM_QOS, raw=True)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    diagnostics = node.create_publisher(DiagnosticArray, DIAGNOSTICS, 10)
    published = time.monotonic()
    stopped = threading.Event()
    # an exception could come between receiving a message and counting it
    signal.signal(signal.SIGINT, lambda *_: stopped.set())
    while not stopped.is_set():
        executor.spin_once(timeout_sec=0.1)
        if time.monotonic() > published + 0.5:
            published = time.monotonic()
            entry = KeyValue(key="publishers of response", value=str(subscription.get_publisher_count()))
            diagnostics.publish(
                DiagnosticArray(status=[DiagnosticStatus(name=f"{namespace[1:]}/bare: state", values=[entry])])
            )
    waiting = -1
    while waiting != count:
        waiting = count
        executor.spin_once(timeout_sec=0.2)
    print(count, flush=True)


if __name__ == "__main__":
    bare_subscription(sys.argv[1])
