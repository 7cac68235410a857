# SPDX-License-Identifier: Apache-2.0
"""Claims: measured numbers and the limits that they have to meet."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from abrace.report.table import Table
from abrace_core.files.writing import write_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path


@dataclass(frozen=True)
class Claim:
    """A number that is asked for: `reached` has to be at most `asked` (or at least, where `least`)."""

    name: str
    reached: float
    asked: float
    peer: str
    least: bool = False

    @property
    def holds(self) -> bool:
        """Whether what was asked for is reached."""
        return self.reached >= self.asked if self.least else self.reached <= self.asked


def claim_table(claims: Sequence[Claim]) -> Table:
    """What was reached of what was asked."""
    rows = tuple(
        (
            claim.name,
            f"{claim.reached:.3g}",
            f"{'>=' if claim.least else '<='} {claim.asked:g}",
            claim.peer,
            "" if claim.holds else "MISSED",
        )
        for claim in claims
    )
    return Table("Accuracy (relative errors, unless stated)", ("claim", "reached", "asked", "peer", ""), rows)


def keep(path: Path, values: Mapping[str, Any]) -> None:
    """Write `values` to the results in a file; what an earlier run has left there of others stays."""
    found = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    write_text(path, json.dumps({**found, **values}, indent=1) + "\n")
