"""What the plant makes of commands that are wrong: a latched fault, and a force that goes smoothly to zero."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

PUSH = 20e3
CAPACITY = 24516.625
RATE_STEP = 5.0e6 / 500
RAMP_SAMPLES = 250
NOISE = 16.0


class Bench:
    """A rig in lockstep with the hand of the test at its braces."""

    def __init__(self, graph: Any, commander: Any) -> None:
        self.graph = graph
        self.hand = commander

    def push(self) -> int:
        """Bring the braces to PUSH; returns the number of samples taken so far."""
        self.hand.hold(PUSH, 20)
        assert self.hand.commands[-1] == PUSH
        return len(self.hand.responses)

    def expect_smooth_end(self, first: int) -> None:
        """Go on pushing; from sample `first` on the force has to go smoothly to zero and stay there."""
        self.hand.hold(PUSH, first + RAMP_SAMPLES + 50 - len(self.hand.responses))
        command, force = self.hand.commands[first - 1 :], self.hand.forces[first - 1 :]
        assert command[0] == PUSH
        assert np.diff(command).max() <= 0, "the command only falls"
        assert -np.diff(command).min() < PUSH * math.pi / 2 / RAMP_SAMPLES * 1.01, "along a half cosine"
        assert not command[RAMP_SAMPLES + 2 :].any(), "zero within 0.5 s, whatever is commanded"
        assert np.abs(np.diff(force)).max() < RATE_STEP + 10 * NOISE, "no step above the rate limit"
        assert np.abs(force[-20:]).max() < 0.1 * PUSH, "what is left is the building moving the actuator"

    def expect_latched_until_cleared(self, reason: str) -> None:
        """The fault is reported, stays, and goes by clear_fault alone; then a new command acts."""
        self.graph.until_fault("plant", reason)
        self.hand.hold(PUSH, 20)
        assert not self.hand.commands[-20:].any()
        answers = []

        def cleared() -> bool:
            answers.append(self.graph.clear_fault("plant"))
            return answers[-1].success

        self.graph.until(cleared, "the fault to be cleared")
        assert reason in answers[-1].message
        self.hand.hold(3000.0, 5)
        assert self.hand.commands[-1] == 3000.0


@pytest.fixture(scope="module")
def rig(new_graph: Callable, new_commander: Callable) -> Iterator[Bench]:
    """One plant in lockstep for all of these tests."""
    with new_graph() as graph:
        graph.start("plant", lockstep=True, lockstep_timeout=60.0)
        yield Bench(graph, new_commander(graph))


@pytest.fixture
def bench(rig: Bench) -> Bench:
    """The plant without a fault and without force."""
    rig.graph.clear_fault("plant")
    rig.hand.hold(0.0, 50)
    assert not rig.hand.commands[-10:].any()
    return rig


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_command_that_is_not_finite_takes_the_force_smoothly_to_zero(bench, bad):
    first = bench.push()
    bench.hand.answer([bad])
    bench.expect_smooth_end(first + 1)
    bench.expect_latched_until_cleared("expected finite numbers")


@pytest.mark.parametrize("bad", [[], [PUSH, PUSH]])
def test_a_command_of_the_wrong_length_takes_the_force_smoothly_to_zero(bench, bad):
    first = bench.push()
    bench.hand.answer(bad)
    bench.expect_smooth_end(first + 1)
    bench.expect_latched_until_cleared("expected (1,)")


def test_two_answers_to_one_sample_take_the_force_smoothly_to_zero(bench):
    first = bench.push()
    bench.hand.send([PUSH])
    bench.hand.send([-PUSH])
    bench.graph.until(lambda: len(bench.hand.responses) > first, "the next sample")
    bench.expect_smooth_end(first + 2)
    bench.expect_latched_until_cleared("two messages on brace_command")


def test_the_emergency_stop_takes_the_force_smoothly_to_zero(bench):
    bench.push()
    press = bench.graph.emergency_stop()
    press(True)
    bench.graph.until(lambda: bench.hand.hold(PUSH, 1) or bench.hand.commands[-1] < PUSH, "the force to fall")
    bench.expect_smooth_end(len(bench.hand.responses) - 1)
    answer = bench.graph.clear_fault("plant")
    assert (answer.success, answer.message) == (False, "emergency stop is still pressed")
    press(False)
    bench.expect_latched_until_cleared("emergency stop")


def test_a_command_above_the_capacity_is_cut_to_it(bench):
    before = int(bench.graph.values("plant").get("saturations", 0))
    bench.hand.hold(1e6, 10)
    bench.hand.hold(-1e6, 10)
    bench.hand.hold(0.0, 10)
    commands, forces = bench.hand.commands[-32:], bench.hand.forces[-32:]
    assert (commands.max(), commands.min()) == (CAPACITY, -CAPACITY)
    assert np.abs(np.diff(commands)).max() <= RATE_STEP * (1 + 1e-12)
    assert np.abs(forces).max() < CAPACITY + 6 * NOISE
    bench.graph.until(
        lambda: int(bench.graph.values("plant")["saturations"]) == before + 20, "20 saturations in the diagnostics"
    )
    bench.graph.until_well("plant")


def test_a_command_within_the_limits_acts_bit_for_bit(bench):
    wanted = np.random.default_rng(3).uniform(-4000, 4000, 50)
    bench.hand.answer(*([force] for force in wanted))
    bench.hand.hold(0.0, 1)
    np.testing.assert_array_equal(bench.hand.commands[-50:], wanted)
