# SPDX-License-Identifier: Apache-2.0
"""Proof before use: each prediction against an independent calculation, what is refused, and the files."""

from __future__ import annotations

import itertools
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pydantic
import pytest
import yaml
from scipy import linalg

from abrace_core import AbraceError
from abrace_core.files.writing import finite_or_null
from abrace_core.model.controller_file import Controller, load_controller, save_controller
from abrace_core.model.linear_model import LinearModel, save_model
from abrace_lqg.analysis.disk_margin import DiskMargin
from abrace_lqg.analysis.margins import Margins, margins
from abrace_lqg.analysis.mode_damping import ModeEffect, mode_effects
from abrace_lqg.analysis.prediction import Excitation, predicted_rms, rms_without_and_with_control
from abrace_lqg.design import ControllerDesign, design
from abrace_lqg.loop import closed_loop, is_stable, sampled
from abrace_lqg.proof import checks
from abrace_lqg.proof.checks import EnsembleProof, Proof, prove, require
from abrace_lqg.proof.figures import loop_figure
from abrace_lqg.proof.files import distrusted, load_models, save_proof, table_lines
from abrace_lqg.proof.limits import OBJECTIONS, WORDING, DesignOptions, Limits
from abrace_lqg.proof.proven_design import design_to_file
from abrace_lqg.weights import Weights, load_weights
from abrace_plant.rig.file import load_rig

UNSTABLE, SHORT_DELAY = "unstable_with_check_model", "short_delay_margin"
SOURCES = Path(__file__).parents[2] / "src"
PERIOD = 0.002


@pytest.fixture(scope="module")
def rig_model() -> LinearModel:
    return load_rig(SOURCES / "abrace_plant/config/ncree_three_storey.yaml").model


@pytest.fixture(scope="module")
def designed(rig_model: LinearModel) -> ControllerDesign:
    return design(rig_model, load_weights(SOURCES / "abrace_lqg/config/lqg3.yaml"), PERIOD)


@pytest.fixture(scope="module")
def turned(rig_model: LinearModel) -> LinearModel:
    """A rig whose accelerometers are turned around: stable by itself, not with the controller."""
    sign = np.array([-1.0 if name.startswith("a") else 1.0 for name in rig_model.outputs])
    return replace(rig_model, c=sign[:, None] * rig_model.c, d=sign[:, None] * rig_model.d)


@pytest.fixture(scope="module")
def proof(rig_model: LinearModel, designed: ControllerDesign) -> Proof:
    return prove(designed, {"rig": rig_model})


def louder(designed: ControllerDesign, factor: float) -> ControllerDesign:
    law = designed.controller
    return replace(designed, controller=replace(law, c=factor * law.c, d=factor * law.d))


def controller_of(designed: ControllerDesign) -> Controller:
    return Controller(
        "one", designed.controller, designed.correction, designed.prediction, np.array([1e9]), "m", "w", "g"
    )


# what is predicted


def test_rms_for_noise_up_to_half_the_sampling_rate_is_that_of_the_lyapunov_equation(
    rig_model: LinearModel, designed: ControllerDesign
):
    found = predicted_rms(rig_model, designed.controller, Excitation(0.3, (0.0, 0.5 / PERIOD)))
    loop = closed_loop(rig_model, designed.controller)
    # states in units of their own size, as they span many powers of ten
    _, (scale, _) = linalg.matrix_balance(loop.a, permute=False, separate=True)
    a, b, c = loop.a * scale / scale[:, None], loop.b / scale[:, None], loop.c * scale
    covariance = linalg.solve_discrete_lyapunov(a, b @ b.T, method="bilinear")
    expected = 0.3 * np.sqrt(np.diag(c @ covariance @ c.T) + np.diag(loop.d @ loop.d.T))
    np.testing.assert_allclose([found[name] for name in loop.outputs], expected, rtol=2e-3)


def test_without_control_the_command_is_zero_and_the_building_moves_more(
    rig_model: LinearModel, designed: ControllerDesign
):
    found = rms_without_and_with_control(rig_model, designed.controller, Excitation())
    assert list(found) == [*rig_model.outputs, "U"]
    assert found["U"][0] == 0.0 < found["U"][1]
    assert all(controlled < 0.5 * without for name, (without, controlled) in found.items() if name[0] in "xa")


