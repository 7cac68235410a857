# SPDX-License-Identifier: Apache-2.0
"""Who asks for a stop."""

from abrace_core.safety.stop_senders import UNNAMED, StopSenders


def test_nobody_asks_until_one_presses():
    senders = StopSenders(0.0, 0.0)
    assert not senders.who(100.0)
    senders.hear("a", "panel", False, 1.0)
    assert not senders.who(100.0)
    senders.hear("a", "panel", True, 2.0)
    assert senders.who(100.0) == "pressed by panel"


def test_one_that_releases_does_not_release_another():
    senders = StopSenders(0.0, 0.0)
    senders.hear("a", "panel", True, 1.0)
    senders.hear("b", "desk", True, 1.0)
    senders.hear("b", "desk", False, 2.0)
    assert senders.who(3.0) == "pressed by panel"
    senders.hear("a", "panel", False, 3.0)
    assert not senders.who(3.0)


def test_one_that_has_left_while_pressed_counts_until_a_person_clears():
    senders = StopSenders(0.0, 0.0)
    senders.hear("a", "panel", True, 1.0)
    assert senders.who(1000.0) == "pressed by panel"
    senders.forget(["a"], 1000.0)
    assert not senders.who(1000.0)


def test_silence_is_a_stop_where_a_heartbeat_is_asked_for():
    senders = StopSenders(0.5, 0.0)
    assert not senders.who(0.4)
    assert senders.who(0.6) == "no heartbeat for more than 0.5 s"
    senders.hear("a", "panel", False, 0.7)
    senders.hear("b", "desk", False, 0.7)
    assert not senders.who(1.1)
    senders.hear("a", "panel", False, 1.1)
    assert senders.who(1.3) == "no heartbeat of desk for more than 0.5 s"
    senders.forget(["b"], 1.3)
    assert not senders.who(1.3)
    senders.forget(["a"], 1.4)
    assert senders.who(2.0) == "no heartbeat for more than 0.5 s", "one there has to be"


def test_a_name_that_becomes_known_later_is_told():
    senders = StopSenders(0.0, 0.0)
    senders.hear("a", UNNAMED, True, 1.0)
    senders.hear("b", UNNAMED, False, 1.0)
    assert senders.who(1.0) == f"pressed by {UNNAMED}"
    assert senders.unnamed == ("a",)
    senders.rename("a", "panel")
    assert senders.who(2.0) == "pressed by panel"
    assert not senders.unnamed
    assert (senders.name("a"), senders.name("b")) == ("panel", "")
