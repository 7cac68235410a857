# SPDX-License-Identifier: Apache-2.0
"""Rigs without a fault: how many of them have a sensor, a cable or a part accused by validity.

The limits of the checks were set on the paper's rig, and on other seeds.
"""

from __future__ import annotations

import sys
from typing import Any

from claims import Claim
from faultless import accusations, faultless

from abrace.report.table import Table
from abrace_core.files.progress import Progress

RIGS, FIRST_SEED, SECONDS = 30, 9100, 120.0


def verify_faultless(first: int = FIRST_SEED, rigs: int = RIGS) -> tuple[dict[str, Any], list[Claim], list[Table]]:
    """Values for verify.json, claims, and a table of the rigs and what was said of them."""
    rows, accused = [], 0
    with Progress(1).step("rigs without a fault") as step:
        for number, seed in enumerate(range(first, first + rigs)):
            kind, rig = faultless(seed)
            found = accusations(rig, seed, SECONDS)
            accused += bool(found)
            rows.append((str(seed), kind, str(rig.floors), "; ".join(one.meaning for one in found) or "-"))
            step.update((number + 1) / rigs, f"{number + 1} of {rigs} rigs")
    claims = [Claim(f"{rigs} rigs without a fault: rigs accused", float(accused), 0.0, "-")]
    table = Table("Rigs without a fault", ("seed", "kind", "floors", "accused"), tuple(rows))
    return {"rigs": rigs, "accused": accused}, claims, [table]


if __name__ == "__main__":
    values, claims, tables = verify_faultless(*(int(text) for text in sys.argv[1:3]))
    print(values)
    print("\n\n".join(table.text() for table in tables))
    sys.exit(0 if all(claim.holds for claim in claims) else 1)
