# SPDX-License-Identifier: Apache-2.0
"""LQG1 to LQG5, designed on a model identified from two tests: what the weights files promise."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import fit_weights
import numpy as np
import pytest
from laboratory import Laboratory
from scipy import linalg

from abrace_core.model.response import PeakRms, in_paper_units, peak_rms_of
from abrace_core.model.simulation import simulate_closed_loop
from abrace_lqg.analysis.margins import margins
from abrace_lqg.analysis.mode_damping import mode_effects
from abrace_lqg.design import ControllerDesign, design
from abrace_lqg.loop import sampled
from abrace_lqg.weights import Weights, load_weights
from abrace_plant.records.files import read_record
from abrace_plant.records.options import Treatment
from abrace_plant.records.treatment import prepare
from abrace_plant.rig.file import load_rig
from abrace_sysid.identification import Identification, identify

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from abrace_plant.rig.model import Rig

SOURCES = Path(__file__).parents[2] / "src"
NAMES = ("lqg1", "lqg2", "lqg3", "lqg4", "lqg5")
SEED = 75
"""Of tests that the weights were not fitted to."""

Designs = dict[str, ControllerDesign]
Table = dict[str, PeakRms]


def weights_file(name: str) -> Weights:
    return load_weights(SOURCES / f"abrace_lqg/config/{name}.yaml")


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig(SOURCES / "abrace_plant/config/ncree_three_storey.yaml")


@pytest.fixture(scope="module")
def identified(rig: Rig) -> Identification:
    laboratory = Laboratory(rig, SEED)
    return identify(laboratory.table_test(240), laboratory.command_test(240))


@pytest.fixture(scope="module")
def designs(identified: Identification) -> Designs:
    return {name: design(identified.reduced, weights_file(name), 0.002) for name in NAMES}


@pytest.fixture(scope="module")
def el_centro(rig: Rig) -> NDArray[np.float64]:
    return prepare(read_record("el_centro"), rig.sample_rate, Treatment(peak_acceleration=0.980665, duration=100.0))


@pytest.fixture(scope="module")
def tables(rig: Rig, designs: Designs, el_centro: NDArray[np.float64]) -> dict[str, Table]:
    """By controller: El Centro at 0.1 g on the rig in Table 1's rows and units."""

    def table(designed: ControllerDesign) -> Table:
        found = simulate_closed_loop(plant, designed.controller, el_centro, rig.capacity, designed.correction)
        return in_paper_units(peak_rms_of((*plant.outputs, "U"), np.hstack(found)))

    plant = sampled(rig.model, 0.002)
    return {name: table(designed) for name, designed in designs.items()}


@pytest.mark.parametrize("name", NAMES)
def test_each_controller_keeps_its_distance_from_instability(rig: Rig, designs: Designs, name: str):
    found = margins(rig.model, designs[name].controller)
    assert found.gain_db > 8
    assert found.phase_deg > 45
    assert found.delay > 0.015
    assert found.sensitivity_peak < 2


@pytest.mark.parametrize("name", NAMES)
def test_no_controller_reduces_the_damping_of_a_mode_much(rig: Rig, designs: Designs, name: str):
    effects = mode_effects(rig.model, designs[name].controller, designs[name].design_model)
    local = [effect for effect in effects if effect.frequency > 50 and effect.damping < 0.1]
    np.testing.assert_allclose([effect.frequency for effect in local], [56.55, 105.28, 135.07], rtol=0.002)
    for effect in effects:
        assert effect.damping_kept > 0.85, f"mode at {effect.frequency:.1f} rad/s"


def test_peak_commands_are_those_stated_in_the_files(tables: dict[str, Table]):
    found = [tables[name]["U"].peak for name in NAMES]
    np.testing.assert_allclose(found, [681, 1121, 1479, 866, 1525], rtol=0.005)


