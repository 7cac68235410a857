# SPDX-License-Identifier: Apache-2.0
"""The node `identify`: identifies models from bags of table and command tests, with figures.

abrace run abrace_sysid identify --ros-args -p table:=table_noise -p command:=command_noise -p output:=model
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from abrace_core import AbraceError
from abrace_core.figures.saving import save_figure
from abrace_core.files.progress import printed_steps
from abrace_core.model.signals import most_telling
from abrace_node.node import AbraceNode
from abrace_node.parameters import Parameter, parameters_of
from abrace_node.process import run
from abrace_sysid.figures import identification as figures
from abrace_sysid.figures.poles import confidence
from abrace_sysid.fitting.options import IdentificationOptions
from abrace_sysid.identification import Identification, identify
from abrace_sysid.recorded.test import given_tests
from abrace_sysid.results import write_identification, write_validity
from abrace_sysid.validity.judgement import judge, judge_failure

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure

    from abrace_core.figures.chart import Chart
    from abrace_sysid.recorded.test import Test

PARAMETERS = [
    Parameter(
        "table", [], "bag, or list of bags, of tests with noise or a multisine on the table", element=str, required=True
    ),
    Parameter(
        "command",
        [],
        "the same for tests with commands; the same bags if both were excited at once",
        element=str,
        required=True,
    ),
    Parameter("output", "", "folder for models, poles and figures", required=True),
    *parameters_of(IdentificationOptions),
]


class IdentifyNode(AbraceNode):
    """Identifies one rig, then ends."""

    def __init__(self) -> None:
        super().__init__("identify", PARAMETERS)

    def work(self) -> None:
        """Read the bags, identify, write, draw and judge."""
        given, options = self.parameters, IdentificationOptions.of_values(self.parameters)
        progress = printed_steps()
        progress("reading the bags", 0.0)
        tests = {bag: given_tests(bag) for bag in dict.fromkeys((*given.table, *given.command))}
        table, command = ([test for bag in bags for test in tests[bag]] for bags in (given.table, given.command))
        found = self.identified(table, command, options, progress)
        for warning in found.warnings:
            self.get_logger().warning(warning)
        output = Path(given.output)
        print(write_identification(found, output))
        progress("drawing", 1.0)
        self.draw(found, output)
        progress("judging", 1.0)
        judged = judge(found)
        write_validity(judged, output)
        print(f"wrote {output}")
        print(judged.validity.text())

    def identified(
        self,
        table: list[Test],
        command: list[Test],
        options: IdentificationOptions,
        progress: Callable[[str, float], None],
    ) -> Identification:
        """The models; if identification fails because of the measurements, write the files that explain it."""
        begun = 0.0

        def noted(step: str, fraction: float) -> None:
            nonlocal begun
            begun = fraction
            progress(step, fraction)

        try:
            return identify(table, command, options, noted)
        except AbraceError as error:
            judged = judge_failure(table, command, options, error, begun)
            if judged is not None:
                write_validity(judged, Path(self.parameters.output))
                print(judged.validity.text(), flush=True)
            raise

    def draw(self, found: Identification, output: Path) -> None:
        """Draw and save the figures."""
        table, commands = found.table_response, [data.responses[0] for data in found.commands]
        outputs = found.model.outputs
        shown = most_telling(outputs)
        forces = [name for name in outputs if name.startswith("f")]
        drawings: dict[str, Figure | Chart] = {
            "figure_4_table": figures.transfer_functions(table, shown, found.model),
            "hankel_singular_values": figures.hankel_singular_values(found.reduction),
        }
        for command in commands:
            of_several = f"_{command.input}" if len(commands) > 1 else ""
            drawings[f"figure_5_command{of_several}"] = figures.transfer_functions(command, shown, found.model)
            if forces:
                drawings[f"figure_3_force{of_several}"] = figures.transfer_functions(command, forces, found.model)
        if found.covariance is not None:
            drawings["confidence"] = confidence(found.poles.pairs)
        for name, figure in drawings.items():
            save_figure(figure, output / f"{name}.svg")


def main() -> int:
    """Entry point."""
    return run(IdentifyNode)
