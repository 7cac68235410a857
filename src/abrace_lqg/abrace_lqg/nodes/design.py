# SPDX-License-Identifier: Apache-2.0
"""The node `design`: a model file and a weights file to a controller's parameter file, and its proof.

abrace run abrace_lqg design --ros-args -p model:=model/reduced.json -p weights:=lqg3 -p output:=lqg3.yaml
"""

from __future__ import annotations

from abrace_core.errors import AbraceError
from abrace_core.linear_model import load_model
from abrace_core.node import AbraceNode, Parameter, find_file, run
from abrace_lqg.of_model import excitation_of, force_limit_of, sample_period_of
from abrace_lqg.proof.files import DRAWS
from abrace_lqg.proof.limits import OBJECTIONS, Limits
from abrace_lqg.proof.proven_design import design_to_file
from abrace_lqg.proof.table import table_lines
from abrace_lqg.weights import load_weights

LIMITS = {
    "gain_margin": "dB, least gain margin at each command; 0: no limit",
    "phase_margin": "degrees, least phase margin at each command; 0: no limit",
    "delay_margin": "s, least delay margin at each command; 0: no limit",
    "disk_margin": "least disk margin of all commands and measured quantities at once; 0: no limit",
    "damping_kept": "least share of its damping that each mode keeps; 0: no limit",
}
PARAMETERS = [
    Parameter("model", "", "model file (JSON) to design with", required=True),
    Parameter(
        "check_models", [], "further model files to check the closed loop with, such as the rig's own", element=str
    ),
    Parameter("weights", "lqg3", "weights: a name in the package's configuration or a file", required=True),
    Parameter("sample_period", 0.0, "s, sample period of the controller; 0: that of the model's tests", minimum=0.0),
    Parameter(
        "force_limit",
        [],
        "N, greatest force of one brace of each group; []: as the model's file says",
        element=float,
        minimum=1.0,
    ),
    *(Parameter(name, getattr(Limits(), name), text, minimum=0.0) for name, text in LIMITS.items()),
    Parameter("accept", [], "limits that the controller may violate, by name", choices=OBJECTIONS, element=str),
    Parameter("draws", DRAWS, "models drawn from the covariance of each model that has one; 0: none", minimum=0),
    Parameter("draw_seed", 0, "seed of these models", minimum=0),
    Parameter(
        "excitation_rms", 0.25, "m/s^2, rms of the ground acceleration for the predicted responses", minimum=1e-9
    ),
    Parameter(
        "excitation_band",
        [],
        "Hz, lowest and highest frequency of this excitation; empty: 0.3 to 10 Hz, or wider around the slowest mode",
        element=float,
        minimum=0.0,
    ),
    Parameter("output", "", "controller file (YAML) to write; the proof's files go to its folder", required=True),
]


class Design(AbraceNode):
    """Designs one controller and ends."""

    def __init__(self) -> None:
        super().__init__("design", PARAMETERS)

    def work(self) -> None:
        """Design, prove, write, report."""
        given = self.parameters
        if not given.output.endswith(".yaml"):
            raise AbraceError(f"parameter output: {given.output}, expected a file name that ends in .yaml")
        weights_file = find_file(given.weights, "abrace_lqg", "config", ".yaml", "weights")
        weights, model = load_weights(weights_file), load_model(given.model)
        proof, controller, written = design_to_file(
            [given.model, *given.check_models],
            given.output,
            weights=weights,
            weights_name=weights_file.name,
            sample_period=sample_period_of(model, given.sample_period),
            force_limit=force_limit_of(model, given.force_limit),
            excitation=excitation_of(model, given.excitation_rms, given.excitation_band),
            limits=Limits(**{name: getattr(given, name) for name in LIMITS}),
            accept=given.accept,
            draws=given.draws,
            draw_seed=given.draw_seed,
        )
        print("\n".join(table_lines(proof)))
        print(controller.margins)
        print(f"wrote {', '.join(map(str, written))}")


def main() -> int:
    """Entry point."""
    return run(Design)
