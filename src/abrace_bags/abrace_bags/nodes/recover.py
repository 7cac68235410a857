# SPDX-License-Identifier: Apache-2.0
"""The node `recover`: makes a complete bag of one that was cut off or damaged.

abrace run abrace_bags recover --ros-args -p bag:=bags/broken -p output:=bags/recovered
"""

from __future__ import annotations

from abrace_bags import recover
from abrace_bags.topics import printable
from abrace_node.node import AbraceNode
from abrace_node.parameters import Parameter
from abrace_node.process import run

PARAMETERS = [
    Parameter("bag", "", "bag (a directory or an MCAP file) that was cut off or damaged", required=True),
    Parameter("output", "", "bag (a new directory) to write", required=True),
]


class Recover(AbraceNode):
    """Reads what can be read, writes it and ends."""

    def __init__(self) -> None:
        super().__init__("recover", PARAMETERS)

    def work(self) -> None:
        """Read, write, print."""
        given = self.parameters
        recovered = recover(given.bag, given.output)
        counts = ", ".join(f"{count} of {topic}" for topic, count in recovered.counts.items())
        for line in (*recovered.warnings, f"wrote {given.output}: {counts}"):
            print(f"recover: {printable(line)}", flush=True)


def main() -> int:
    """Entry point."""
    return run(Recover)
