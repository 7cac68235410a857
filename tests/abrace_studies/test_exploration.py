# SPDX-License-Identifier: Apache-2.0
"""Exploration: sets of weights, what becomes of each, the files, the figure."""

from __future__ import annotations

import csv
import io
import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from abrace_core import AbraceError
from abrace_core.model.controller_file import load_controller
from abrace_core.model.discretization import discretize
from abrace_core.model.linear_model import LinearModel
from abrace_core.model.response import PeakRms
from abrace_core.model.simulation import simulate, simulate_closed_loop
from abrace_lqg.analysis.margins import Margins
from abrace_lqg.analysis.prediction import Excitation
from abrace_lqg.design import design
from abrace_lqg.scaling import scaled_weights
from abrace_lqg.weights import KindWeights, Weights, load_weights
from abrace_plant.rig.file import load_rig
from abrace_studies.exploration.explored import explore
from abrace_studies.exploration.files import load_set, save_exploration, write_set
from abrace_studies.exploration.report import pareto_front, ranked, report
from abrace_studies.exploration.study import Outcome, Study, evaluate
from abrace_studies.exploration.weight_sets import weight_sets
from abrace_studies.fragility.study import Fault
from abrace_studies.ground_motions import GroundMotion, noise_motion
from abrace_studies.options import ExploreOptions

PERIOD = 0.01
MASS, CAPACITY = 1000.0, np.array([2000.0])
SPANS = {"displacement": (-2.0, 1.0), "noise_to_excitation": (-1.0, 1.0)}


def storey(sign: float = 1.0) -> LinearModel:
    """One storey of 1 t, 8 rad/s, 1 %, the command an ideal force; `sign` -1: the brace mounted the wrong way."""
    a = np.array([[0.0, 1.0], [-64.0, -0.16]])
    b = np.array([[0.0, 0.0], [-1.0, sign / MASS]])
    c = np.array([[1.0, 0.0], [-64.0, -0.16], [0.0, 0.0]])
    d = np.array([[0.0, 0.0], [0.0, sign / MASS], [0.0, 1.0]])
    return LinearModel(a, b, c, d, ("w", "U"), ("x1", "a1", "f"))


def given(displacement: float = 1e11) -> Weights:
    kinds = KindWeights(displacement=displacement, stroke=0.0, acceleration=0.0, force=0.0, command=1.0)
    return Weights(measured=["a1"], weights=kinds, noise_to_excitation=0.1)


def records() -> list[GroundMotion]:
    return [noise_motion(seed, 20.0, (0.2, 8.0), PERIOD).scaled(1.0) for seed in (1, 2)]


def study(simulation_model: LinearModel | None = None, **changes: object) -> Study:
    models = [simulation_model or storey()]
    parts = {"simulation_models": models, "intensities": [1.0], "capacity": CAPACITY, "sample_period": PERIOD}
    return Study.of(storey(), records=records(), **parts | changes)


@pytest.fixture(scope="module")
def outcomes() -> list[Outcome]:
    """Of 24 sets, one of them refused."""
    found = [evaluate(study(), number, each) for number, each in enumerate(weight_sets(given(), SPANS, 23, 0))]
    return [*found, evaluate(study(storey(-1.0)), 24, given())]


def test_sets_lie_in_their_spans_and_the_given_one_comes_first():
    sets = weight_sets(given(), SPANS, 100, 3)
    assert len(sets) == 101
    assert sets[0] == given()
    for name, values in (
        ("displacement", [each.weights.displacement / 1e11 for each in sets[1:]]),
        ("noise_to_excitation", [each.noise_to_excitation / 0.1 for each in sets[1:]]),
    ):
        low, high = SPANS[name]
        powers = np.log10(values)
        assert low <= powers.min() < low + 0.1 * (high - low), name
        assert high >= powers.max() > high - 0.1 * (high - low), name
        counts = np.histogram(powers, 4, (low, high))[0]
        assert counts.min() >= 23, f"{name}: expected about 25 of 100 in each quarter, found {counts}"
    assert {(each.weights.command, each.weights.stroke, *each.measured) for each in sets} == {(1.0, 0.0, "a1")}


def test_the_first_sets_are_the_same_however_many_there_are_and_others_with_another_seed():
    many = weight_sets(given(), SPANS, 40, 7)
    assert weight_sets(given(), SPANS, 5, 7) == many[:6]
    assert weight_sets(given(), SPANS, 1, 7) == many[:2]
    assert weight_sets(given(), SPANS, 40, 8)[1:] != many[1:]