@pytest.mark.parametrize("wrong", [{"rms": 0.0}, {"band": (3.0, 3.0)}, {"band": (-1.0, 2.0)}, {"rms": np.inf}])
def test_an_excitation_without_rms_or_band_is_refused(wrong: dict):
    with pytest.raises(AbraceError, match="excitation of"):
        Excitation(**wrong)


def test_a_band_beyond_half_the_sampling_rate_is_refused(rig_model: LinearModel, designed: ControllerDesign):
    with pytest.raises(AbraceError, match="at most 250 Hz"):
        predicted_rms(rig_model, designed.controller, Excitation(0.25, (0.3, 300.0)))


def two_oscillators(coupling: float) -> LinearModel:
    """20 and 60 rad/s, 2 and 1 %; the command pushes the second `coupling` times as much as the first."""
    blocks = [np.array([[0.0, 1.0], [-(w**2), -2 * z * w]]) for w, z in ((20.0, 0.02), (60.0, 0.01))]
    b = np.array([[0.0, 0.0], [1.0, 1.0], [0.0, 0.0], [1.0, coupling]])
    c = np.array([[0.0, 1.0, 0.0, 1.0]])
    return LinearModel(linalg.block_diag(*blocks), b, c, np.zeros((1, 2)), ("w", "U"), ("y1",))


def damper(gain: float) -> LinearModel:
    zero = np.zeros((1, 1))
    return LinearModel(np.eye(1) / 2, zero, zero, np.array([[-gain]]), ("y1",), ("U",), PERIOD)


def test_each_pole_pair_is_followed_to_its_place_in_the_loop():
    first = two_oscillators(0.0)
    alone = replace(first, a=first.a[:2, :2], b=first.b[:2], c=first.c[:, :2])
    low, high = mode_effects(first, damper(4.0), alone)
    assert (low.modelled, high.modelled) == (True, False)
    assert low.frequency == pytest.approx(20.0)
    # v' = ... - gain v adds gain / (2 w) of damping, but for the loop's delay of 1.5 samples
    assert low.controlled_damping == pytest.approx(0.02 + 4.0 / 40.0, rel=0.05)
    assert high.damping_kept == pytest.approx(1.0, abs=1e-6)


def test_a_mode_that_is_pushed_the_wrong_way_loses_damping():
    effects = mode_effects(two_oscillators(-0.1), damper(4.0), two_oscillators(0.0))
    # -0.1 of the gain: 0.4 / (2 * 60) of the damping ratio 0.01 is taken
    assert effects[1].damping_kept == pytest.approx((0.01 - 0.4 / 120) / 0.01, rel=0.1)
    assert all(mode.modelled for mode in effects)


# refusals


def test_a_sound_design_has_no_objections(proof: Proof):
    assert require(proof).accepted == ()
    assert not proof.objections()
    assert proof.margins.gain_db > 8
    assert proof.least_damping_kept > 0.85
    assert "gain margin" in proof.summary()


def test_a_design_that_is_unstable_with_a_check_model_is_refused_unless_accepted_by_name(
    rig_model: LinearModel, turned: LinearModel, designed: ControllerDesign
):
    assert not is_stable(turned, designed.controller)
    found = prove(designed, {"rig": rig_model, "turned": turned})
    with pytest.raises(AbraceError, match=r"with turned \(14 states\) is not stable.*unstable_with_check_model"):
        require(found)
    with pytest.raises(AbraceError, match="is not stable"):
        require(found, [SHORT_DELAY])
    accepted = require(found, [UNSTABLE])
    assert accepted.accepted == (UNSTABLE,)
    assert "accepted by name: unstable_with_check_model, the closed loop with turned" in accepted.summary()
    assert any("NOT STABLE" in line for line in table_lines(accepted))


