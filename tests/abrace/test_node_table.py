# SPDX-License-Identifier: Apache-2.0
"""What nodes report, as a table."""

from types import SimpleNamespace

from abrace.report.node_table import MOST_NODES, NodeReport, NodeReports, node_table


def report(before=None, heard=10.0, **values):
    return NodeReport.after(before, "running", False, {key: str(value) for key, value in values.items()}, heard)


def test_the_rate_is_that_of_samples_between_two_reports_and_losses_are_added():
    first = report(sequence=100, lost=2, missed=1)
    assert (first.rate, first.lost, first.count) == (None, 3, 1)
    second = report(first, heard=11.0, sequence=600, lost=2, missed=1)
    assert (second.rate, second.count) == (500.0, 2)
    assert report(second, heard=11.05, sequence=602).rate == 500.0, "a report for another reason, just after it"
    assert report(second, heard=12.0, sequence=3).rate is None, "a new run"
    assert report(first, heard=11.0).rate is None


def test_states_of_nodes_are_found_among_all_diagnostics_and_those_of_other_makers_do_no_harm():
    reports = NodeReports()
    for name, level, sequence in (
        ("rig/plant: state", b"\x02", "7"),
        ("lidar: state", b"\x00", "n/a"),
        ("fan", b"\x01", ""),
    ):
        values = [SimpleNamespace(key="sequence", value=sequence)]
        reports.note(SimpleNamespace(name=name, level=level, message="so", values=values), 10.0)
    rows = {row["name"]: (row["level"], row["state"]) for row in reports.rows(11.0)}
    assert rows == {"/rig/plant": ("error", "so"), "/lidar": ("ok", "so")}
    assert reports["/rig/plant"].sequence == 7
    assert {row["level"] for row in reports.rows(13.0)} == {"stale"}


def test_wrong_diagnostics_of_anyone_are_no_counts_and_fill_no_memory():
    for text in ("9" * 5000, "\u00b2", "-1", "1e3", "nan", ""):
        found = report(report(sequence=1, lost=1), heard=11.0, sequence=text, lost=text)
        assert (found.sequence, found.rate, found.lost) == (-1, None, None), text
    assert report(report(sequence=0), heard=11.0, sequence=2**64 - 1).rate == 2.0**64
    reports = NodeReports()
    for number in range(3 * MOST_NODES):
        for name in (f"somebody_{number}: state", "rig/plant: state"):
            reports.note(SimpleNamespace(name=name, level=b"\x00", message="so", values=[]), float(number))
    assert len(reports) == MOST_NODES
    assert "/rig/plant" in reports, "who reports is kept"


def test_a_node_that_no_longer_reports_is_shown_as_stale():
    text = node_table({"/rig/plant": report(heard=10.0), "/rig/logger": report(heard=17.0)}, 17.5)
    assert text.splitlines() == [
        "node         samples/s    lost  state",
        "/rig/logger          -       -  running",
        "/rig/plant           -       -  stale for 8 s; was: running",
    ]
