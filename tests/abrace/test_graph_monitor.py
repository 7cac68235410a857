# SPDX-License-Identifier: Apache-2.0
"""How a campaign names a life cycle transition that fails."""

from types import SimpleNamespace

import pytest
from lifecycle_msgs.msg import Transition

from abrace.nodes.graph_monitor import GraphMonitor
from abrace_core.errors import RunFailed


def monitor(monkeypatch: pytest.MonkeyPatch, *, answered: bool) -> GraphMonitor:
    """A monitor of a plant that refuses every transition, or that never answers."""
    future = SimpleNamespace(done=lambda: answered, result=lambda: SimpleNamespace(success=False))
    one = GraphMonitor.__new__(GraphMonitor)
    monkeypatch.setattr(one, "spin_once", lambda: None, raising=False)
    client = SimpleNamespace(service_is_ready=lambda: True, call_async=lambda _: future)
    monkeypatch.setattr(one, "_state_clients", {"plant": client}, raising=False)
    return one


def test_a_refused_transition_is_named_in_words(monkeypatch):
    with pytest.raises(RunFailed, match=r"^plant refused to configure$"):
        monitor(monkeypatch, answered=True).configure("plant", 1.0, lambda: None)


def test_a_transition_that_is_not_answered_is_named_in_words(monkeypatch):
    with pytest.raises(RunFailed, match=r"^plant did not deactivate within 0.01 s$"):
        monitor(monkeypatch, answered=False).change_state("plant", Transition.TRANSITION_DEACTIVATE, 0.01, lambda: None)
