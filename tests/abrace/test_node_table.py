"""What nodes report, as a table."""

from abrace.report.node_table import NodeReport, node_table


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


def test_a_node_that_no_longer_reports_is_shown_as_stale():
    text = node_table({"/rig/plant": report(heard=10.0), "/rig/logger": report(heard=17.0)}, 17.5)
    assert text.splitlines() == [
        "node         samples/s    lost  state",
        "/rig/logger          -       -  running",
        "/rig/plant           -       -  stale for 8 s; was: running",
    ]
