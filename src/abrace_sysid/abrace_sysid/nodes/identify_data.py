# SPDX-License-Identifier: Apache-2.0
"""The node `identify_data`: identifies a model of any structure from measured data, with figures.

abrace run abrace_sysid identify_data --ros-args -p data:=d.csv -p inputs:=[force] -p time:=t -p output:=structure
"""

from __future__ import annotations

from pathlib import Path

from abrace_core.figures.saving import save_figure
from abrace_core.files.progress import printed_steps
from abrace_node.node import AbraceNode
from abrace_node.parameters import Parameter, parameters_of
from abrace_node.process import run
from abrace_sysid.data_identification import DataOptions
from abrace_sysid.figures.identification import figures_of_data
from abrace_sysid.results import write_data_results, write_validity
from abrace_sysid.validity.judgement import identify_and_judge

PARAMETERS = [
    Parameter("data", [], "file of measured data (.mat, .csv, .npz, .npy), or a list", element=str, required=True),
    Parameter("validation", [], "other records of the structure, predicted by the model", element=str),
    *parameters_of(DataOptions),
    Parameter("output", "", "folder for model, poles and figures", required=True),
]


class IdentifyData(AbraceNode):
    """Identifies one structure, then ends."""

    def __init__(self) -> None:
        super().__init__("identify_data", PARAMETERS)

    def work(self) -> None:
        """Read the data, identify, judge, write, draw."""
        given = self.parameters
        options, output = DataOptions.of_values(given), Path(given.output)
        progress = printed_steps()
        progress("reading the data", 0.0)
        validation = options.read(given.validation) if given.validation else ()
        found, held_out, judged = identify_and_judge(options.read(given.data), options, progress, validation)
        for warning in found.warnings:
            self.get_logger().warning(warning)
        print(write_data_results(found, held_out, output))
        progress("drawing", 1.0)
        for name, figure in figures_of_data(found).items():
            save_figure(figure, output / f"{name}.svg")
        write_validity(judged, output)
        print(f"wrote {output}")
        print(judged.validity.text())


def main() -> int:
    """Entry point."""
    return run(IdentifyData)