def test_a_small_margin_is_refused_by_default_with_all_names_that_are_to_be_accepted(
    rig_model: LinearModel, designed: ControllerDesign
):
    edge = 10 ** (margins(rig_model, designed.controller).gain_db / 20)
    found = prove(louder(designed, edge / 10 ** (1.4 / 20)), {"rig": rig_model})
    assert found.margins.gain_db == pytest.approx(1.4, abs=1e-3)
    with pytest.raises(AbraceError) as refusal:
        require(found)
    assert "gain margin 1.40 dB at U with rig, expected at least 6 dB; phase margin 1" in str(refusal.value)
    names = ["small_gain_margin", "small_phase_margin", SHORT_DELAY, "small_disk_margin"]
    assert str(refusal.value).endswith(f"(accept: [{', '.join(names)}] to accept it nevertheless)")
    assert require(found, names).accepted == tuple(names)


@pytest.mark.parametrize("limit", list(WORDING))
def test_each_limit_refuses_by_its_name_from_its_value_on(proof: Proof, limit: str):
    disk = proof.models[0].disk
    assert disk is not None
    found = {
        "gain_margin": proof.margins.gain_db,
        "phase_margin": proof.margins.phase_deg,
        "delay_margin": proof.margins.delay,
        "disk_margin": disk.alpha,
        "damping_kept": proof.least_damping_kept,
    }[limit]
    assert require(replace(proof, limits=Limits(**{limit: 0.99 * found}))).accepted == ()
    higher = replace(proof, limits=Limits(**{limit: 1.01 * found}))
    with pytest.raises(
        AbraceError, match=rf"{WORDING[limit].quantity} .*rig.*\(accept: \[{WORDING[limit].objection}\]"
    ):
        require(higher)
    assert WORDING[limit].objection in require(higher, [WORDING[limit].objection]).summary()


def test_a_margin_that_is_no_number_is_an_objection(proof: Proof):
    first = proof.models[0]
    unknown = replace(first.margins["U"], gain_db=float("nan"))
    of_nothing = replace(proof, models=(replace(first, margins=first.margins | {"U": unknown}), *proof.models[1:]))
    assert list(of_nothing.objections()) == ["small_gain_margin"]


@pytest.mark.parametrize("place", [0, 1, 2])
@pytest.mark.parametrize(
    ("computed", "unknown", "objection"),
    [
        ("disk_margin", DiskMargin(np.nan, 1.0), "small_disk_margin"),
        ("margins_at", {"U": Margins(10.0, 60.0, np.nan, 1.5)}, "short_delay_margin"),
        ("mode_effects", [ModeEffect(7.0, 0.02, 7.0, np.nan, True)], "damping_lost"),
    ],
)
def test_what_is_not_a_number_with_one_of_the_drawn_models_is_an_objection_whichever_it_is(
    monkeypatch, rig_model: LinearModel, designed: ControllerDesign, place: int, computed: str, unknown, objection: str
):
    usual, calls = getattr(checks, computed), itertools.count()
    monkeypatch.setattr(
        checks, computed, lambda *given, **more: unknown if next(calls) == 1 + place else usual(*given, **more)
    )
    found = prove(designed, {"rig": rig_model}, ensembles={"rig": [rig_model] * 3})
    assert list(found.objections()) == [objection]
    assert "nan" in found.objections()[objection]
    assert "nan" in found.summary()


def test_a_proof_with_numbers_that_are_none_is_read_as_it_was_written(proof: Proof):
    first = proof.models[0]
    unknown = replace(
        first,
        disk=DiskMargin(np.nan, 1.0),
        modes=[ModeEffect(7.0, 0.02, 7.0, np.nan, True)],
        margins={"U": Margins(*4 * [np.nan])},
    )
    found = replace(proof, models=(unknown,))
    content = finite_or_null(pydantic.TypeAdapter(Proof).dump_python(found, by_alias=True))
    again = pydantic.TypeAdapter(Proof).validate_python(content)
    assert list(again.objections()) == list(found.objections()) != []
    assert again.summary() == found.summary()


def test_a_mode_without_damping_has_none_to_lose():
    assert ModeEffect(7.0, 0.0, 7.0, 0.05, True).damping_kept == np.inf
    assert ModeEffect(7.0, 0.0, 7.0, -0.01, True).damping_kept == -np.inf


def test_the_damping_of_a_model_whose_loop_is_accepted_as_unstable_is_no_second_objection(
    rig_model: LinearModel, turned: LinearModel, designed: ControllerDesign
):
    found = prove(designed, {"rig": rig_model, "turned": turned})
    assert found.least_damping_kept < 0
    assert list(found.objections()) == [UNSTABLE]


