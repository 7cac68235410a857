# SPDX-License-Identifier: Apache-2.0
"""What a campaign knows of its nodes, and how it names a life cycle transition that fails."""

from types import SimpleNamespace

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from abrace.nodes.graph_monitor import GraphMonitor
from abrace.report.node_table import MOST_NODES
from abrace_core import RunFailed


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
        monitor(monkeypatch, answered=True).change_state("plant", "configure", 1.0, lambda: None)


def test_a_transition_that_is_not_answered_is_named_in_words(monkeypatch):
    with pytest.raises(RunFailed, match=r"^plant did not deactivate within 0.01 s$"):
        monitor(monkeypatch, answered=False).change_state("plant", "deactivate", 0.01, lambda: None)


def status(name: str, level: bytes = DiagnosticStatus.OK) -> DiagnosticStatus:
    return DiagnosticStatus(level=level, name=name, message="so", values=[KeyValue(key="sequence", value="7")])


def test_names_of_anyone_fill_no_memory_and_the_nodes_that_report_are_kept():
    one = GraphMonitor("/demo", ())
    for number in range(3 * MOST_NODES):
        reported = [status(f"demo/somebody_{number}: state", DiagnosticStatus.ERROR), status("demo/plant: state")]
        one._on_diagnostics(DiagnosticArray(status=[*reported, status("other/plant: state", DiagnosticStatus.ERROR)]))
    assert len(one.reports) == len(one.values) == MOST_NODES
    assert one.values["plant"] == {"sequence": "7"}
    assert "plant" not in one.faults
    assert one.faults[f"somebody_{number}"] == "so"
    one._on_diagnostics(DiagnosticArray(status=[status("demo/plant: state", DiagnosticStatus.ERROR)]))
    assert one.faults["plant"] == "so"
    one._on_diagnostics(DiagnosticArray(status=[status("demo/plant: state")]))
    assert "plant" not in one.faults
