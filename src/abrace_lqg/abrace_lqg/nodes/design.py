# SPDX-License-Identifier: Apache-2.0
"""The node `design`: a model file and a weights file to a controller's parameter file, and its proof.

abrace run abrace_lqg design --ros-args -p model:=model/reduced.json -p weights:=lqg3 -p output:=lqg3.yaml
"""

from __future__ import annotations

import sys

from abrace_core import AbraceError
from abrace_core.files.installed import find_file
from abrace_core.files.progress import Progress
from abrace_lqg.proof.files import table_lines
from abrace_lqg.proof.limits import DesignOptions
from abrace_lqg.proof.proven_design import design_to_file
from abrace_lqg.weights import load_weights
from abrace_node.node import AbraceNode
from abrace_node.parameters import Parameter, parameters_of
from abrace_node.process import run

PARAMETERS = [
    Parameter("model", "", "model file (JSON) to design with", required=True),
    Parameter(
        "check_models", [], "further model files to check the closed loop with, such as the rig's own", element=str
    ),
    Parameter("weights", "lqg3", "weights: a name in the package's configuration or a file", required=True),
    *parameters_of(DesignOptions),
    Parameter("output", "", "controller file (YAML) to write; the proof's files go to its folder", required=True),
]


class DesignNode(AbraceNode):
    """Designs one controller and ends."""

    def __init__(self) -> None:
        super().__init__("design", PARAMETERS)

    def work(self) -> None:
        """Design, prove, write, report."""
        given = self.parameters
        if not given.output.endswith(".yaml"):
            raise AbraceError(f"parameter output: {given.output}, expected a file name that ends in .yaml")
        weights_file = find_file(given.weights, "abrace_lqg", "config", ".yaml", "weights")
        weights = load_weights(weights_file)
        with Progress(1, sys.stdout).step("design") as shown:
            proof, controller, written = design_to_file(
                [given.model, *given.check_models],
                given.output,
                weights=weights,
                weights_name=weights_file.name,
                options=DesignOptions.of_values(given),
                progress=lambda done, count: shown.update(done / count, f"{done} of {count} models"),
            )
        print("\n".join(table_lines(proof)))
        print(controller.margins)
        print(f"wrote {', '.join(map(str, written))}")


def main() -> int:
    """Entry point."""
    return run(DesignNode)
