# SPDX-License-Identifier: Apache-2.0
"""What nodes report of themselves, as a table for an operator."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

STALE = 2.5
"""Seconds without a report after which a node that reports once a second is stale."""
OK = b"\x00"
"""`DiagnosticStatus.OK`."""
LOSSES = ("lost", "missed")
"""Beginnings of the names of diagnostics entries that count losses."""
MOST_NODES = 500
"""Nodes that are kept: names in `/diagnostics` may be anything, and each new one would stay in memory."""
LONGEST_COUNT = 20
"""Digits of the greatest count that a node has, of 64 bits."""


def count_of(text: str) -> int | None:
    """The count that an entry of diagnostics gives; None: its `text` is none that a node could have."""
    return int(text) if text.isdecimal() and len(text) <= LONGEST_COUNT else None


@dataclass(frozen=True)
class NodeReport:
    """The last report of a node.

    Parameters
    ----------
    message
        Its state, or its fault.
    failed
        Whether it has a fault.
    heard
        When it came [s].
    rate
        Samples a second since the report before; None: it counts none.
    lost
        Samples or messages that it has missed; None: it counts none.
    sequence
        Number of its last sample; -1: it counts none.
    stopped
        "pressed by ..." where a stop button is; else empty.
    count
        Reports so far.
    values
        What else it says, by name.
    """

    message: str
    failed: bool
    heard: float
    rate: float | None
    lost: int | None
    sequence: int
    stopped: str
    count: int
    values: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def after(
        cls, before: NodeReport | None, message: str, failed: bool, values: Mapping[str, str], heard: float
    ) -> NodeReport:
        """The report with a `message` and these `values` that was `heard` [s] after the one `before`.

        `failed`: as in NodeReport.
        """
        number = count_of(values.get("sequence", ""))
        sequence = -1 if number is None else number
        rate = None
        if before is not None and sequence >= before.sequence >= 0:
            span = heard - before.heard
            rate = (sequence - before.sequence) / span if span > 0.2 else before.rate
        losses = [count_of(value) for key, value in values.items() if key.partition(" ")[0] in LOSSES]
        counts = [one for one in losses if one is not None]
        lost = sum(counts) if counts else None
        count = 1 + (before.count if before else 0)
        return cls(message, failed, heard, rate, lost, sequence, values.get("stop", ""), count, values)

    def stale(self, now: float) -> bool:
        """Whether the node has not reported for so long that it may have ended, by the time `now` [s]."""
        return now - self.heard > STALE

    def words(self, now: float) -> str:
        """Its state for people, at the time `now` [s]."""
        return f"stale for {now - self.heard:.0f} s; was: {self.message}" if self.stale(now) else self.message


class NodeReports(dict[str, NodeReport]):
    """What each node has reported last, by its name; of more than MOST_NODES those heard last."""

    def note(self, status: Any, now: float) -> None:
        """Note a `status` (DiagnosticStatus) that came at the time `now` [s], if it is the state of a node."""
        name, _, what = status.name.partition(":")
        if what.strip() == "state":
            values = {pair.key: pair.value for pair in status.values}
            self.keep(f"/{name.lstrip('/')}", status.message, status.level != OK, values, now)

    def keep(self, name: str, message: str, failed: bool, values: Mapping[str, str], heard: float) -> None:
        """Keep what the node `name` has reported; the other arguments as in `NodeReport.after`."""
        before = self.get(name)
        if before is None and len(self) >= MOST_NODES:
            del self[min(self, key=lambda known: self[known].heard)]
        self[name] = NodeReport.after(before, message, failed, values, heard)

    def rows(self, now: float) -> list[dict[str, str | float | int | None]]:
        """For each node its `name`, `level` (ok, error or stale), `state`, `rate` and `lost` at the time `now` [s]."""
        return [
            {
                "name": name,
                "level": "stale" if one.stale(now) else "error" if one.failed else "ok",
                "state": one.words(now),
                "rate": one.rate,
                "lost": one.lost,
            }
            for name, one in sorted(self.items())
        ]


def node_table(reports: Mapping[str, NodeReport], now: float) -> str:
    """A line for each node of `reports`, by full name; `now` [s] tells which of them are stale."""
    if not reports:
        return "no node reports; is ROS_DOMAIN_ID that of the rig?"

    def cells(name: str, report: NodeReport) -> tuple[str, ...]:
        rate = "-" if report.rate is None else f"{report.rate:.0f}"
        return name, rate, "-" if report.lost is None else str(report.lost), report.words(now)

    rows = [("node", "samples/s", "lost", "state"), *(cells(name, one) for name, one in sorted(reports.items()))]
    width = max(len(row[0]) for row in rows)
    return "\n".join(f"{name:{width}}  {rate:>9}  {lost:>6}  {state}" for name, rate, lost, state in rows)