def test_a_loop_that_is_unstable_with_its_own_model_is_not_proven(turned: LinearModel, designed: ControllerDesign):
    with pytest.raises(AbraceError, match="with turned, the design's own model, is not stable"):
        prove(designed, {"turned": turned})


def test_a_check_model_of_another_rig_is_named(rig_model: LinearModel, designed: ControllerDesign):
    with pytest.raises(AbraceError, match=r"proof with model other: .*'a3'"):
        prove(designed, {"rig": rig_model, "other": rig_model.select(["x1", "a1", "a2"])})


# models as likely as one


def test_a_limit_has_to_be_kept_with_every_model_that_is_as_likely(
    rig_model: LinearModel, turned: LinearModel, designed: ControllerDesign
):
    loud = replace(rig_model, b=rig_model.b * np.array([1.0, 2.0]))
    found = prove(designed, {"rig": rig_model}, ensembles={"rig": [rig_model, loud]})
    ensemble = found.models[0].ensemble
    assert ensemble is not None
    assert (ensemble.count, ensemble.unstable) == (2, 0)
    assert ensemble.margins["U"].gain_db == pytest.approx(margins(loud, designed.controller).gain_db)
    assert found.margins.gain_db == ensemble.margins["U"].gain_db
    with pytest.raises(AbraceError, match=r"gain margin 3.* dB at U with one of the 2 models drawn from rig, expected"):
        require(found)
    assert any("the least of 2 models drawn from it: the closed loop is stable" in line for line in table_lines(found))
    with pytest.raises(AbraceError, match="the closed loop with 1 of the 2 models drawn from rig is not stable"):
        require(prove(designed, {"rig": rig_model}, ensembles={"rig": [rig_model, turned]}))


def test_models_are_drawn_about_those_whose_files_have_a_covariance(tmp_path: Path, rig_model: LinearModel):
    modal, sizes = in_modal_form(rig_model)
    uncertain, exact = tmp_path / "uncertain.json", tmp_path / "exact.json"
    save_model(modal, uncertain, np.diag((0.01 * sizes) ** 2))
    save_model(rig_model, exact)
    weights = load_weights(SOURCES / "abrace_lqg/config/lqg3.yaml")
    five = DesignOptions(sample_period=PERIOD, force_limit=(24516.625,), draws=5)
    given = {"weights": weights, "weights_name": "lqg3"}
    proof, controller, _ = design_to_file([str(exact), str(uncertain)], tmp_path / "one.yaml", options=five, **given)
    assert proof.models[0].ensemble is None
    drawn = proof.models[1].ensemble
    assert drawn is not None
    assert drawn.count == 5
    assert drawn.margins["U"].gain_db != proof.models[1].margins["U"].gain_db
    assert "the least of 2 models and 5 drawn from them" in controller.margins
    content = json.loads((tmp_path / "one_proof.json").read_text())
    assert content["design_model"] == "exact"
    assert content["models"]["exact"]["ensemble"] is None
    assert content["models"]["uncertain"]["ensemble"]["disk_margin"] == drawn.disk_margin
    assert content["models"]["uncertain"]["ensemble"]["at_frequency_rad_s"] == drawn.at
    none = five.model_copy(update={"draws": 0})
    proof, *_ = design_to_file([str(uncertain)], tmp_path / "one.yaml", options=none, **given)
    assert all(each.ensemble is None for each in proof.models)
    save_model(rig_model, uncertain, np.eye(3))
    with pytest.raises(AbraceError, match=r"^model uncertain: covariance of a model"):
        design_to_file([str(exact), str(uncertain)], tmp_path / "one.yaml", options=five, **given)


