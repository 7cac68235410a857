# SPDX-License-Identifier: Apache-2.0
"""The node `identify`: identifies models from bags of table and command tests, or from measured data, with figures.

abrace run abrace_sysid identify --ros-args -p table:=table_noise -p command:=command_noise -p output:=model
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, get_args

from abrace_bags import read_runs
from abrace_core.drawing import save_figure
from abrace_core.errors import AbraceError
from abrace_core.linear_model import save_model
from abrace_core.node import AbraceNode, Parameter, run
from abrace_sysid.data_identification import DataOptions, identify_data
from abrace_sysid.data_results import write_data_results
from abrace_sysid.figures import identification as figures
from abrace_sysid.figures.data import figures_of_data
from abrace_sysid.figures.poles import confidence
from abrace_sysid.fitting.options import FIT_METHODS, IdentificationOptions
from abrace_sysid.fitting.stabilization import stabilization
from abrace_sysid.identification import Identification, identify
from abrace_sysid.identification_results import write_identification
from abrace_sysid.measured_data import DataHold, read_data, units_of
from abrace_sysid.models.reduction import errors_by_order
from abrace_sysid.nonlinear.identified import elements_of_tests
from abrace_sysid.spectra.estimation import Method, TransferFunctionOptions
from abrace_sysid.spectra.welch import Estimator
from abrace_sysid.validity.data_judgement import judge_data
from abrace_sysid.validity.judgement import judge, judge_failure
from abrace_sysid.validity_results import write_validity

if TYPE_CHECKING:
    from collections.abc import Callable

    from abrace_core.run import Run

DEFAULTS = IdentificationOptions()
METHOD = DEFAULTS.transfer_function
TRANSFER_FUNCTION = ("method", "segment", "window", "overlap", "estimator", "order", "half_width")

PARAMETERS = [
    Parameter("table", [], "bag, or list of bags, of tests with noise or a multisine on the table", element=str),
    Parameter(
        "command", [], "the same for tests with commands; the same bags if both were excited at once", element=str
    ),
    Parameter("output", "", "folder for models, poles and figures", required=True),
    Parameter("fit", DEFAULTS.fit, "how poles are fitted", choices=FIT_METHODS),
    Parameter("method", METHOD.method, "how transfer functions are estimated", choices=get_args(Method)),
    Parameter(
        "segment", METHOD.segment, "samples of a segment in Welch's method; 0: from the record's length", minimum=0
    ),
    Parameter("window", METHOD.window, "window of Welch's method, by SciPy's name"),
    Parameter(
        "overlap", METHOD.overlap, "overlap of segments in Welch's method, as a share", minimum=0.0, maximum=0.99
    ),
    Parameter("estimator", METHOD.estimator, "estimator of Welch's method", choices=get_args(Estimator)),
    Parameter("order", METHOD.order, "order of the local methods' polynomials; 0: 2 rational, 4 polynomial", minimum=0),
    Parameter(
        "half_width", METHOD.half_width, "lines on each side in the local methods; 0: from the record", minimum=0
    ),
    Parameter(
        "table_band",
        list(DEFAULTS.table_band),
        "Hz, band used of the table's tests; 0, 0: as excited",
        minimum=0.0,
    ),
    Parameter(
        "command_band",
        list(DEFAULTS.command_band),
        "Hz, band used of the commands' tests; 0, 0: as excited",
        minimum=0.0,
    ),
    Parameter(
        "command_order",
        DEFAULTS.command_order,
        "number of oscillating poles in the commands' tests; 0: found from the tests",
        minimum=0,
    ),
    Parameter("servo_lag", DEFAULTS.servo_lag, "s, lag of the actuators in a bench test; 0: no such test", minimum=0.0),
    Parameter(
        "reduced_order", DEFAULTS.reduced_order, "states of the reduced model; 0: from singular values", minimum=0
    ),
    Parameter("data", "", "file of measured data (.mat, .csv, .npz, .npy) in place of bags"),
    Parameter("inputs", [], "names of the input columns of data", element=str),
    Parameter("outputs", [], "names of the output columns of data; empty: all others", element=str),
    Parameter("sample_rate", 0.0, "Hz, sample rate of data without a time column", minimum=0.0),
    Parameter("time", "", "name of the column of data with times in s"),
    Parameter("units", [], "NAME=UNIT of columns of data, for figures", element=str),
    Parameter("hold", "band", "inputs of data: band-limited, or held between samples", choices=get_args(DataHold)),
    Parameter("band", [], "Hz, band of data; empty: 10 / duration to half the sample rate", element=float, minimum=0.0),
    Parameter("held_out", 0.0, "share at the end of data that is held out for prediction", minimum=0.0, maximum=0.8),
    Parameter("stabilization", False, "also draw stabilisation diagrams of both tests"),
    Parameter("mat", False, "also write the models as MATLAB files"),
]


class Identify(AbraceNode):
    """Identifies one rig or structure, then ends."""

    def __init__(self) -> None:
        super().__init__("identify", PARAMETERS)

    def work(self) -> None:
        """Identify from bags or from measured data."""
        given = self.parameters
        begin = time.monotonic()

        def progress(step: str, fraction: float) -> None:
            print(f"{fraction:4.0%} {step} ({time.monotonic() - begin:.1f} s)", flush=True)

        bags = {"table": given.table, "command": given.command}
        if given.data:
            for name, value in bags.items():
                if value:
                    raise AbraceError(f"parameter {name}: {value}, expected none together with data {given.data}")
            self.from_data(progress)
            return
        for name, value in bags.items():
            if not any(value):
                raise AbraceError(f"parameter {name}: {value}, expected a bag or a list of bags, or data")
        self.from_bags(progress)

    def from_data(self, progress: Callable[[str, float], None]) -> None:
        """Read the data, identify, write, draw, and judge by predicting the part held out."""
        given = self.parameters
        progress("reading the data", 0.0)
        units = units_of(given.units)
        named = (list(filter(None, given.inputs)), list(filter(None, given.outputs)))
        data = read_data(given.data, *named, given.sample_rate, given.time, units, given.hold)
        options = DataOptions(
            band=_band("band", given.band) if given.band else None,
            transfer_function=TransferFunctionOptions(**{name: getattr(given, name) for name in TRANSFER_FUNCTION}),
        )
        kept = round((1 - given.held_out) * len(data.outputs))
        used, held_out = data.part(0, kept), data.part(kept, len(data.outputs))
        found = identify_data(used, options, progress)
        for warning in found.warnings:
            self.get_logger().warning(warning)
        print(write_data_results(found, held_out, Path(given.output), given.mat))
        progress("drawing", 1.0)
        for name, figure in figures_of_data(found).items():
            save_figure(figure, Path(given.output) / f"{name}.png")
        judged = judge_data(used, found, held_out)
        write_validity(judged, Path(given.output))
        print(f"wrote {given.output}")
        print(judged.validity.text())

    def from_bags(self, progress: Callable[[str, float], None]) -> None:
        """Read the bags, identify, write, draw and judge."""
        given = self.parameters
        progress("reading the bags", 0.0)
        runs = {bag: read_runs(bag) for bag in dict.fromkeys((*given.table, *given.command))}
        for recorded in runs.values():
            for warning in recorded[0].facts.get("warnings", []):
                self.get_logger().warning(warning)
        options = IdentificationOptions(
            transfer_function=TransferFunctionOptions(**{name: getattr(given, name) for name in TRANSFER_FUNCTION}),
            fit=given.fit,
            table_band=_band("table_band", given.table_band),
            command_band=_band("command_band", given.command_band),
            command_order=given.command_order,
            servo_lag=given.servo_lag,
            reduced_order=given.reduced_order,
        )
        table, command = ([run for bag in bags for run in runs[bag]] for bags in (given.table, given.command))
        found = self.identified(table, command, options, progress)
        options = options.of_tests(table, command)
        for warning in found.warnings:
            self.get_logger().warning(warning)
        output = Path(given.output)
        print(write_identification(found, output, given.mat))
        progress("drawing", 1.0)
        self.draw(found, options, output)
        progress("judging", 1.0)
        judged = judge(table, command, options, found)
        write_validity(judged, output)
        of_tests = elements_of_tests(found, options, judged.validity.causes)
        if of_tests is not None:
            save_model(of_tests.noted_in(found.model), output / "model.json", found.covariance)
            print(f"predictions add to the linear model: {of_tests.text}")
        print(f"wrote {output}")
        print(judged.validity.text())

    def identified(
        self,
        table: list[Run],
        command: list[Run],
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

    def draw(self, found: Identification, options: IdentificationOptions, output: Path) -> None:
        """Draw and save the figures."""
        table, commands = found.table_response, [data.responses[0] for data in found.commands]
        outputs = found.model.outputs
        floors = [name for name in outputs if name[0] == "x" and name[1:].isdigit()]
        accelerations = [name for name in outputs if name[0] == "a"]
        shown = floors[-1:] + accelerations[:1] or list(outputs[:1])
        forces = [name for name in outputs if name.startswith("f")]
        drawings = {
            "figure_4_table": figures.transfer_functions(table, shown, found.model),
            "residuals": figures.residuals([table, *commands], found.model),
            "hankel_singular_values": figures.hankel_singular_values(found.hankel_singular_values, found.reduced.order),
            "reduction_errors": figures.reduction_errors(
                errors_by_order(found.whole, found.scales, options.command_band),
                found.reduced.order,
                found.whole.inputs,
            ),
        }
        for command in commands:
            of_several = f"_{command.input}" if len(commands) > 1 else ""
            drawings[f"figure_5_command{of_several}"] = figures.transfer_functions(command, shown, found.model)
            if forces:
                drawings[f"figure_3_force{of_several}"] = figures.transfer_functions(command, forces, found.model)
        if options.fit == "maximum_likelihood":
            drawings["confidence"] = confidence(
                {
                    "table test": found.poles.table_pairs,
                    "command test": found.poles.command_pairs,
                    "both tests": found.poles.common_pairs,
                }
            )
        if self.parameters.stabilization:
            for name, response in (("table", table), *(("command", one) for one in commands[:1])):
                marked = [pair.frequency for pair in found.poles.common_pairs]
                drawings[f"stabilization_{name}"] = figures.stabilization_diagram(stabilization(response), marked)
        for name, figure in drawings.items():
            save_figure(figure, output / f"{name}.png")


def _band(name: str, value: list[float]) -> tuple[float, float]:
    if len(value) != 2:
        raise AbraceError(f"parameter {name}: {value}, expected two frequencies in Hz")
    return value[0], value[1]


def main() -> int:
    """Entry point."""
    return run(Identify)
