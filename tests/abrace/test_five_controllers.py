# SPDX-License-Identifier: Apache-2.0
"""LQG1 to LQG5, designed on a model identified from two tests: what the weights files promise."""

from __future__ import annotations

import importlib.util
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from identification_speed import write_bag
from laboratory import Laboratory
from scipy import linalg

from abrace_core.response import TABLE_1_EXPERIMENT, PeakRms, in_paper_units, mean_relative_error, peak_rms_of
from abrace_core.simulation import simulate_closed_loop
from abrace_lqg.analysis.margins import margins
from abrace_lqg.analysis.mode_damping import mode_effects
from abrace_lqg.design import ControllerDesign, design
from abrace_lqg.loop import closed_loop_poles, sampled
from abrace_lqg.weights import Weights, load_weights
from abrace_plant.records.files import read_record
from abrace_plant.records.treatment import Treatment, prepare
from abrace_plant.rig.file import load_rig
from abrace_sysid.identification import Identification, identify

if TYPE_CHECKING:
    from types import ModuleType

    from numpy.typing import NDArray

    from abrace_core.linear_model import LinearModel
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
def models(rig: Rig, identified: Identification) -> dict[str, LinearModel]:
    return {"consistent": identified.model, "superposed": identified.superposed, "rig": rig.model}


@pytest.fixture(scope="module")
def el_centro(rig: Rig) -> NDArray[np.float64]:
    return prepare(read_record("el_centro"), rig.sample_rate, Treatment(peak_acceleration=0.980665, duration=100.0))


@pytest.fixture(scope="module")
def tables(
    rig: Rig, designs: Designs, models: dict[str, LinearModel], el_centro: NDArray[np.float64]
) -> dict[str, dict[str, Table]]:
    """By controller and model: El Centro at 0.1 g in Table 1's rows and units."""

    def table(plant: LinearModel, designed: ControllerDesign) -> Table:
        found = simulate_closed_loop(plant, designed.controller, el_centro, rig.capacity, designed.correction)
        return in_paper_units(peak_rms_of((*plant.outputs, "U"), np.hstack(found)))

    plants = {title: sampled(model, 0.002) for title, model in models.items()}
    return {name: {title: table(plant, designs[name]) for title, plant in plants.items()} for name in NAMES}


@pytest.mark.parametrize("title", ["consistent", "rig"])
def test_lqg3_gives_table_1s_experiment(tables: dict[str, dict[str, Table]], title: str):
    table = tables["lqg3"][title]
    assert mean_relative_error(table, TABLE_1_EXPERIMENT) < 0.042
    cells = [np.abs(np.array(table[name]) / row - 1).max() for name, row in TABLE_1_EXPERIMENT.items()]
    assert max(cells) < 0.118


@pytest.mark.parametrize("title", ["consistent", "superposed", "rig"])
def test_the_force_exceeds_the_command_as_in_table_1_by_itself(tables: dict[str, dict[str, Table]], title: str):
    # f/U follows from the actuator's velocity feedback: 1.05 to 1.07 in the paper
    table = tables["lqg3"][title]
    assert 1.04 < table["f"].rms / table["U"].rms < 1.08


@pytest.mark.parametrize("title", ["consistent", "superposed", "rig"])
@pytest.mark.parametrize("name", NAMES)
def test_each_controller_keeps_its_distance_from_instability(
    designs: Designs, models: dict[str, LinearModel], name: str, title: str
):
    found = margins(models[title], designs[name].controller)
    assert found.gain > 8
    assert found.phase > 45
    assert found.delay > 0.015
    assert found.sensitivity_peak < 2


@pytest.mark.parametrize("title", ["consistent", "rig"])
@pytest.mark.parametrize("name", NAMES)
def test_no_controller_reduces_the_damping_of_a_mode_much(
    designs: Designs, models: dict[str, LinearModel], name: str, title: str
):
    effects = mode_effects(models[title], designs[name].controller, designs[name].design_model)
    local = [effect for effect in effects if effect.frequency > 50 and effect.damping < 0.1]
    np.testing.assert_allclose([effect.frequency for effect in local], [56.55, 105.28, 135.07], rtol=0.002)
    for effect in effects:
        assert effect.damping_kept > 0.85, f"mode at {effect.frequency:.1f} rad/s"


def test_lqg3_damps_the_building(designs: Designs, rig: Rig):
    building = [
        damping for frequency, damping in closed_loop_poles(rig.model, designs["lqg3"].controller) if frequency < 45
    ]
    assert min(building) > 0.18


@pytest.mark.parametrize("title", ["consistent", "rig"])
def test_peak_commands_are_those_stated_in_the_files(tables: dict[str, dict[str, Table]], title: str):
    found = [tables[name][title]["U"].peak for name in NAMES]
    np.testing.assert_allclose(found, [681, 1121, 1479, 866, 1525], rtol=0.005)


@pytest.mark.parametrize("title", ["consistent", "rig"])
def test_a_larger_command_leaves_less_response(tables: dict[str, dict[str, Table]], title: str):
    for row in ("x1", "x2", "x3", "a1", "a2", "a3"):
        one, two, three, four, five = (tables[name][title][row].rms for name in NAMES)
        assert one > two > three, row
        assert four > five, row