def test_a_model_that_its_own_validity_says_not_to_trust_is_refused_unless_accepted_by_name(
    tmp_path: Path, rig_model: LinearModel
):
    save_model(rig_model, tmp_path / "model.json")
    weights = load_weights(SOURCES / "abrace_lqg/config/lqg3.yaml")
    options = DesignOptions(sample_period=PERIOD, force_limit=(24516.625,))
    given = {"weights": weights, "weights_name": "lqg3"}
    files, validity = [str(tmp_path / "model.json")], tmp_path / "validity.json"
    validity.write_text('{"verdict": "don\'t trust", "causes": ["wrong unit"]}')
    complaint = r"validity\.json says don't trust \(wrong unit\) \(accept: \[untrusted_model"
    with pytest.raises(AbraceError, match=complaint):
        design_to_file(files, tmp_path / "one.yaml", options=options, **given)
    assert not (tmp_path / "one.yaml").exists()
    accepting = options.model_copy(update={"accept": ("untrusted_model",)})
    proof, controller, _ = design_to_file(files, tmp_path / "one.yaml", options=accepting, **given)
    assert proof.accepted == ("untrusted_model",)
    assert "accepted by name: untrusted_model, " in controller.margins
    validity.write_text('{"verdict": "trust with care", "causes": ["friction"]}')
    assert distrusted(files) == ()
    validity.write_text("[]")
    with pytest.raises(AbraceError, match=r"validity\.json.*expected the findings of an identification"):
        distrusted(files)


def in_modal_form(model: LinearModel) -> tuple[LinearModel, np.ndarray]:
    """The same model in real modal states, and the sizes of its parameters."""
    values, vectors = np.linalg.eig(model.a)
    real, columns = np.zeros((model.order, model.order)), []
    for value, vector in zip(values, vectors.T, strict=True):
        if value.imag > 0:
            columns += [vector.real, -vector.imag]
        elif value.imag == 0:
            columns.append(vector.real)
    basis = np.array(columns).T
    real = np.linalg.solve(basis, model.a @ basis)
    real[np.abs(real) < 1e-6 * np.abs(real).max(axis=1, keepdims=True)] = 0
    found = replace(model, a=real, b=np.linalg.solve(basis, model.b), c=model.c @ basis, d=model.d)
    first, poles = 0, []
    while first < model.order:
        pair = first + 1 < model.order and real[first, first + 1] != 0
        poles += [real[first, first], real[first + 1, first]] if pair else [real[first, first]]
        first += 2 if pair else 1
    return found, np.abs(np.concatenate([poles, found.b.ravel(), found.c.ravel(), found.d.ravel(), found.input_delay]))


# several commands, and files


def test_a_rig_of_two_brace_groups_is_proven_at_each_command():
    model = load_rig(SOURCES / "abrace_plant/config/five_storey.yaml").model
    weights = Weights.model_validate(
        {
            "measured": ["a1", "a3", "a5"],
            "weights": {"displacement": 1e11, "stroke": 0.0, "acceleration": 1e9, "force": 0.0, "command": 1.0},
            "noise_to_excitation": 0.5,
        }
    )
    found = prove(two := design(model, weights, PERIOD), {"five": model})
    assert list(found.models[0].margins) == ["U1", "U2", "a1", "a3", "a5"]
    assert found.margins.gain_db == min(found.models[0].margins[name].gain_db for name in ("U1", "U2"))
    assert found.models[0].disk is not None
    assert found.models[0].disk.gain_db < found.margins.gain_db
    nichols = loop_figure(found, {"five": model}, two.controller).axes[0]
    assert [text.get_text() for text in nichols.get_legend().get_texts()] == ["U1, five", "U2, five", "margins"]


def test_the_proof_is_written_into_the_controller_file_and_its_folder(
    tmp_path: Path, rig_model: LinearModel, turned: LinearModel, designed: ControllerDesign
):
    models = {"rig": rig_model, "turned": turned}
    found = require(prove(designed, models), OBJECTIONS)
    file = tmp_path / "one.yaml"
    written = save_proof(found, models, designed.controller, file)
    save_controller(controller_of(designed), file, table_lines(found))
    assert [path.name for path in written] == ["one_proof.json", "one_loop.svg"]
    assert "<svg" in written[1].read_text()
    expected = sorted(["one.yaml", *(path.name for path in written)])
    assert sorted(path.name for path in tmp_path.iterdir()) == expected
    np.testing.assert_array_equal(load_controller(file).law.a, designed.controller.a)
    text = file.read_text()
    assert all(f"# {line}\n" in text for line in table_lines(found))
    content = json.loads(written[0].read_text())
    rig, other = content["models"]["rig"], content["models"]["turned"]
    assert content["accepted"] == [UNSTABLE]
    assert rig["margins"]["U"]["gain_db"] == pytest.approx(margins(rig_model, designed.controller).gain_db)
    assert float(rig["margins"]["a3"]["delay_s"]) == found.models[0].margins["a3"].delay
    assert rig["prediction"]["x3"].keys() == {"zero_command", "controlled"}
    assert rig["prediction"]["x3"]["controlled"] == found.models[0].prediction["x3"][1]
    assert rig["disk"]["phase_deg"] == found.models[0].disk.phase_deg
    assert [float(mode["damping_kept"]) for mode in rig["modes"]] == [
        mode.damping_kept for mode in found.models[0].modes
    ]
    assert other["margins"] == {}
    assert not other["stable"]
    again = pydantic.TypeAdapter(Proof).validate_python(content)
    assert (again.accepted, again.excitation, again.limits) == (found.accepted, found.excitation, found.limits)
    assert again == found


