# SPDX-License-Identifier: Apache-2.0
"""The node `ambient`: identifies modes from bags of tests without commands, and detects changes of the building.

abrace run abrace_sysid ambient --ros-args -p test:=bags/after -p before:=bags/before -p output:=results/ambient
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from abrace_core.figures.saving import save_figure
from abrace_core.files.writing import write_json
from abrace_node.node import AbraceNode
from abrace_node.parameters import Parameter, parameters_of
from abrace_node.process import run
from abrace_sysid.ambient.change import compared_tests
from abrace_sysid.ambient.modes import AmbientOptions, ambient_test
from abrace_sysid.figures.ambient import ambient_stabilization
from abrace_sysid.results import PAIRS

if TYPE_CHECKING:
    from abrace_sysid.ambient.change import BuildingChange
    from abrace_sysid.ambient.modes import AmbientTest
    from abrace_sysid.recorded.test import Test

PARAMETERS = [
    Parameter("test", [], "bag or table of a test without commands, or a list", element=str, required=True),
    Parameter("before", [], "those of an earlier test, to compare with; empty: none", element=str),
    *parameters_of(AmbientOptions),
    Parameter("output", "", "folder for ambient.json and its figure", required=True),
]


class AmbientNode(AbraceNode):
    """Identifies the modes of one building, then ends."""

    def __init__(self) -> None:
        super().__init__("ambient", PARAMETERS)

    def work(self) -> None:
        """Read, identify, compare, write, draw."""
        given, options = self.parameters, AmbientOptions.of_values(self.parameters)
        before = None
        if given.before:
            found, before, change = compared_tests(
                self.read(given.test, options), self.read(given.before, options), options
            )
        else:
            found = ambient_test(self.read(given.test, options), options)
        if not found.modes:
            self.get_logger().warning(f"{found.source}: no mode from {found.band[0]:.3g} to {found.band[1]:.3g} Hz")
        self.show(found)
        content = _as_json(found)
        if before:
            content["change"] = _change_as_json(before, change)
            self.tell(change)
        output = Path(given.output)
        write_json(output / "ambient.json", content)
        save_figure(ambient_stabilization(found), output / "ambient_stabilization.svg")
        print(f"wrote {output}")

    def read(self, bags: list[str], options: AmbientOptions) -> tuple[Test, ...]:
        """Read bags and tables, and log their warnings."""
        print(f"reading {', '.join(bags)}", flush=True)
        tests = options.read(bags)
        for warning in (text for one in tests for text in one.warnings):
            self.get_logger().warning(warning)
        return tests

    def show(self, found: AmbientTest) -> None:
        """Print the modes."""
        record = f"{found.seconds:g} s of {', '.join(found.channels)}"
        band = f"{found.band[0]:.3g} to {found.band[1]:.3g} Hz"
        print(f"{len(found.modes)} modes in {record}, {band}, with 95 % intervals:")
        for mode in found.modes:
            one = mode.interval
            low, high = one.frequency_interval
            print(
                f"  {one.frequency / (2 * math.pi):8.4f} Hz ({low / (2 * math.pi):.4f} to {high / (2 * math.pi):.4f}), "
                f"damping {100 * one.damping:.3f} % ({100 * one.damping_interval[0]:.3f} to "
                f"{100 * one.damping_interval[1]:.3f})"
            )

    def tell(self, change: BuildingChange) -> None:
        """Print the change of each mode."""
        for mode in change.modes:
            print(
                f"  {mode.before.frequency / (2 * math.pi):8.4f} Hz: frequency {100 * mode.frequency_change:+.3f} %, "
                f"damping {100 * mode.damping_change:+.1f} %, shape {mode.assurance:.3f}, by chance with a "
                f"probability of {mode.probability:.2g}"
            )
        for name, modes in (("not found any more", change.gone), ("not found before", change.new)):
            for one in modes:
                print(f"  {one.frequency / (2 * math.pi):8.4f} Hz: {name}")
        print(change.words)


def _as_json(found: AmbientTest) -> dict[str, Any]:
    pairs = PAIRS.dump_python({"modes": tuple(mode.interval for mode in found.modes)}, by_alias=True)
    return {
        "source": found.source,
        "seconds": found.seconds,
        "channels": list(found.channels),
        "band": list(found.band),
        "modes": [
            pair | {"shape": [[value.real, value.imag] for value in mode.shape.tolist()], "orders": mode.orders}
            for pair, mode in zip(pairs["modes"], found.modes, strict=True)
        ],
    }


def _change_as_json(before: AmbientTest, change: BuildingChange) -> dict[str, Any]:
    return {
        "before": _as_json(before),
        "changed": bool(change.changed),
        "modes": [
            {
                "before": mode.before.frequency,
                "after": mode.after.frequency,
                "frequency_change": mode.frequency_change,
                "damping_change": mode.damping_change,
                "modal_assurance": mode.assurance,
                "probability": mode.probability,
            }
            for mode in change.modes
        ],
        "gone": [mode.frequency for mode in change.gone],
        "new": [mode.frequency for mode in change.new],
    }


def main() -> int:
    """Entry point."""
    return run(AmbientNode)
