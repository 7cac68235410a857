"""The node `identify`: two bags of white-noise tests to the models of Eqs. (3) to (9), with figures."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import numpy as np

from abrace_core.bag import read_run
from abrace_core.drawing import save_figure
from abrace_core.files import write_text
from abrace_core.linear_model import export_mat, pole_table, save_model
from abrace_core.node import AbraceNode, Parameter, run
from abrace_sysid import figures
from abrace_sysid.identification import IdentificationOptions, identify

DEFAULTS = IdentificationOptions()

PARAMETERS = [
    Parameter("table", "", "bag of the test with white noise on the table", required=True),
    Parameter("command", "", "bag of the test with white noise as command", required=True),
    Parameter("output", "", "folder for models, poles and figures", required=True),
    Parameter("method", DEFAULTS.method, "of the transfer functions", choices=("local_polynomial", "welch")),
    Parameter(
        "command_order", DEFAULTS.command_order, "poles of the accelerations' response to the command", minimum=2
    ),
    Parameter("servo_lag", DEFAULTS.servo_lag, "s, of the actuators, from the bench test", minimum=0.0),
    Parameter("reduced_order", DEFAULTS.reduced_order, "states of the reduced model", minimum=1),
    Parameter("mat", False, "write the models as MATLAB files too"),
]


class Identify(AbraceNode):
    """Identifies one rig and ends."""

    def __init__(self) -> None:
        super().__init__("identify", PARAMETERS)

    def work(self) -> None:
        """Read, identify, write, draw."""
        given = self.parameters
        begin = time.monotonic()

        def progress(step: str, fraction: float) -> None:
            print(f"{fraction:4.0%} {step} ({time.monotonic() - begin:.1f} s)", flush=True)

        progress("reading the bags", 0.0)
        table, command = read_run(given.table), read_run(given.command)
        for recorded in (table, command):
            for warning in recorded.facts.get("warnings", []):
                print(warning, file=sys.stderr, flush=True)
        options = IdentificationOptions(
            method=given.method,
            command_order=given.command_order,
            servo_lag=given.servo_lag,
            reduced_order=given.reduced_order,
        )
        found = identify(table, command, options, progress)
        output = Path(given.output)
        for name, model in (("model", found.model), ("reduced", found.reduced)):
            save_model(model, output / f"{name}.json")
            if given.mat:
                export_mat(model, output / f"{name}.mat")
        poles = {"table": found.table_poles, "command": found.command_poles}
        write_text(
            output / "poles.json", json.dumps({test: _pairs(values) for test, values in poles.items()}, indent=1)
        )
        for test, values in poles.items():
            print(f"poles from the {test} test (rad/s, damping ratio):")
            for pair in _pairs(values):
                print(f"  {pair['frequency']:9.3f}  {pair['damping_ratio']:7.4f}")
        progress("drawing", 1.0)
        top = table.floors
        drawings = {
            "figure_3_force": figures.transfer_functions(found.command_response, ["f"], found.model),
            "figure_4_table": figures.transfer_functions(found.table_response, [f"x{top}", "a1"], found.model),
            "figure_5_command": figures.transfer_functions(found.command_response, [f"x{top}", "a1"], found.model),
            "hankel_singular_values": figures.hankel_singular_values(found.hankel_singular_values, given.reduced_order),
        }
        for name, figure in drawings.items():
            save_figure(figure, output / f"{name}.png")
        print(f"wrote {output}")


def _pairs(poles: np.ndarray) -> list[dict[str, float]]:
    return [{"frequency": frequency, "damping_ratio": damping} for frequency, damping in pole_table(poles)]


def main() -> int:
    """Entry point."""
    return run(Identify)