@pytest.mark.parametrize("title", ["consistent", "rig"])
def test_with_one_sensor_instead_of_three_a_larger_command_holds_the_floors_less(
    tables: dict[str, dict[str, Table]], title: str
):
    three, one = tables["lqg3"][title], tables["lqg5"][title]
    assert one["U"].peak > three["U"].peak
    for row in ("x1", "x2", "x3"):
        assert one[row].rms > three[row].rms, row


def test_the_models_of_both_kinds_agree_with_the_rig_in_closed_loop(tables: dict[str, dict[str, Table]]):
    for name in NAMES:
        rig = np.array(list(tables[name]["rig"].values()))
        np.testing.assert_allclose(list(tables[name]["consistent"].values()), rig, rtol=0.02)
        np.testing.assert_allclose(list(tables[name]["superposed"].values()), rig, rtol=0.05)


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


@pytest.fixture(scope="module")
def fit_weights() -> ModuleType:
    """The script that found the weights."""
    spec = importlib.util.spec_from_file_location("fit_weights", SOURCES / "abrace/scripts/fit_weights.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_script_writes_what_the_file_has(fit_weights: ModuleType):
    found, kept = fit_weights.weights_of([4.69, 7.738, 7.768, 8.211, -0.661]), weights_file("lqg3")
    signals = ["x1", "xf", "a1", "a2", "a3", "f", "U"]
    np.testing.assert_allclose(found.diagonal(signals), kept.diagonal(signals), rtol=1e-3)
    assert found.noise_to_excitation == pytest.approx(kept.noise_to_excitation, rel=1e-3)
    assert found.measured == kept.measured


def test_the_search_finds_nothing_better_next_to_lqg3(
    fit_weights: ModuleType, rig: Rig, identified: Identification, el_centro: NDArray[np.float64]
):
    trial = fit_weights.Trial(sampled(identified.model, 0.002), el_centro, rig.capacity)

    def criterion(unknowns: NDArray[np.float64]) -> float:
        designed = design(identified.reduced, fit_weights.weights_of(unknowns), 0.002)
        return fit_weights.Outcome.of(trial, designed, trial.table(designed)).criterion()

    found = np.array([4.69, 7.738, 7.768, 8.211, -0.661])
    least = criterion(found)
    for step in np.vstack([0.1 * np.eye(5), -0.1 * np.eye(5)]):
        assert criterion(found + step) > least


def test_the_search_goes_on_from_its_start_to_a_smaller_criterion(
    monkeypatch: pytest.MonkeyPatch,
    fit_weights: ModuleType,
    rig: Rig,
    identified: Identification,
    el_centro: NDArray[np.float64],
):
    trial = fit_weights.Trial(sampled(identified.model, 0.002), el_centro, rig.capacity)
    monkeypatch.setattr(fit_weights, "SEARCHES", 1)
    monkeypatch.setattr(fit_weights, "EVALUATIONS", 20)
    found = fit_weights.search(identified.reduced, trial)

    def error(unknowns: NDArray[np.float64]) -> float:
        designed = design(identified.reduced, fit_weights.weights_of(unknowns), 0.002)
        return mean_relative_error(trial.table(designed), TABLE_1_EXPERIMENT)

    assert not np.allclose(found, fit_weights.START), "expected a step from the start"
    assert error(found) < 0.05, "expected weights near LQG3's"


def test_the_script_runs_from_two_bags_to_the_weights_of_all_five(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    fit_weights: ModuleType,
    rig: Rig,
):
    """With a shorter search, shorter tests and one other seed: every call of it."""
    for name, value in {"SEARCHES": 1, "EVALUATIONS": 8, "TEST_LENGTH": 60.0, "OTHER_SEEDS": (72,)}.items():
        monkeypatch.setattr(fit_weights, name, value)
    laboratory = Laboratory(rig, SEED)
    bags = [tmp_path / "table", tmp_path / "command"]
    for bag, test in zip(bags, (laboratory.table_test(60), laboratory.command_test(60)), strict=True):
        write_bag(bag, test, rig.name)
    monkeypatch.setattr("sys.argv", ["fit_weights.py", *map(str, bags)])
    fit_weights.main()
    said = capsys.readouterr().out
    for name in NAMES:
        assert f"\n{name}: displacement " in said
    for title in ("consistent model", "superposed model", "other tests 1", "the rig"):
        assert said.count(f"  {title}: mean error 0.") == len(NAMES), title
    assert "damping kept" in said
    for half in ("peak", "rms"):
        assert f"fitted to the column {half} alone: [" in said


def test_the_script_asks_for_two_bags_or_none(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], fit_weights: ModuleType
):
    monkeypatch.setattr("sys.argv", ["fit_weights.py", "one"])
    with pytest.raises(SystemExit, match="2"):
        fit_weights.main()
    assert "1 bags, expected a table test and a command test, or none" in capsys.readouterr().err


def test_the_gain_margin_is_where_the_rig_becomes_unstable(rig: Rig, designs: Designs):
    controller = designs["lqg3"].controller
    edge = 10 ** (margins(rig.model, controller).gain / 20)

    def least_damping(factor: float) -> float:
        law = replace(controller, c=factor * controller.c, d=factor * controller.d)
        return min(damping for _, damping in closed_loop_poles(rig.model, law))

    assert least_damping(0.999 * edge) > 0
    assert least_damping(1.001 * edge) < 0


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
