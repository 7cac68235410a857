# SPDX-License-Identifier: Apache-2.0
"""How many messages the publishers of streams keep: what a killed subscriber has not acknowledged is removed at once,
in a time that grows with the square of their number, while the rig waits."""

from abrace_node.transport import KEPT_STREAM_QOS, lockstep_environment, published_stream_qos

AT_ONCE = 1000
"""Messages that are removed in 1.5 ms."""


def test_few_messages_are_kept_for_a_subscriber_that_does_not_answer():
    qos = published_stream_qos()
    assert qos.depth == AT_ONCE
    assert qos.lifespan.nanoseconds == 2e9
    assert published_stream_qos(depth=10).depth == 10


def test_in_lockstep_all_are_kept_that_a_slow_subscriber_and_its_answers_need(monkeypatch):
    for name, value in lockstep_environment().items():
        monkeypatch.setenv(name, value)
    assert published_stream_qos().depth == 2 * KEPT_STREAM_QOS.depth
