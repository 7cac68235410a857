# SPDX-License-Identifier: Apache-2.0
"""Write docs/planted_causes.md: what trips each interlock of the paper's rig, `python docs/write_planted_causes.py`."""

from __future__ import annotations

from pathlib import Path

from planted_causes import PLANTED, tripped

from abrace_core.files import write_text
from abrace_core.node import find_file
from abrace_plant.rig.file import load_rig

PAGE = Path(__file__).parent / "planted_causes.md"

INTRODUCTION = """# Interlocks tripped one by one

Written by `python docs/write_planted_causes.py`, which runs the paper's simulated rig in lockstep with one fault at a
time (`tests/support/planted_causes.py`). For every [interlock](interlocks.md) there is a fault that trips it before any
other one; without the fault the same test does not trip. Braces and table are driven gently unless the fault is in what
drives them. Where another interlock would act first, the limit of this one is lower than in the rig file.

`make verify` runs all of them (`interlocks_tripped` of `interlocks` in `safety` of `results/verify.json`, messages and
times in `interlocks`). The library tests also check that braces and table come to rest and that the fault is latched;
the graph tests do the same for some of them on the running node.

| interlock | fault | limit, if not the rig file's | message of the rig | time to trip |
|---|---|---|---|---|
"""

END = """
The time is counted from the moment at which the fault begins: a sensor or converter that fails, or the start of a wrong
drive or of the motion of a wrongly built rig, which has to build up until the limit is exceeded. The interlock's own
`time` is part of it.
"""


def duration(seconds: float) -> str:
    """A time to trip, in ms below a second."""
    return f"{1e3 * seconds:.0f} ms" if seconds < 1 else f"{seconds:.1f} s"


def page() -> str:
    """The whole page."""
    rig = load_rig(find_file("ncree_three_storey", "abrace_plant", "config", ".yaml", "rig"))
    rows = []
    for interlock, planted in PLANTED.items():
        found = tripped(rig, interlock)
        name = f"`{interlock}`" if interlock in rig.interlocks else "reading that is not a number"
        limit = f"{planted.limits[interlock]:g}" if interlock in planted.limits else ""
        rows.append(f"| {name} | {planted.name} | {limit} | `{found.message}` | {duration(found.seconds)} |")
    return INTRODUCTION + "\n".join(rows) + "\n" + END


if __name__ == "__main__":
    write_text(PAGE, page())
