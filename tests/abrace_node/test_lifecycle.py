# SPDX-License-Identifier: Apache-2.0
"""What a life cycle node answers when one of its methods fails: the truth, and it is at rest."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import domain_coordinator
import pytest
import rclpy
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from std_msgs.msg import Bool

from abrace_core import AbraceError
from abrace_node.lifecycle import AbraceLifecycleNode

if TYPE_CHECKING:
    from collections.abc import Iterator


class Shaker(AbraceLifecycleNode):
    """A node whose method `failing` raises `planted`."""

    failing = ""
    planted: Exception = AbraceError("the pump does not stop, expected 0 bar")

    def __init__(self, context: rclpy.Context) -> None:
        super().__init__("shaker", [], context=context)

    def plant(self, method: str) -> None:
        if method == self.failing:
            raise self.planted

    def configure(self) -> None:
        self.create_publisher(Bool, "moving", 1)
        self.plant("configure")

    def activate(self) -> None:
        self.due = 1.0
        self.plant("activate")

    def come_to_rest(self) -> None:
        self.plant("come_to_rest")

    def deactivate(self) -> None:
        self.plant("deactivate")
        self.due = None

    def cleanup(self) -> None:
        self.plant("cleanup")

    def go(self, label: str) -> bool:
        """Ask for a transition as its service does; whether it went."""
        request = ChangeState.Request(transition=Transition(label=label))
        return self._on_change_state(request, ChangeState.Response()).success

    @property
    def state(self) -> str:
        return self._state_machine.current_state[1]


@pytest.fixture
def shaker() -> Iterator[Shaker]:
    with domain_coordinator.domain_id() as domain, pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        context = rclpy.Context()
        context.init(args=[], domain_id=domain)
        node = Shaker(context)
        yield node
        node.destroy_node()
        context.try_shutdown()


@pytest.mark.parametrize(
    ("failing", "path", "state"),
    [
        ("deactivate", ["configure", "activate", "deactivate"], "unconfigured"),
        ("cleanup", ["configure", "cleanup"], "unconfigured"),
        ("deactivate", ["configure", "activate", "shutdown"], "finalized"),
        ("configure", ["configure"], "unconfigured"),
    ],
)
def test_a_transition_that_fails_is_answered_so_and_leaves_the_node_at_rest(shaker, failing, path, state):
    shaker.failing = failing
    endpoints = len(list(shaker.publishers))
    assert [shaker.go(label) for label in path] == [True] * (len(path) - 1) + [False]
    assert shaker.state == state
    assert (shaker.active, shaker.configured, shaker.due) == (False, False, None)
    assert len(list(shaker.publishers)) == endpoints, "what configure made is gone"
    if state == "unconfigured":
        shaker.failing = ""
        assert shaker.go("configure")
        assert shaker.go("activate")
        assert len(list(shaker.publishers)) == endpoints + 1


@pytest.mark.parametrize(
    ("failing", "path"),
    [
        ("configure", ["configure"]),
        ("activate", ["configure", "activate"]),
        ("come_to_rest", ["configure", "activate", "deactivate"]),
        ("deactivate", ["configure", "activate", "deactivate"]),
        ("cleanup", ["configure", "cleanup"]),
        ("come_to_rest", ["configure", "activate", "shutdown"]),
    ],
)
def test_an_error_that_nobody_foresaw_fails_the_node_in_one_line_with_its_place(shaker, monkeypatch, failing, path):
    logged = []
    monkeypatch.setattr(shaker.get_logger(), "fatal", logged.append)
    shaker.failing, shaker.planted = failing, KeyError("mass")
    assert [shaker.go(label) for label in path] == [True] * (len(path) - 1) + [False]
    assert shaker.error is shaker.planted
    (line,) = logged
    assert re.fullmatch(r"KeyError: 'mass' \(test_lifecycle.py, line \d+, in plant\)", line)


def test_a_signal_while_a_node_that_has_come_to_rest_is_being_deactivated_is_no_error(shaker):
    """Its state machine is in standby already, and refuses to come to rest."""
    assert all(map(shaker.go, ["configure", "activate"]))
    shaker.failing = "come_to_rest"
    assert shaker.at_rest
    assert shaker.begin_shutdown() == 0.0


def test_an_activation_that_is_refused_leaves_the_node_inactive(shaker):
    shaker.failing = "activate"
    assert shaker.go("configure")
    assert not shaker.go("activate")
    assert (shaker.state, shaker.active, shaker.configured, shaker.due) == ("inactive", False, True, None)
