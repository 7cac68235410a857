# SPDX-License-Identifier: Apache-2.0
"""Who asks for a stop."""

from abrace_core.safety.stop_senders import MANY, SILENCE, UNNAMED, StopSenders


def test_nobody_asks_until_one_presses():
    senders = StopSenders(0.0, 0.0)
    assert not senders.pressed_by(100.0)
    senders.hear("a", "panel", 1, False, 1.0)
    assert not senders.pressed_by(100.0)
    senders.hear("a", "panel", 2, True, 2.0)
    assert senders.pressed_by(100.0) == "pressed by panel"


def test_one_that_releases_does_not_release_another():
    senders = StopSenders(0.0, 0.0)
    senders.hear("a", "panel", 3, True, 1.0)
    senders.hear("b", "desk", 4, True, 1.0)
    senders.hear("b", "desk", 5, False, 2.0)
    assert senders.pressed_by(3.0) == "pressed by panel"
    senders.hear("a", "panel", 6, False, 3.0)
    assert not senders.pressed_by(3.0)


def test_one_that_has_left_while_pressed_counts_until_a_person_clears():
    senders = StopSenders(0.0, 0.0)
    senders.hear("a", "panel", 7, True, 1.0)
    assert senders.pressed_by(1000.0) == "pressed by panel"
    senders.forget(["a"], 1000.0)
    assert not senders.pressed_by(1000.0)


def test_silence_is_a_stop_where_a_heartbeat_is_asked_for():
    senders = StopSenders(0.5, 0.0)
    assert not senders.pressed_by(0.4)
    assert senders.pressed_by(0.6) == "no heartbeat for more than 0.5 s"
    senders.hear("a", "panel", 8, False, 0.7)
    senders.hear("b", "desk", 9, False, 0.7)
    assert not senders.pressed_by(1.1)
    senders.hear("a", "panel", 10, False, 1.1)
    assert senders.pressed_by(1.3) == "no heartbeat of desk for more than 0.5 s"
    senders.forget(["b"], 1.3)
    assert not senders.pressed_by(1.3)
    senders.forget(["a"], 1.4)
    assert senders.pressed_by(2.0) == "no heartbeat for more than 0.5 s", "one there has to be"


def test_a_name_that_becomes_known_later_is_told():
    senders = StopSenders(0.0, 0.0)
    senders.hear("a", UNNAMED, 11, True, 1.0)
    senders.hear("b", UNNAMED, 12, False, 1.0)
    assert senders.pressed_by(1.0) == f"pressed by {UNNAMED}"
    assert senders.unnamed == ("a",)
    senders.rename("a", "panel")
    assert senders.pressed_by(2.0) == "pressed by panel"
    assert not senders.unnamed
    assert (senders.name("a"), senders.name("b")) == ("panel", "")


def test_a_message_that_comes_again_by_another_subscription_changes_nothing():
    senders = StopSenders(0.5, 0.0)
    senders.hear("a", "panel", 1, True, 1.0)
    senders.hear("a", "panel", 2, False, 1.2)
    senders.hear("a", "panel", 1, True, 1.4)
    assert not senders.pressed_by(1.6)
    assert senders.pressed_by(1.8) == "no heartbeat of panel for more than 0.5 s", "nor is it a heartbeat"


def test_a_button_that_comes_back_pressed_after_it_was_forgotten_is_a_stop_again():
    """Its last message comes again, from a transient local publisher, once the network is back."""
    senders = StopSenders(0.0, 0.0)
    senders.hear("a", "panel", 5, True, 1.0)
    senders.forget(["a"], 30.0)
    assert not senders.pressed_by(31.0)
    senders.hear("a", "panel", 5, True, 32.0)
    assert senders.pressed_by(32.0) == "pressed by panel"


def test_of_many_senders_those_that_have_released_and_fallen_silent_are_dropped_and_no_stop_is():
    senders = StopSenders(0.0, 0.0)
    senders.hear("pressed", "panel", 1, True, 0.0)
    senders.hear("page", "page", 1, False, 0.0)
    for second in range(5000):
        senders.hear(second, f"program_{second}", 1, True, float(second))
        senders.hear(second, f"program_{second}", 2, False, float(second))
        senders.hear("page", "page", second + 2, False, float(second))
        assert senders.pressed_by(float(second)) == "pressed by panel", second
        assert len(senders.senders) <= MANY + SILENCE
    assert senders.name("page") == "page", "which goes on sending"
    senders.hear(0, "program_0", 3, True, 5000.0)
    assert senders.pressed_by(5000.0) == "pressed by panel, pressed by program_0", "one that was dropped is heard again"


def test_of_many_senders_with_a_heartbeat_none_is_dropped_as_silence_is_a_stop():
    senders = StopSenders(0.5, 0.0)
    for second in range(5 * MANY):
        senders.hear(second, f"program_{second}", 1, False, float(second))
    asking = senders.pressed_by(5.0 * MANY)
    assert all(f"no heartbeat of program_{second} " in asking for second in range(5 * MANY))