TWO_GROUPS = {
    "weights": {"displacement": 1e11, "stroke": 0.0, "acceleration": 1e9, "force": 0.0, "command": 1.0},
    "noise_to_excitation": 0.5,
}
LQG3 = yaml.safe_load((SOURCES / "abrace_lqg/config/lqg3.yaml").read_text())
RIGS = {
    "five_storey": (TWO_GROUPS | {"measured": ["a1", "a3", "a5"]}, PERIOD),
    "six_storey": (TWO_GROUPS | {"measured": ["a2", "a4", "a6"]}, PERIOD),
    "ncree_three_storey": (LQG3, 5 * PERIOD),
}
"""Weights and sample period of the controller by rig: several brace groups, few sensors, a slower controller."""


class Written(NamedTuple):
    """What a proof's file has, and what it is about."""

    content: dict[str, Any]
    proof: Proof
    models: dict[str, LinearModel]
    controller: LinearModel


@pytest.fixture(scope="module", params=RIGS)
def written(request, tmp_path_factory) -> Written:
    weights, period = RIGS[request.param]
    model = load_rig(SOURCES / f"abrace_plant/config/{request.param}.yaml").model
    # a device that is a fifth stronger, by a name that is sorted before that of the design's model
    models = {"the rig": model, "a stronger one": replace(model, b=model.b * [1.0, *[1.2] * (len(model.inputs) - 1)])}
    two = design(model, Weights.model_validate(weights), period, PERIOD)
    # noise of all frequencies that samples can have
    found = prove(two, models, Excitation(0.3, (0.0, 0.5 / period)))
    (file, _) = save_proof(
        found,
        {name: sampled(one, PERIOD) for name, one in models.items()},
        two.controller,
        tmp_path_factory.mktemp(request.param) / "one.yaml",
    )
    return Written(json.loads(file.read_text()), found, models, two.controller)


def own_loop(model: LinearModel, law: LinearModel) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A, B, C, D, written out, of plant, law and command in force, from w to the plant's outputs and the commands."""
    plant = sampled(model, PERIOD)
    pushed = [plant.inputs.index(name) for name in law.outputs]
    seen = [plant.outputs.index(name) for name in law.inputs]
    (w,) = set(range(len(plant.inputs))) - set(pushed)
    a, b, c, d = plant.a, plant.b[:, pushed], plant.c, plant.d[:, pushed]
    whole = [
        [a, np.zeros((len(a), law.order)), b],
        [law.b @ c[seen], law.a, law.b @ d[seen]],
        [law.d @ c[seen], law.c, law.d @ d[seen]],
    ]
    out = [[c, np.zeros((len(c), law.order)), d], whole[2]]
    b_w, d_w = plant.b[:, [w]], plant.d[:, [w]]
    drive = np.vstack([b_w, law.b @ d_w[seen], law.d @ d_w[seen]])
    return np.block(whole), drive, np.block(out), np.vstack([d_w, law.d @ d_w[seen]])


def rms_of_noise(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray, rms: float) -> np.ndarray:
    """Of the outputs, by the Lyapunov equation, with states in units of their own size."""
    _, (scale, _) = linalg.matrix_balance(a, permute=False, separate=True)
    a, b, c = a * scale / scale[:, None], b / scale[:, None], c * scale
    covariance = linalg.solve_discrete_lyapunov(a, b @ b.T, method="bilinear")
    return rms * np.sqrt(np.diag(c @ covariance @ c.T) + np.diag(d @ d.T))


