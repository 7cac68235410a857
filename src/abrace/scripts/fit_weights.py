"""Find the weights of `config/lqg1.yaml` to `lqg5.yaml`: LQG3 as the paper's Table 1 measured it, and four others.

The paper prints neither Q nor R, only what came of LQG3. Displacements, the acceleration of each floor and the noise
are weighed, relative to the command; stroke and force are not, as a search over them too leaves them weights that do
nothing. One weight for all accelerations leaves a mean error of 0.045, one for each floor 0.039. These five are sought
such that El Centro at 0.1 g for 100 s gives the 18 peaks and rms values of Table 1's experiment (mean absolute
relative error). Table 1 alone does not pin the controller (there are weights that meet it with 2 dB of gain margin), so
the worst cell, margins and the damping of the local modes belong to the criterion: what is missing to each requirement
adds to it.

Neither the rig's equations nor a test that is reported enter the search: the model is identified from two tests of
240 s, the controller designed with its 8 states, the earthquake simulated with the consistent model.

LQG1, LQG2, LQG4 and LQG5 are LQG3's weights, all but the command's multiplied by one factor, and for the last two with
floor 1's acceleration alone measured. The paper says of them only that LQG3's command is the larger one of the first
three. The factors give the peak commands of PEAK_COMMANDS, which are our choice: from half of LQG3's to a little more.

    PYTHONPATH=tests/support python3 src/abrace/scripts/fit_weights.py [TABLE_BAG COMMAND_BAG]

prints the weights, in SI units for the files and in the paper's, and what they give: with the model, with models from
other tests, and on the rig itself. Without bags the tests are simulated.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from laboratory import Laboratory
from scipy.optimize import brentq, minimize

from abrace_bags.run import read_run
from abrace_core.errors import AbraceError
from abrace_core.response import TABLE_1_EXPERIMENT, PeakRms, in_paper_units, mean_relative_error, peak_rms_of
from abrace_core.simulation import simulate_closed_loop
from abrace_lqg.analysis.margins import Margins, margins
from abrace_lqg.analysis.mode_damping import mode_effects
from abrace_lqg.design import ControllerDesign, design
from abrace_lqg.loop import sampled
from abrace_lqg.weights import Weights
from abrace_plant.records.files import read_record
from abrace_plant.records.treatment import Treatment, prepare
from abrace_plant.rig.file import load_rig
from abrace_sysid.identification import identify

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel
    from abrace_plant.rig.model import Rig
    from abrace_sysid.identification import Identification

RIG = Path(__file__).parents[2] / "abrace_plant" / "config" / "ncree_three_storey.yaml"
G = 9.80665
SAMPLE_PERIOD = 0.002
TEST_LENGTH = 240.0
SEED, OTHER_SEEDS = 71, (72, 73, 74)
"""Of the simulated tests; no reported test has one of them."""

START = (4.6, 7.7, 7.7, 8.2, -0.6)
"""log10 of the weights of displacements [kgf^2/cm^2] and of a1, a2, a3 [kgf^2/g^2], and of the noise's intensity."""
STEP, SEARCHES, EVALUATIONS = 0.12, 2, 220

WORST_CELL, GAIN_MARGIN, PHASE_MARGIN, DELAY_MARGIN, DAMPING_KEPT = 0.112, 9.0, 50.0, 0.018, 0.9
"""What is required, with something to spare of what LQG3 is asked for: 0.12, 8 dB, 45 degrees, 15 ms and 0.85."""
HOPELESS = 0.08
"""Mean error from which on margins are not looked at."""

FACTORS = (-2.0, 1.0)
"""log10 of the factors that are tried."""
PEAK_COMMANDS = {
    "lqg1": (("a1", "a2", "a3"), 681.0),
    "lqg2": (("a1", "a2", "a3"), 1121.0),
    "lqg4": (("a1",), 866.0),
    "lqg5": (("a1",), 1518.0),
}
"""What is measured, and the peak command under El Centro at 0.1 g [kgf]."""


class Stand(NamedTuple):
    """A model to try controllers on, sampled."""

    plant: LinearModel
    ground: NDArray[np.float64]
    capacity: NDArray[np.float64]

    def table(self, designed: ControllerDesign) -> dict[str, PeakRms]:
        """Peaks and rms values in Table 1's units."""
        found = simulate_closed_loop(self.plant, designed.controller, self.ground, self.capacity, designed.correction)
        return in_paper_units(peak_rms_of((*self.plant.outputs, *designed.controller.outputs), np.hstack(found)))


class Outcome(NamedTuple):
    """What a controller does on a stand."""

    table: dict[str, PeakRms]
    error: float
    worst: float
    margins: Margins
    kept: float

    @classmethod
    def of(cls, stand: Stand, designed: ControllerDesign, table: dict[str, PeakRms]) -> Outcome:
        """Margins and local modes beside the table."""
        error = mean_relative_error(table, TABLE_1_EXPERIMENT)
        modes = mode_effects(stand.plant, designed.controller, designed.design_model)
        return cls(
            table,
            error,
            max(abs(np.array(table[name]) / row - 1).max() for name, row in TABLE_1_EXPERIMENT.items()),
            margins(stand.plant, designed.controller),
            min(mode.damping_kept for mode in modes),
        )

    def criterion(self) -> float:
        """The mean error, and what is missing to each requirement."""
        return (
            self.error
            + max(0.0, self.worst - WORST_CELL)
            + max(0.0, GAIN_MARGIN - self.margins.gain) / 20
            + max(0.0, PHASE_MARGIN - self.margins.phase) / 100
            + max(0.0, DELAY_MARGIN - self.margins.delay) * 50
            + max(0.0, DAMPING_KEPT - self.kept)
        )

    def __str__(self) -> str:
        command, force = self.table["U"], self.table["f"]
        return (
            f"mean error {self.error:.4f}, worst cell {self.worst:.4f}, f/U {force.rms / command.rms:.3f}, "
            f"peak command {command.peak:.0f} kgf, {self.margins}, damping kept {self.kept:.3f}"
        )