@pytest.mark.parametrize(
    ("spans", "expected"),
    [
        ({"stroke": (-1.0, 1.0)}, "span of stroke: the weight is given as 0"),
        ({"displacement": (1.0, -1.0)}, "lower power of ten first"),
        ({"displacements": (-1.0, 1.0)}, "no such weight, expected one of .*, did you mean displacement?"),
        ({"displacement": (0.0, 0.0)}, "all are from 0 to 0"),
    ],
)
def test_spans_that_vary_nothing_or_have_wrong_bounds_are_refused(spans, expected):
    with pytest.raises(AbraceError, match=expected):
        weight_sets(given(), spans, 4, 0)


def test_weights_by_name_have_a_span_each_and_kinds_without_weight_none():
    by_name = Weights.model_validate(
        {"measured": ["acc 2"], "signals": {"laser": 1e8, "acc 2": 0.0, "shaker": 4.0}, "noise_to_excitation": 0.1}
    )
    spans = ExploreOptions(signals=(-1.0, 2.0)).spans(by_name, ["acc 2", "laser"])
    assert spans == {"noise_to_excitation": (-1.0, 1.0), "signals.laser": (-1.0, 2.0)}
    first, *others = weight_sets(by_name, spans, 40, 1)
    assert first == by_name
    factors = np.log10([one.signals["laser"] / 1e8 for one in others])
    assert -1.0 <= factors.min() < -0.8
    assert 1.8 < factors.max() <= 2.0
    assert all(one.signals["shaker"] == 4.0 and one.weights == by_name.weights for one in others)
    asked = ExploreOptions(displacement=(-1.0, 0.0)).spans(by_name, ["laser"])
    with pytest.raises(AbraceError, match="span of displacement: the weight is given as 0"):
        weight_sets(by_name, asked, 4, 1)
    assert set(ExploreOptions().spans(given(), ["x1"])) == {*KindWeights.model_fields, "noise_to_excitation"} - {
        "command"
    }


def test_an_outcome_is_what_the_simulated_loop_does():
    tried = study(capacity=np.array([300.0]))
    outcome = evaluate(tried, 5, given())
    designed = design(storey(), given(), PERIOD)
    saturated, ratios, squares = 0, [], []
    for record in records():
        z, u = simulate_closed_loop(
            tried.plant, designed.controller, record.ground_acceleration, np.array([300.0]), designed.correction
        )
        free = simulate(tried.plant.select(inputs=["w"]), record.ground_acceleration[:, None])
        rms = np.sqrt(np.mean(z[:, 0] ** 2) / np.mean(free[:, 0] ** 2))
        ratios.append((np.abs(z[:, 0]).max() / np.abs(free[:, 0]).max(), rms))
        saturated += np.count_nonzero(np.abs(u) >= 300.0)
        squares.append(np.mean(u**2))
    assert outcome.saturated == saturated > 0
    assert outcome.relative["x1"] == pytest.approx(np.mean(ratios, axis=0), rel=1e-9)
    assert outcome.relative["x1"].rms < 0.7, "the controller should have reduced the drift"
    assert outcome.command == pytest.approx((300.0, np.sqrt(np.mean(squares))), rel=1e-9)
    assert outcome.robust["displacement"] == pytest.approx(max(rms for _, rms in ratios), rel=1e-9)
    assert "f" not in outcome.relative, "an ideal force is zero with a zero command: no ratio"


def softer(share: float) -> LinearModel:
    """The storey with another stiffness."""
    return replace(storey(), a=np.array([[0.0, 1.0], [-64.0 * share, -0.16]]))


def test_the_robust_response_is_the_quantile_over_models_intensities_faults_and_records():
    uncertain = study(
        simulation_models=[storey(), softer(0.8), softer(1.25)],
        intensities=[0.5, 4.0],
        faults=[Fault("a1", 0.0), Fault("a1", 1.2)],
        capacity=np.array([1200.0]),
        quantile=0.75,
    )
    outcome = evaluate(uncertain, 1, given())
    assert outcome.loops == uncertain.count == 3 * 2 * 3 * 2
    designed = design(storey(), given(), PERIOD)
    ratios = []
    for model, factor, level, record in itertools.product(
        uncertain.loops.models, (1.0, 0.0, 1.2), (0.5, 4.0), records()
    ):
        plant, ground = discretize(model, PERIOD), level * record.ground_acceleration
        law = replace(designed.controller, b=factor * designed.controller.b, d=factor * designed.controller.d)
        z, _ = simulate_closed_loop(plant, law, ground, np.array([1200.0]), designed.correction)
        free = simulate(plant.select(inputs=["w"]), ground[:, None])
        ratios.append(np.sqrt(np.mean(z[:, 0] ** 2) / np.mean(free[:, 0] ** 2)))
    assert outcome.robust["displacement"] == pytest.approx(sorted(ratios)[26], rel=1e-9), "27 of 36 respond no more"
    worst = evaluate(replace(uncertain, quantile=1.0), 1, given())
    assert worst.robust["displacement"] == pytest.approx(max(ratios), rel=1e-9)
    nominal = evaluate(study(intensities=[0.5, 4.0], capacity=np.array([1200.0])), 1, given())
    assert outcome.relative == nominal.relative, "of the simulation model itself, with intact sensors"


