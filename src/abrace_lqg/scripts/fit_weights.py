"""Find the weights of `config/lqg3.yaml`: LQG3 as the paper's Table 1 measured it, on the rig of `abrace_plant`.

The paper prints neither Q nor R, only what came of them. Displacements, accelerations and the noise are weighed,
relative to the command; stroke and force are not, as a search over them too leaves them negligible weights. The three
are sought such that El Centro at 0.1 g for 100 s gives the 18 peaks and rms values of Table 1's experiment (mean
absolute relative error). Table 1 alone does not pin the controller (there are weights that meet it with 2 dB of gain
margin), so margins and the damping of the rig's local modes belong to the criterion: each requirement that is not met
adds to it.

    python3 fit_weights.py

prints the weights, in SI units for the file and in the paper's, and what they give. The design model is the rig's own,
exact; sensors are left out, and saturation, which does not occur at 0.1 g.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.optimize import minimize

from abrace_core.errors import AbraceError
from abrace_core.response import TABLE_1_EXPERIMENT, PeakRms, in_paper_units, mean_relative_error, peak_rms_of
from abrace_core.simulation import simulate
from abrace_lqg.design import design
from abrace_lqg.margins import Margins, closed_loop, closed_loop_poles, margins
from abrace_lqg.weights import Weights
from abrace_plant.ground_motion import Treatment, prepare
from abrace_plant.record_files import read_record
from abrace_plant.rig_file import load_rig

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel
    from abrace_plant.rig import Rig

RIG = Path(__file__).parents[2] / "abrace_plant" / "config" / "ncree_three_storey.yaml"
G = 9.80665
START = (4.725, 8.065, -0.575)
"""log10 of the weights of displacements [kgf^2/cm^2] and accelerations [kgf^2/g^2], and of the noise's intensity."""
STEP = 0.3
EVALUATIONS = 200

WORST_CELL, GAIN_MARGIN, PHASE_MARGIN, DELAY_MARGIN, DAMPING_KEPT = 0.119, 8.0, 45.0, 0.015, 0.85
LOCAL = (50.0, 200.0)
"""rad/s: the rig's local modes."""
NEAR = 0.08
"""A closed-loop pole this near in frequency, relatively, may be the local mode."""


class Outcome(NamedTuple):
    """What a controller does on the rig."""

    table: dict[str, PeakRms]
    error: float
    worst: float
    margins: Margins
    kept: list[float]

    def criterion(self) -> float:
        """The mean error, and what is missing to each requirement."""
        return (
            self.error
            + max(0.0, self.worst - WORST_CELL)
            + max(0.0, GAIN_MARGIN - self.margins.gain) / 20
            + max(0.0, PHASE_MARGIN - self.margins.phase) / 100
            + max(0.0, DELAY_MARGIN - self.margins.delay) * 50
            + max(0.0, DAMPING_KEPT - min(self.kept))
        )


def weights_of(unknowns: NDArray[np.float64]) -> Weights:
    """The weights file's content, in SI units and with R = 1 / N^2."""
    displacement, acceleration, noise = 10.0 ** np.asarray(unknowns)
    return Weights.model_validate(
        {
            "measured": ["a1", "a2", "a3"],
            "weights": {
                "displacement": displacement * 1e4 * G**2,  # per cm^2 to per m^2, and R per kgf^2 to per N^2
                "stroke": 0.0,
                "acceleration": acceleration,  # per g^2 to per (m/s^2)^2 and R's change cancel
                "force": 0.0,
                "command": 1.0,
            },
            "noise_to_excitation": noise,
        }
    )


def outcome(rig: Rig, plant: LinearModel, weights: Weights, ground: NDArray[np.float64]) -> Outcome:
    """Design on the rig's exact model, and play the record to the rig."""
    controller = design(rig.model, weights, 1 / rig.sample_rate).controller
    loop = closed_loop(plant, controller)
    table = in_paper_units(peak_rms_of(loop.outputs, simulate(loop, ground[:, None])))
    errors = [abs(np.array(table[name]) / row - 1).max() for name, row in TABLE_1_EXPERIMENT.items()]
    kept = []
    closed = closed_loop_poles(plant, controller)
    for pole in rig.model.poles():
        if LOCAL[0] < abs(pole) < LOCAL[1] and pole.imag > 0:
            near = [damping for frequency, damping in closed if abs(frequency / abs(pole) - 1) < NEAR]
            kept.append(min(near) / (-pole.real / abs(pole)))
    error = mean_relative_error(table, TABLE_1_EXPERIMENT)
    return Outcome(table, error, float(max(errors)), margins(plant, controller), kept)


def main() -> None:
    """Search, and print the weights with what they give."""
    rig = load_rig(RIG)
    plant = rig.discrete_model()
    ground = prepare(read_record("el_centro"), rig.sample_rate, Treatment(peak_acceleration=0.1 * G, duration=100.0))

    def criterion(unknowns: NDArray[np.float64]) -> float:
        try:
            return outcome(rig, plant, weights_of(unknowns), ground).criterion()
        except AbraceError:  # no such controller
            return 10.0

    start = np.array(START)
    simplex = np.vstack([start, start + STEP * np.eye(len(start))])
    found = minimize(
        criterion,
        start,
        method="Nelder-Mead",
        options={"maxfev": EVALUATIONS, "xatol": 0.005, "fatol": 1e-5, "initial_simplex": simplex},
    ).x.round(3)
    weights = weights_of(found)
    result = outcome(rig, plant, weights, ground)
    print(f"log10 of the weights per cm^2 and per g^2, the command's 1 per kgf^2, and of the noise: {found.tolist()}")
    for kind, weight in weights.weights.model_dump().items():
        print(f"  {kind}: {weight:.4e}")
    print(f"noise_to_excitation: {weights.noise_to_excitation:.4f}")
    print(f"mean error {result.error:.4f}, worst cell {result.worst:.4f}; {result.margins}")
    print(f"local modes keep {', '.join(f'{kept:.3f}' for kept in result.kept)} of their damping")
    print("          peak       rms   (experiment)")
    for name, row in TABLE_1_EXPERIMENT.items():
        print(f"{name:>4} {result.table[name].peak:9.4g} {result.table[name].rms:9.4g}   {row.peak:g} {row.rms:g}")


if __name__ == "__main__":
    main()
