# SPDX-License-Identifier: Apache-2.0
"""The node `ambient`: identifies modes from bags of tests without commands, and detects changes of the building.

abrace run abrace_sysid ambient --ros-args -p bag:=bags/after -p before:=bags/before -p output:=results/ambient
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from abrace_bags import read_runs
from abrace_core.drawing import save_figure
from abrace_core.errors import AbraceError
from abrace_core.files import write_text
from abrace_core.node import AbraceNode, Parameter, run
from abrace_sysid.ambient.change import BuildingChange, compare_tests
from abrace_sysid.ambient.recorded import ambient_test
from abrace_sysid.figures import ambient as figures

if TYPE_CHECKING:
    from abrace_sysid.ambient.modes import AmbientMode, AmbientTest

PARAMETERS = [
    Parameter("bag", [], "bag, or list of bags, of a test without commands", element=str, required=True),
    Parameter("before", [], "bags of an earlier test, to compare with; empty: none", element=str),
    Parameter("channels", [], "outputs to use, as a1; empty: all accelerations", element=str),
    Parameter(
        "band",
        [],
        "Hz, lowest and highest frequency of modes; empty: 0.3 to 20 times the slowest resonance, that of `before` "
        "where it is given",
        element=float,
        minimum=0.0,
    ),
    Parameter("highest_order", 40, "greatest number of poles that is tried", minimum=4, maximum=200),
    Parameter("output", "", "folder for ambient.json and figures", required=True),
]


class Ambient(AbraceNode):
    """Identifies the modes of one building, then ends."""

    def __init__(self) -> None:
        super().__init__("ambient", PARAMETERS)

    def work(self) -> None:
        """Read, identify, compare, write, draw."""
        given = self.parameters
        if len(given.band) not in (0, 2):
            raise AbraceError(f"parameter band: {given.band}, expected two frequencies in Hz")
        band = (given.band[0], given.band[1]) if given.band else None
        before = self.test(given.before, band) if given.before else None
        # both tests in one band, or a difference could be that of the bands
        found = self.test(given.bag, before.band if before else band)
        self.show(found)
        content = _as_json(found)
        drawings = {"ambient_stabilization": figures.ambient_stabilization(found)}
        if before:
            change = compare_tests(before, found)
            content["change"] = _change_as_json(before, change)
            drawings["building_change"] = figures.building_change(change)
            self.tell(change)
        output = Path(given.output)
        write_text(output / "ambient.json", json.dumps(content, indent=1) + "\n")
        for name, figure in drawings.items():
            save_figure(figure, output / f"{name}.png")
        print(f"wrote {output}")

    def test(self, bags: list[str], band: tuple[float, float] | None) -> AmbientTest:
        """Identify modes from bags, within a band [Hz]."""
        print(f"reading {', '.join(bags)}", flush=True)
        given = self.parameters
        runs = [one for bag in bags for one in read_runs(bag)]
        found, warnings = ambient_test(runs, given.channels, band, given.highest_order)
        for warning in (*(text for one in runs for text in one.facts.get("warnings", [])), *warnings):
            self.get_logger().warning(warning)
        if not found.modes:
            self.get_logger().warning(f"{found.source}: no mode from {found.band[0]:.3g} to {found.band[1]:.3g} Hz")
        return found

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
        print("the building has changed" if change.changed else "no change beyond chance")


def _as_json(found: AmbientTest) -> dict[str, Any]:
    return {
        "source": found.source,
        "seconds": found.seconds,
        "channels": list(found.channels),
        "band": list(found.band),
        "modes": [_mode_as_json(mode) for mode in found.modes],
    }


def _mode_as_json(mode: AmbientMode) -> dict[str, Any]:
    one = mode.interval
    return {
        "frequency": one.frequency,
        "damping_ratio": one.damping,
        "frequency_deviation": one.frequency_deviation,
        "damping_ratio_deviation": one.damping_deviation,
        "shape": [[value.real, value.imag] for value in mode.shape.tolist()],
        "orders": mode.orders,
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
    return run(Ambient)