def test_sets_are_ranked_by_their_robust_response_among_those_of_no_more_force(outcomes):
    order = ranked(outcomes)
    limit = outcomes[0].command.rms
    cheap = [one for one in outcomes if one.command and one.command.rms <= limit]
    firm = [
        one for one in cheap if one.margins.gain_db >= 6 and one.margins.phase_deg >= 30 and one.margins.delay >= 0.004
    ]
    assert {one.number for one in order} == {one.number for one in firm}
    assert [one.robust_response for one in order] == sorted(one.robust_response for one in order)
    assert 0 < len(firm) < len(cheap) < len(outcomes) - 1, "some sets should take more force, some have less margin"
    weak = replace(outcomes[0], command=PeakRms(2.0, 1.0))
    refused = replace(outcomes[0], command=None, refused="why")
    assert not ranked([weak, *outcomes[1:]]), "all take more force"
    assert ranked([refused, *outcomes[1:]]), "any force is allowed"


def test_a_loop_that_is_unstable_with_the_simulation_model_is_kept_with_its_reason():
    outcome = evaluate(study(storey(-1.0)), 3, given())
    assert "not stable" in outcome.refused
    assert outcome.command is None
    assert any(
        "1 of 2 sets gave no controller" in line for line in report([evaluate(study(), 0, given()), outcome], 0.9)
    )


def test_outcomes_do_not_depend_on_the_way_they_are_computed_nor_on_what_was_done_before(tmp_path):
    sets = weight_sets(given(), SPANS, 10, 0)
    serial = [evaluate(study(), number, weights) for number, weights in enumerate(sets)]
    progress: list[int] = []
    parallel = explore(study(), sets, tmp_path / "own", workers=2, progress=progress.append)
    assert [outcome.number for outcome in parallel] == list(range(11))
    assert parallel == serial
    assert explore(study(), sets, tmp_path / "own", scheduler="nothing") == serial, "nothing was left to compute"
    assert progress == sorted(progress)
    assert progress[-1] == 11


def test_what_is_wrong_in_a_batch_is_raised_as_it_is_said_there(tmp_path):
    with pytest.raises(AbraceError, match="fault a7=0: no controller measures a7, expected one of a1"):
        explore(study(faults=[Fault("a7", 0.0)]), [given()] * 2, tmp_path / "none", workers=2)
    with pytest.raises(AbraceError, match="weights: measured: a7, expected some of x1, a1, f"):
        explore(study(), [given().model_copy(update={"measured": ["a7"]})], tmp_path / "none")


def test_the_pareto_front_has_the_points_that_no_other_beats_in_both():
    force, response = np.random.default_rng(1).uniform(size=(2, 300))
    beaten = ((force[:, None] >= force) & (response[:, None] >= response)).sum(axis=1) > 1
    front = pareto_front(force, response)
    assert set(front) == set(np.flatnonzero(~beaten))
    assert np.all(np.diff(force[front]) > 0)


def test_a_motion_is_scaled_to_a_peak_and_has_to_move():
    ground = np.array([0.0, 0.5, -2.0, 1.0])
    assert GroundMotion("quake", ground).scaled(0.5).ground_acceleration == pytest.approx(ground / 4)
    with pytest.raises(AbraceError, match="record quake: the ground does not move, expected an earthquake"):
        GroundMotion("quake", 0 * ground).scaled(0.5)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"records": []}, "no records"),
        ({"capacity": np.array([1.0, 2.0])}, "2 force limits"),
        ({"simulation_models": [storey().select(("x1", "f"))]}, "expected those of the design model"),
        ({"quantile": 0.0}, "quantile 0, expected a share of the loops above 0, up to 1"),
        ({"intensities": [2.0, 1.0]}, "expected numbers above 0 that rise"),
    ],
)
def test_a_study_whose_parts_do_not_fit_is_refused(change, expected):
    parts = {"model": storey(), "simulation_models": [storey()], "records": records(), "capacity": CAPACITY}
    with pytest.raises(AbraceError, match=expected):
        Study.of(**parts | {"intensities": [1.0]} | change, sample_period=PERIOD)


