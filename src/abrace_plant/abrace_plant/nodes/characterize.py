# SPDX-License-Identifier: Apache-2.0
"""The node `characterize`: measures a rig as the paper measured its building, and compares it with the paper.

abrace run abrace_plant characterize --ros-args -p rig:=my_rig.yaml -p output:=results/rig
"""

from __future__ import annotations

import json
from pathlib import Path

from abrace_core.drawing import save_figure
from abrace_core.files import write_text
from abrace_core.node import AbraceNode, Parameter, find_file, run
from abrace_plant.rig import published
from abrace_plant.rig.characteristics import as_json, characterize, comparison
from abrace_plant.rig.characteristics_figure import characteristics_figure
from abrace_plant.rig.effects import effects
from abrace_plant.rig.effects_figure import effects_figure
from abrace_plant.rig.file import load_rig

PARAMETERS = [
    Parameter("rig", published.RIG, "rig: a name in the package's configuration or a file", required=True),
    Parameter("output", "", "folder for characteristics.json and .png; empty: results/characterize/NAME of the rig"),
]


class Characterize(AbraceNode):
    """Measures one rig and ends."""

    def __init__(self) -> None:
        super().__init__("characterize", PARAMETERS)

    def work(self) -> None:
        """Measure, print, write, draw."""
        rig = load_rig(find_file(self.parameters.rig, "abrace_plant", "config", ".yaml", "rig"))
        found = characterize(rig)
        if rig.name == published.RIG:
            print(f"{'':32s} {'unit':6s} {'rig':>9s} {'paper':>9s}")
            for quantity, unit, ours, paper in comparison(found):
                print(f"{quantity:32s} {unit:6s} {ours:9.4f} {paper:9.4f}")
        else:
            for title, pairs in (("bare frame", found.bare), ("zero command", found.zero_command), ("", found.extra)):
                for frequency, ratio in pairs:
                    print(f"{title or 'further pair':14s} {frequency:9.4f} rad/s  {100 * ratio:7.4f} %")
            if errors := rig.building.frequency_errors:
                listed = ", ".join(f"{100 * error:.2g}" for error in errors)
                print(f"frame condensed to its levels: frequencies off by {listed} % of the whole frame's")
            print(f"first mode: {', '.join(f'{value:.3f}' for value in found.shape)}")
            for number, brace in enumerate(found.braces, 1):
                print(
                    f"brace group {number}: bench lag {1e3 * brace.bench_lag:.3f} ms, greatest gain "
                    f"{1 + brace.bench_gain_error:.4f}, antiresonances of f/U at "
                    f"{', '.join(f'{value:.3f}' for value in brace.antiresonances)} rad/s"
                )
        output = Path(self.parameters.output or f"results/characterize/{rig.name}")
        write_text(output / "characteristics.json", json.dumps(as_json(found, rig), indent=1) + "\n")
        save_figure(characteristics_figure(rig, found), output / "characteristics.png")
        if left_out := effects(rig):
            save_figure(effects_figure(rig), output / "effects.png")
            self.get_logger().warning(
                f"these are the numbers of the rig's linear model, which leaves out: {'; '.join(left_out)}"
            )
        print(f"wrote {output}")


def main() -> int:
    """Entry point."""
    return run(Characterize)