def test_the_file_has_each_models_margins_under_the_signal_at_which_that_gain_is_the_edge(written: Written):
    content, _, models, law = written
    assert content["models"].keys() == models.keys()
    for name, model in models.items():
        margins_of = content["models"][name]["margins"]
        assert set(margins_of) == {*law.inputs, *law.outputs}
        plant = sampled(model, PERIOD)
        for signal in margins_of:
            gain = margins_of[signal]["gain_db"]
            edge = 1e3 if gain == "inf" else 10 ** (gain / 20)
            inside, outside = (
                [is_stable(plant, scaled(law, signal, change)) for change in (edge**power, edge**-power)]
                for power in (0.999, 1.001)
            )
            assert all(inside), (name, signal)
            assert all(outside) == (gain == "inf"), (name, signal)


def scaled(law: LinearModel, signal: str, factor: float) -> LinearModel:
    """The law with a factor in one of its inputs or outputs."""
    column = np.where(np.array(law.inputs) == signal, factor, 1.0)
    row = np.where(np.array(law.outputs) == signal, factor, 1.0)[:, None]
    return replace(law, b=law.b * column, c=row * law.c, d=row * law.d * column)


def test_the_file_has_each_models_rms_under_the_name_of_the_channel_that_moves_so(written: Written):
    content, _, models, law = written
    band = content["excitation"]["band"]
    assert band == {"lowest_hz": 0.0, "highest_hz": 0.5 / law.sample_period}
    for name, model in models.items():
        found = content["models"][name]["prediction"]
        assert list(found) == [*model.outputs, *law.outputs]
        without = predicted_without(model, band["highest_hz"])
        for channel, expected in zip(model.outputs, without, strict=True):
            assert found[channel]["zero_command"] == pytest.approx(expected, rel=0.02), (name, channel)
        if law.sample_period == PERIOD:
            controlled = rms_of_noise(*own_loop(model, law), 0.3)
            for channel, expected in zip((*model.outputs, *law.outputs), controlled, strict=True):
                assert found[channel]["controlled"] == pytest.approx(expected, rel=5e-3), (name, channel)


def predicted_without(model: LinearModel, highest: float) -> np.ndarray:
    """Rms of the outputs for 0.3 m/s^2 of noise up to `highest` [Hz], from the response of the continuous model."""
    near = np.outer(np.abs(model.poles), np.linspace(0.9, 1.1, 401)).ravel()
    omega = np.unique([*np.linspace(1e-3, 2 * np.pi * highest, 40_000), *near])
    omega = omega[omega <= 2 * np.pi * highest]
    power = np.abs(model.select(inputs=["w"]).frequency_response(omega)[:, :, 0]) ** 2
    return 0.3 * np.sqrt(np.trapezoid(power, omega, axis=0) / (2 * np.pi * highest))


def test_the_file_has_frequency_and_damping_of_each_models_own_poles_and_of_its_loops(written: Written):
    content, _, models, law = written
    for name, model in models.items():
        one = content["models"][name]
        assert one["order"] == model.order
        step, *_ = own_loop(model, law)
        hold = step.copy()
        first = sampled(model, PERIOD).order
        hold[first:] = np.eye(len(step))[first:]  # law and command keep their values between the law's samples
        whole = np.linalg.matrix_power(hold, round(law.sample_period / PERIOD) - 1) @ step
        loop = pairs(np.linalg.eigvals(whole).astype(complex), law.sample_period)
        assert len(one["poles"]) >= len(pairs_of(model))
        for pole in one["poles"]:
            assert nearest(loop, pole["frequency_rad_s"], pole["damping_ratio"]) < 1e-3, (name, pole)
        expected = sorted(pairs_of(model))
        assert len(one["modes"]) == len(expected)
        for mode, (frequency, damping) in zip(one["modes"], expected, strict=True):
            assert mode["frequency_rad_s"] == pytest.approx(frequency, rel=1e-6)
            assert mode["damping_ratio"] == pytest.approx(damping, rel=1e-4)
            kept = mode["controlled_damping_ratio"] / mode["damping_ratio"]
            assert mode["damping_kept"] == pytest.approx(kept, rel=1e-9)
            if law.sample_period == PERIOD and mode["controlled_frequency_rad_s"]:
                at = mode["controlled_frequency_rad_s"], mode["controlled_damping_ratio"]
                assert nearest(loop, *at) < 1e-3, (name, mode)