def test_a_larger_command_leaves_less_response(tables: dict[str, Table]):
    for row in ("x1", "x2", "x3", "a1", "a2", "a3"):
        one, two, three, four, five = (tables[name][row].rms for name in NAMES)
        assert one > two > three, row
        assert four > five, row


def test_with_one_sensor_instead_of_three_a_larger_command_holds_the_floors_less(tables: dict[str, Table]):
    three, one = tables["lqg3"], tables["lqg5"]
    assert one["U"].peak > three["U"].peak
    for row in ("x1", "x2", "x3"):
        assert one[row].rms > three[row].rms, row


def test_the_other_four_weigh_as_lqg3_but_for_one_factor():
    strongest = weights_file("lqg3")
    signals = ["x1", "x2", "x3", "xf", "a1", "a2", "a3", "f"]
    for name, exponent in (("lqg1", -1.215), ("lqg2", -0.384), ("lqg4", -0.737), ("lqg5", 0.029)):
        weights = weights_file(name)
        expected = 10**exponent * strongest.diagonal(signals)
        np.testing.assert_allclose(weights.diagonal(signals), expected, rtol=1e-3)
        assert weights.diagonal(["U"]) == strongest.diagonal(["U"])
        assert weights.noise_to_excitation == strongest.noise_to_excitation
        assert weights.measured == (["a1", "a2", "a3"] if name in ("lqg1", "lqg2") else ["a1"])


def test_the_script_writes_what_the_file_has():
    found, kept = fit_weights.weights_of([4.69, 7.738, 7.768, 8.211, -0.661]), weights_file("lqg3")
    signals = ["x1", "xf", "a1", "a2", "a3", "f", "U"]
    np.testing.assert_allclose(found.diagonal(signals), kept.diagonal(signals), rtol=1e-3)
    assert found.noise_to_excitation == pytest.approx(kept.noise_to_excitation, rel=1e-3)
    assert found.measured == kept.measured


def test_no_single_weight_of_lqg3_that_is_a_quarter_greater_or_smaller_is_better(
    rig: Rig, identified: Identification, el_centro: NDArray[np.float64]
):
    trial = fit_weights.Trial(sampled(identified.model, 0.002), el_centro, rig.capacity)

    def criterion(unknowns: NDArray[np.float64]) -> float:
        designed = design(identified.reduced, fit_weights.weights_of(unknowns), 0.002)
        return fit_weights.Outcome.of(trial, designed, trial.table(designed)).criterion()

    found = np.array([4.69, 7.738, 7.768, 8.211, -0.661])
    least = criterion(found)
    for step in np.vstack([0.1 * np.eye(5), -0.1 * np.eye(5)]):
        assert criterion(found + step) > least


def test_the_script_asks_for_two_bags_or_none(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.setattr("sys.argv", ["fit_weights.py", "one"])
    with pytest.raises(SystemExit, match="2"):
        fit_weights.main()
    assert "1 bags, expected a table test and a command test, or none" in capsys.readouterr().err


def test_the_riccati_equations_of_the_rig_are_solved_in_si_units(rig: Rig):
    exact = design(rig.model, weights_file("lqg3"), 0.002)
    plant, gain = exact.design_model, exact.regulator_gain
    # the optimal cost-to-go of this gain, from a Lyapunov equation, gives the gain back
    q, b = np.diag(exact.weights.diagonal(plant.outputs)), plant.b[:, 1:]
    d = plant.d[:, 1:]
    r = exact.weights.diagonal(["U"]) + d.T @ q @ d
    cross = plant.c.T @ q @ d
    closed = plant.a - b @ gain
    cost = plant.c.T @ q @ plant.c - cross @ gain - gain.T @ cross.T + gain.T @ r @ gain
    solution = linalg.solve_continuous_lyapunov(closed.T, -cost)
    again = np.linalg.solve(r, b.T @ solution + cross.T)
    assert np.linalg.norm(again - gain) < 1e-6 * np.linalg.norm(gain)