def test_a_set_is_written_as_weights_and_as_the_controller_that_was_tried(outcomes, tmp_path):
    save_exploration(tmp_path, study(), outcomes, (storey(), storey()), {"seed": 0})
    rows = list(csv.DictReader(io.StringIO((tmp_path / "exploration.csv").read_text())))
    assert [int(row["set"]) for row in rows] == list(range(25))
    assert float(rows[3]["x1_rms"]) == outcomes[3].relative["x1"].rms
    assert float(rows[3]["delay_margin_ms"]) == 1e3 * outcomes[3].margins.delay
    assert "not stable" in rows[24]["refused"]
    assert rows[24]["x1_rms"] == rows[24]["rank"] == ""
    assert float(rows[3]["robust_displacement"]) == outcomes[3].robust["displacement"]
    assert next(int(row["set"]) for row in rows if row["rank"] == "1") == ranked(outcomes)[0].number

    with pytest.raises(AbraceError, match="design refused: gain margin 5"):
        write_set(tmp_path, 7)
    assert [path.name for path in tmp_path.glob("set_7*")] == ["set_7_weights.yaml"], "for `design`, with its limits"
    _, files = write_set(tmp_path, 6)
    assert load_weights(tmp_path / "set_6_weights.yaml") == outcomes[6].weights
    controller = load_controller(tmp_path / "set_6.yaml")
    again = design(storey(), outcomes[6].weights, PERIOD)
    assert controller.law.a == pytest.approx(again.controller.a, rel=1e-12, abs=1e-15)
    assert controller.force_limit.tolist() == CAPACITY.tolist()
    assert all(path.is_file() for path in files)
    with pytest.raises(AbraceError, match="set 24 gives no controller"):
        load_set(tmp_path, 24)
    with pytest.raises(AbraceError, match="no set 25, expected 0 to 24"):
        load_set(tmp_path, 25)
    with pytest.raises(AbraceError, match="expected the folder of an exploration"):
        load_set(tmp_path / "nowhere", 0)


def test_a_set_of_a_model_that_is_not_to_be_trusted_is_refused(outcomes, tmp_path):
    save_exploration(
        tmp_path, study(), outcomes, (storey(), storey()), {}, distrust=["model/validity.json says don't trust"]
    )
    with pytest.raises(AbraceError, match=r"model/validity\.json says don't trust \(accept: \[untrusted_model\]"):
        write_set(tmp_path, 6)


def test_measured_quantities_may_have_a_wildcard(tmp_path):
    all_accelerations = given().model_copy(update={"measured": ["a*"]})
    (found,) = explore(study(), [all_accelerations], tmp_path, workers=1)
    assert not found.refused


def test_an_infinite_margin_is_null_in_the_file(outcomes, tmp_path):
    unlimited = replace(outcomes[0], margins=Margins(np.inf, 90.0, np.inf, 1.0))
    save_exploration(tmp_path, study(), [unlimited], (storey(), storey()), {})
    (found,) = json.loads((tmp_path / "exploration.json").read_text())["sets"]
    assert found["margins"] == {"gain_db": None, "phase_deg": 90.0, "delay": None, "sensitivity_peak": 1.0}
    assert found["relative"]["x1"] == outcomes[0].relative["x1"]._asdict()


def test_the_report_lists_the_front_from_least_to_most_force(outcomes):
    lines = report(outcomes, 0.9)
    split = lines.index(
        "most robust, with no more command rms than the given weights and the margins that design requires:"
    )
    rows, robust = (
        [line.split() for line in part if line[2:5].strip().isdigit() and "(" not in line]
        for part in (lines[3:split], lines[split:])
    )
    assert [int(row[0]) for row in robust] == [one.number for one in ranked(outcomes)[:5]]
    forces, responses = [float(row[1]) for row in rows], [float(row[6]) for row in rows]
    assert len(rows) > 2
    assert forces == sorted(forces)
    assert responses == sorted(responses, reverse=True)
    assert forces[0] == pytest.approx(outcomes[int(rows[0][0])].command.rms, rel=1e-3)


def test_sets_of_weights_are_tried_on_a_rig_with_two_brace_groups():
    rig = load_rig(Path(__file__).parents[2] / "src/abrace_plant/config/five_storey.yaml")
    half = load_weights(Path(__file__).parents[2] / "src/abrace_lqg/config/half.yaml")
    weights = scaled_weights(rig.model, half, 0.002, rig.capacity.tolist(), Excitation())
    motion = [noise_motion(1, 10.0, (0.3, 10.0), 0.002).scaled(1.0)]
    five = Study.of(rig.model, [rig.model], motion, intensities=[1.0], capacity=rig.capacity, sample_period=0.002)
    sets = weight_sets(weights, {"displacement": (-2.0, 1.0)}, 2, 1)
    found = [evaluate(five, number, one) for number, one in enumerate(sets)]
    assert not any(outcome.refused for outcome in found)
    for outcome in found:
        assert outcome.response("displacement") < 1.0
        assert outcome.margins.gain_db > 6.0
