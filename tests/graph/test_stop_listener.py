# SPDX-License-Identifier: Apache-2.0
"""A stop that is sent once is heard, however much others send before the rig reads."""

from __future__ import annotations

import os
import signal

from rclpy.duration import Duration
from running_graph import STREAM
from std_msgs.msg import Bool

from abrace_interfaces.msg import Response
from abrace_node.stop_listener import StopListener

OTHERS = 150
"""Messages of another button; one of ten a second and a rig that does not read for 15 s."""


def test_a_stop_is_not_displaced_by_other_buttons_before_it_is_read(graph):
    listener = StopListener(graph.node, 0.0)
    one, other = (graph.publisher(Bool, "emergency_stop", STREAM) for _ in range(2))
    one.publish(Bool(data=True))
    for _ in range(OTHERS):
        other.publish(Bool(data=False))
    for button in (one, other):
        assert button.wait_for_all_acked(Duration(seconds=60.0))
    assert listener.pressed_by() == f"pressed by {graph.namespace}/test"
    one.publish(Bool(data=False))
    graph.until(lambda: not listener.pressed_by(), "the release of that button")
    listener.close()


def test_a_stop_holds_that_was_pressed_while_the_rig_stood_still_though_others_say_later_that_they_are_not(graph):
    responses = graph.listen(Response, "response")
    plant = graph.start("plant").group
    one, other = (graph.publisher(Bool, "emergency_stop", STREAM) for _ in range(2))
    graph.until(lambda: responses, "samples")
    os.kill(plant, signal.SIGSTOP)
    one.publish(Bool(data=True))
    for _ in range(OTHERS):
        other.publish(Bool(data=False))
    os.kill(plant, signal.SIGCONT)
    graph.until_fault("plant", f"protective stop: pressed by {graph.namespace}/test")
    for button in (one, other):
        assert button.wait_for_all_acked(Duration(seconds=60.0))
    count = len(responses) + 100
    graph.until(lambda: len(responses) > count, "samples")
    assert responses[-1].state == Response.PROTECTIVE_STOP
    assert not graph.clear_fault("plant").success, "it is still pressed"
    one.publish(Bool(data=False))
    graph.until(lambda: responses[-1].state == Response.LATCHED, "the release")
