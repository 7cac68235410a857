# SPDX-License-Identifier: Apache-2.0
"""The Linux port of the C target as a process by its own clock, at the other end of a socket."""

import itertools
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from c_target import (
    ARMED,
    DISARMED,
    FOLLOW,
    HOLD_ZERO,
    MISSED_TICKS,
    NO_COMMANDS,
    STOPPING,
    Sample,
    command_packet,
    target_program,
)


class OverUdp:
    """The Linux port as a process, and the socket of a bridge."""

    def __init__(self, program: Path, *arguments: str) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(10)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.target = "127.0.0.1", port
        ours = str(self.socket.getsockname()[1])
        self.process = subprocess.Popen(
            [program, str(port), "127.0.0.1", ours, "channels=--1w", "capacity=1000", "rate_limit=1e5", *arguments]
        )
        self.counter = 0

    def sample(self) -> Sample:
        """The next sample."""
        return Sample(self.socket.recv(1000), 1, table_measured=False)

    def send(self, wanted: int, arm: int, force: float = 0.0) -> None:
        """Send the next command."""
        self.counter += 1
        self.socket.sendto(command_packet(self.counter, arm, wanted, [force, 0.0]), self.target)

    def until(self, state: int, wanted: int, arm: int, force: float = 0.0) -> list[Sample]:
        """The samples until the target is in this state, each answered by a command."""
        samples = [self.sample()]
        while samples[-1].state != state:
            assert len(samples) < 5000
            self.send(wanted, arm, force)
            samples.append(self.sample())
        return samples

    def armed(self) -> int:
        """The arm number with which the target is armed."""
        arm = self.sample().arm + 1
        assert self.until(ARMED, HOLD_ZERO, arm)[-1].arm == arm
        return arm


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return target_program(tmp_path_factory.mktemp("program"))


@pytest.fixture
def over_udp(program: Path) -> Iterator[OverUdp]:
    """A target whose life time is longer than this machine is ever held up."""
    udp = OverUdp(program, "life_time=0.5", "ramp_time=0.1")
    yield udp
    udp.process.kill()
    udp.process.wait()
    udp.socket.close()


SENDER = """
import socket, sys, time
from c_target import FOLLOW, command_packet
at, arm = socket.socket(fileno=int(sys.argv[1])), int(sys.argv[3])
for counter in range(10_000, 100_000):
    at.sendto(command_packet(counter, arm, FOLLOW, [800.0, 0.0]), ("127.0.0.1", int(sys.argv[2])))
    time.sleep(0.002)
"""


def test_a_sender_that_hangs_is_followed_to_zero_and_not_again(over_udp: OverUdp):
    arm = over_udp.armed()
    descriptor = over_udp.socket.fileno()
    sender = subprocess.Popen(
        [sys.executable, "-c", SENDER, str(descriptor), str(over_udp.target[1]), str(arm)], pass_fds=[descriptor]
    )
    try:
        found = over_udp.sample()
        while found.applied_counter < 10_000:
            over_udp.send(HOLD_ZERO, arm)
            found = over_udp.sample()
        samples = [found]
        while samples[-1].applied[0] != 800 or samples[-1].applied_counter == found.applied_counter:
            samples.append(over_udp.sample())  # a command after the first one has to act: `act` has a sample before it
        sender.send_signal(signal.SIGSTOP)
        while samples[-1].state != DISARMED:
            samples.append(over_udp.sample())
        last = samples[-1].applied_counter
        act = next(k for k, each in enumerate(samples) if each.applied_counter == last)
        stop = next(k for k, each in enumerate(samples) if each.state == STOPPING)
        # ticks that the target missed just before it acted or stopped count as silent ones, or as those of its ramp
        assert samples[stop].counter - samples[act - 1].counter > 250
        assert samples[stop].counter - samples[act].counter < 300
        assert samples[-1].counter - samples[stop - 1].counter > 50
        assert samples[-1].counter - samples[stop].counter < 100
        assert samples[-1].causes in (NO_COMMANDS, MISSED_TICKS)
        assert samples[stop - 1].applied[0] == 800
        forces = [each.applied[0] for each in samples[stop - 1 :]]
        assert forces == sorted(forces, reverse=True)
        assert forces[-1] == 0
        # it goes on sending, and nothing is followed
        sender.send_signal(signal.SIGCONT)
        begun = time.monotonic()
        while time.monotonic() < begun + 0.5:
            found = over_udp.sample()
            assert (found.state, found.applied) == (DISARMED, [0, 0])
        assert found.applied_counter == last
    finally:
        sender.kill()
        sender.wait()
    assert over_udp.sample().arm == arm
    over_udp.counter = 200_000
    assert over_udp.armed() == arm + 1


def test_a_target_that_hangs_stops_and_says_so(over_udp: OverUdp):
    arm = over_udp.armed()
    for _ in range(20):
        over_udp.send(FOLLOW, arm, 500.0)
        over_udp.sample()
    over_udp.process.send_signal(signal.SIGSTOP)
    time.sleep(0.7)
    over_udp.process.send_signal(signal.SIGCONT)
    samples = over_udp.until(DISARMED, FOLLOW, arm, 500.0)
    assert samples[-1].causes & MISSED_TICKS
    assert samples[-1].applied == [0, 0]
    numbers = [(each.counter, each.time) for each in samples]
    assert all(
        later[1] - sooner[1] == 2_000_000 * (later[0] - sooner[0]) for sooner, later in itertools.pairwise(numbers)
    )


def test_sigterm_ramps_the_force_before_the_program_ends(over_udp: OverUdp):
    arm = over_udp.armed()
    while over_udp.sample().applied[0] != 500:
        over_udp.send(FOLLOW, arm, 500.0)
    over_udp.process.terminate()
    samples = over_udp.until(DISARMED, FOLLOW, arm, 500.0)
    forces = [each.applied[0] for each in samples]
    assert max(sooner - later for sooner, later in itertools.pairwise(forces)) < 200
    assert samples[-1].causes == 1 << 16
    assert over_udp.process.wait(5) == 0


def test_the_program_takes_packets_from_abrace_alone(over_udp: OverUdp):
    arm = over_udp.sample().arm + 1
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        for counter in range(50):
            other.sendto(command_packet(counter, arm, HOLD_ZERO, [0.0, 0.0]), over_udp.target)
            assert over_udp.sample().state == DISARMED