def weights_of(
    unknowns: NDArray[np.float64], factor: float = 1.0, measured: tuple[str, ...] = ("a1", "a2", "a3")
) -> Weights:
    """The weights file's content, in SI units and with R = 1 / N^2."""
    displacement, *accelerations, noise = 10.0 ** np.asarray(unknowns)
    first, second, third = accelerations
    return Weights.model_validate(
        {
            "measured": list(measured),
            "weights": {
                "displacement": factor * displacement * 1e4 * G**2,  # per cm^2 to per m^2, and R per kgf^2 to per N^2
                "stroke": 0.0,
                "acceleration": factor * third,  # per g^2 to per (m/s^2)^2 and R's change cancel
                "force": 0.0,
                "command": 1.0,
            },
            "relative": {"a1": first / third, "a2": second / third},
            "noise_to_excitation": noise,
        }
    )


def simulated_tests(rig: Rig, seed: int) -> Identification:
    """The rig identified from simulated tests of white noise."""
    laboratory = Laboratory(rig, seed)
    return identify(laboratory.table_test(TEST_LENGTH), laboratory.command_test(TEST_LENGTH))


def search(model: LinearModel, stand: Stand) -> NDArray[np.float64]:
    """LQG3's unknowns, to three decimals."""

    def criterion(unknowns: NDArray[np.float64]) -> float:
        try:
            designed = design(model, weights_of(unknowns), SAMPLE_PERIOD, [stand.plant])
            table = stand.table(designed)
            error = mean_relative_error(table, TABLE_1_EXPERIMENT)
            return error if error > HOPELESS else Outcome.of(stand, designed, table).criterion()
        except AbraceError:  # no such controller
            return 10.0

    found = np.array(START)
    for _ in range(SEARCHES):
        simplex = np.vstack([found, found + STEP * np.eye(len(found))])
        options = {"maxfev": EVALUATIONS, "xatol": 0.003, "fatol": 1e-5, "initial_simplex": simplex}
        found = minimize(criterion, found, method="Nelder-Mead", options=options).x
    return found.round(3)


def factor_for(
    peak: float, measured: tuple[str, ...], unknowns: NDArray[np.float64], model: LinearModel, stand: Stand
) -> float:
    """log10 of the factor on LQG3's weights that gives a peak command, to three decimals."""

    def excess(exponent: float) -> float:
        designed = design(model, weights_of(unknowns, 10.0**exponent, measured), SAMPLE_PERIOD)
        return stand.table(designed)["U"].peak - peak

    return round(float(brentq(excess, *FACTORS, xtol=1e-4)), 3)


def main() -> None:
    """Search, and print the weights with what they give."""
    parser = argparse.ArgumentParser(description="Fit the weights of LQG1 to LQG5 on the identified model.")
    parser.add_argument("bags", nargs="*", metavar="BAG", help="table test and command test (default: simulated ones)")
    bags = parser.parse_args().bags
    if len(bags) not in (0, 2):
        parser.error(f"{len(bags)} bags, expected a table test and a command test, or none")
    rig = load_rig(RIG)
    ground = prepare(read_record("el_centro"), rig.sample_rate, Treatment(peak_acceleration=0.1 * G, duration=100.0))

    def stand_of(model: LinearModel) -> Stand:
        return Stand(sampled(model, SAMPLE_PERIOD), ground, rig.capacity)

    found = identify(*(read_run(bag) for bag in bags)) if bags else simulated_tests(rig, SEED)
    stand = stand_of(found.model)
    unknowns = search(found.reduced, stand)
    exponents = {
        name: factor_for(peak, measured, unknowns, found.reduced, stand)
        for name, (measured, peak) in PEAK_COMMANDS.items()
    }
    sets = {"lqg3": weights_of(unknowns)} | {
        name: weights_of(unknowns, 10.0**exponent, PEAK_COMMANDS[name][0]) for name, exponent in exponents.items()
    }
    print(f"log10 of LQG3's weights per cm^2, per g^2 (a1, a2, a3), and of the noise: {unknowns.tolist()}")
    print(f"log10 of the factors on them: {exponents}")
    others = [simulated_tests(rig, seed) for seed in OTHER_SEEDS]
    for name, weights in sorted(sets.items()):
        kinds = ", ".join(f"{kind} {weight:.4e}" for kind, weight in weights.weights.model_dump().items())
        relative = ", ".join(f"{signal} {weight:.4f}" for signal, weight in weights.relative.items())
        print(f"\n{name}: {kinds}; {relative}; noise_to_excitation {weights.noise_to_excitation:.4f}")
        for title, test, plant in (
            ("consistent model", found, found.model),
            ("superposed model", found, found.superposed),
            *((f"other tests {i}", other, other.model) for i, other in enumerate(others, 1)),
            ("the rig", found, rig.discrete_model()),
        ):
            trial = stand_of(plant)
            designed = design(test.reduced, weights, SAMPLE_PERIOD, [plant])
            outcome = Outcome.of(trial, designed, trial.table(designed))
            print(f"  {title}: {outcome}")
            if name == "lqg3" and title in ("consistent model", "the rig"):
                print("            peak       rms   (experiment)")
                for row, (peak, rms) in TABLE_1_EXPERIMENT.items():
                    print(
                        f"    {row:>4} {outcome.table[row].peak:9.4g} {outcome.table[row].rms:9.4g}   {peak:g} {rms:g}"
                    )


if __name__ == "__main__":
    main()