def pairs(poles: np.ndarray, period: float) -> np.ndarray:
    """(pairs, 2): frequency [rad/s] and damping ratio of discrete poles."""
    continuous = np.log(poles[np.abs(poles) > 1e-12]) / period
    return np.array([(abs(one), -one.real / abs(one)) for one in continuous if one.imag > 0])


def pairs_of(model: LinearModel) -> list[tuple[float, float]]:
    return [(abs(one), -one.real / abs(one)) for one in np.linalg.eigvals(model.a) if one.imag > 0]


def nearest(of: np.ndarray, frequency: float, damping: float) -> float:
    """The least distance to one of those pairs, of frequencies relative, of damping ratios absolute."""
    return float(np.min(np.abs(of[:, 0] / frequency - 1) + np.abs(of[:, 1] - damping)))


def test_the_file_says_which_model_was_designed_with_and_the_unit_of_every_signal(written: Written):
    content, found, models, law = written
    assert content["design_model"] == "the rig"
    names = {*models["the rig"].inputs, *models["the rig"].outputs}
    kinds = {"x": "m", "a": "m/s^2", "w": "m/s^2", "f": "N", "U": "N"}
    assert content["units"] == {name: kinds[name[0]] for name in names}
    assert content["commands"] == list(law.outputs)
    assert content["margins"]["delay_s"] == min(
        one["margins"][name]["delay_s"] for one in content["models"].values() for name in law.outputs
    )
    # the order of names in a JSON object says nothing
    again = pydantic.TypeAdapter(Proof).validate_python(json.loads(json.dumps(content, sort_keys=True)))
    assert [one.name for one in again.models] == ["the rig", "a stronger one"]
    assert again == found


def test_every_key_of_the_file_is_documented(proof: Proof):
    drawn = replace(
        proof.models[0], ensemble=EnsembleProof(1, 0, {"U": proof.margins}, disk_margin=0.4, damping_kept=0.9, at=7.0)
    )
    named = {"models", "margins", "prediction", "units"}  # their keys are names of models and signals

    def keys(content: Any, above: str = "") -> set[str]:
        if isinstance(content, list):
            return set().union(*(keys(one) for one in content))
        if not isinstance(content, dict):
            return set()
        own = set() if above in named and "gain_db" not in content else set(content)
        return own.union(*(keys(value, name) for name, value in content.items()))

    found = keys(pydantic.TypeAdapter(Proof).dump_python(replace(proof, models=(drawn,)), by_alias=True))
    section = (SOURCES.parent / "docs/method.md").read_text().partition("`NAME_proof.json` has every number")[2]
    documented = set(re.findall(r"[a-z_]+", " ".join(re.findall(r"`([^`]+)`", section.partition("### ")[0]))))
    assert {"frequency_rad_s", "at_frequency_rad_s", "highest_hz", "zero_command"} < found
    assert found - set(Limits.model_fields) - documented == set()


@pytest.mark.parametrize(
    ("wrong", "expected"),
    [
        ({"design_model": "other"}, "design_model, one of rig"),
        ({"models": []}, "an object for each model, by its name"),
        ({"excitation": {"rms": 0.25, "band": [0.3, 10.0]}}, "an object with lowest_hz, highest_hz"),
    ],
)
def test_a_file_without_names_is_no_proof(proof: Proof, wrong: dict, expected: str):
    content = pydantic.TypeAdapter(Proof).dump_python(proof, by_alias=True)
    with pytest.raises(pydantic.ValidationError, match=expected):
        pydantic.TypeAdapter(Proof).validate_python(content | wrong)


def test_models_have_the_names_of_their_files(tmp_path: Path, rig_model: LinearModel):
    paths = [tmp_path / "a/model.json", tmp_path / "b/model.json", tmp_path / "rig.json"]
    for path in paths:
        save_model(rig_model, path)
    assert list(load_models(list(map(str, paths)))) == [str(paths[0]), str(paths[1]), "rig"]
    with pytest.raises(AbraceError, match="given twice"):
        load_models([str(paths[0]), str(paths[0])])
