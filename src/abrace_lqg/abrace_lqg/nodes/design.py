"""The node `design`: a model file and a weights file to a controller's parameter file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from abrace_core.controller_file import Controller, save_controller
from abrace_core.errors import AbraceError
from abrace_core.linear_model import load_model
from abrace_core.node import AbraceNode, Parameter, find_file, run
from abrace_lqg.design import design
from abrace_lqg.margins import closed_loop_poles, margins
from abrace_lqg.weights import load_weights

PARAMETERS = [
    Parameter("model", "", "model file (JSON) to design with", required=True),
    Parameter("check_models", [], "further model files with which the loop has to be stable", element=str),
    Parameter("weights", "lqg3", "weights: a name in the package's configuration or a file", required=True),
    Parameter("sample_period", 0.002, "s, of the controller", minimum=1e-6),
    Parameter("force_limit", [24516.625], "N, of one brace of each group", minimum=1.0),
    Parameter("output", "", "controller file (YAML) to write", required=True),
]


class Design(AbraceNode):
    """Designs one controller and ends."""

    def __init__(self) -> None:
        super().__init__("design", PARAMETERS)

    def work(self) -> None:
        """Design, report, write."""
        given = self.parameters
        if not given.output.endswith(".yaml"):
            raise AbraceError(f"parameter output: {given.output}, expected a file name that ends in .yaml")
        weights_file = find_file(given.weights, "abrace_lqg", "config", ".yaml", "weights")
        model, weights = load_model(given.model), load_weights(weights_file)
        others = [load_model(path) for path in given.check_models]
        designed = design(model, weights, given.sample_period, others)
        found = margins(model, designed.controller)
        bags = model.provenance.get("bags", {})
        controller = Controller(
            name=Path(given.output).stem,
            law=designed.controller,
            force_limit=np.array(given.force_limit),
            model=f"{given.model}, {model.order} states, from {', '.join(map(str, bags.values())) or 'unknown bags'}",
            weights=f"{weights_file.name}: {weights}",
            margins=str(found),
        )
        save_controller(controller, given.output)
        print(f"margins with the model of {model.order} states: {found}")
        print("closed-loop poles (rad/s, damping ratio):")
        for frequency, damping_ratio in closed_loop_poles(model, designed.controller):
            print(f"  {frequency:9.3f}  {damping_ratio:7.4f}")
        print(f"wrote {given.output}")


def main() -> int:
    """Entry point."""
    return run(Design)
