# SPDX-License-Identifier: Apache-2.0
"""The node `characterize`: measures a rig as the paper measured its building, and compares it with the paper.

abrace run abrace_plant characterize --ros-args -p rig:=my_rig.yaml -p output:=results/rig
"""

from __future__ import annotations

import json
from pathlib import Path

from abrace_core.figures.saving import save_figure
from abrace_core.files.installed import find_file
from abrace_core.files.writing import write_text
from abrace_node.node import AbraceNode
from abrace_node.parameters import Parameter
from abrace_node.process import run
from abrace_plant.rig import published
from abrace_plant.rig.characteristics import as_json, characterize, rows
from abrace_plant.rig.characteristics_figure import characteristics_figure
from abrace_plant.rig.effects import effects
from abrace_plant.rig.file import load_rig

PARAMETERS = [
    Parameter("rig", published.RIG, "rig: a name in the package's configuration or a file", required=True),
    Parameter("output", "", "folder for characteristics.json and .svg; empty: results/characterize/NAME of the rig"),
]


class Characterize(AbraceNode):
    """Measures one rig and ends."""

    def __init__(self) -> None:
        super().__init__("characterize", PARAMETERS)

    def work(self) -> None:
        """Measure, print, write, draw."""
        rig = load_rig(find_file(self.parameters.rig, "abrace_plant", "config", ".yaml", "rig"))
        found = characterize(rig)
        print(f"{'':36s} {'unit':6s} {'rig':>9s}" + (f" {'paper':>9s}" if rig.name == published.RIG else ""))
        for quantity, unit, ours, paper in rows(found, rig):
            print(f"{quantity:36s} {unit:6s} {ours:9.4f}" + ("" if paper is None else f" {paper:9.4f}"))
        output = Path(self.parameters.output or f"results/characterize/{rig.name}")
        write_text(output / "characteristics.json", json.dumps(as_json(found, rig), indent=1) + "\n")
        save_figure(characteristics_figure(rig, found), output / "characteristics.svg")
        if left_out := effects(rig):
            self.get_logger().warning(
                f"these are the numbers of the rig's linear model, which leaves out: {'; '.join(left_out)}"
            )
        print(f"wrote {output}")


def main() -> int:
    """Entry point."""
    return run(Characterize)
