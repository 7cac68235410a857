# SPDX-License-Identifier: Apache-2.0
"""A model of measured data is designed with and simulated under its own names."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm

import abrace
from abrace import LinearModel
from abrace.cli import main
from abrace.interactive.data import IdentifiedData
from abrace_core.model.controller_file import load_controller
from abrace_core.model.verdict import Verdict
from abrace_studies.exploration.report import report
from abrace_studies.ground_motions import noise_motion

PERIOD = 0.002
WEIGHTS = {"measured": ["roof"], "signals": {"roof": 1e6}, "noise_to_excitation": 1e-8}
NAMED = {"commands": ["shaker"], "disturbance": "road", "force_limit": [300.0], "sample_period": PERIOD}


def storey(inputs: tuple[str, str], output: str) -> LinearModel:
    """One storey of 1800 kg at 2 Hz, from two forces [N] to its acceleration; the second one is late by 5 ms."""
    mass, damping, stiffness = 1800.0, 1200.0, 3.0e5
    a = np.array([[0, 1, 0], [-stiffness / mass, -damping / mass, 1 / mass], [0, 0, -200.0]])
    return LinearModel(a, [[0, 0], [1 / mass, 0], [0, 200.0]], [a[1]], [[1 / mass, 0]], inputs, (output,))


def measured() -> LinearModel:
    """As data give it: the shaker first, in kN, and roof in g."""
    model = storey(("road", "shaker"), "roof").select(inputs=["shaker", "road"])
    units = {"shaker": "kN", "road": "N", "roof": "g"}
    return replace(model, b=model.b * [1e3, 1], c=model.c / 9.80665, d=model.d / 9.80665 * [1e3, 1], units=units)


@pytest.fixture(scope="module")
def designed():
    return abrace.design(measured(), WEIGHTS, **NAMED)


@pytest.fixture(scope="module")
def push():
    return 500.0 * np.random.default_rng(2).standard_normal(4000)


def test_a_closed_loop_is_simulated_under_the_names_of_the_model(designed, push, recwarn):
    run = abrace.simulate(measured(), push, controller=designed)
    assert not recwarn.list
    assert (run.names, run.command_names, run.disturbance) == (("roof",), ("shaker",), "road")
    assert repr(run) == "<Run model/motion: 8 s at 500 Hz, road, shaker to roof>"
    assert list(run.to_pandas().columns) == ["roof", "shaker", "road"]
    assert run.to_pandas().attrs["units"] == {"roof": "m/s^2", "shaker": "N", "road": "N"}
    np.testing.assert_array_equal(run["road"], push)
    # the same structure and law step by step, by hand
    plant, law = abrace.discretize(storey(("road", "shaker"), "roof"), PERIOD, {}), designed.controller.law
    x, q, force, until = np.zeros(plant.order), np.zeros(law.order), np.zeros(1), np.zeros(1)
    for k in range(300):
        y = plant.c @ x + plant.d @ [push[k], force[0]]
        assert run["roof"][k] == pytest.approx(y[0], rel=1e-6, abs=1e-9)
        assert run["shaker"][k] == pytest.approx(until[0], rel=1e-6, abs=1e-6)
        wanted = law.c @ q + law.d @ y
        limited = np.clip(wanted, -300.0, 300.0)
        x = plant.a @ x + plant.b @ [push[k], force[0]]
        q, until, force = law.a @ q + law.b @ y + designed.controller.correction @ (limited - wanted), force, limited
    assert np.abs(run["shaker"]).max() > 10.0
    free = abrace.simulate(measured(), push, disturbance="road", sample_period=PERIOD)
    assert run["roof"].std() < 0.95 * free["roof"].std()
    assert run.plot().axes[0].get_ylabel().endswith("[m/s²]")


def test_a_simulated_run_is_a_test_for_identification_again(push):
    test = abrace.Test.of(abrace.simulate(measured(), push, disturbance="road", sample_period=PERIOD)[1.0:7.0])
    assert (test.inputs, test.names, test.hold, test.floors) == (("road", "shaker"), ("roof",), "zero", 0)
    assert test.units == {"roof": "m/s^2", "shaker": "N", "road": "N"}


def test_the_only_input_is_command_and_place_of_the_disturbance(push):
    alone = measured().select(inputs=["shaker"])
    run = abrace.simulate(alone, push, command=2 * push, sample_period=PERIOD)
    together = abrace.simulate(alone, 3 * push, sample_period=PERIOD)
    np.testing.assert_allclose(run["roof"], together["roof"], rtol=1e-9, atol=1e-12)
    assert run.disturbance == "disturbance"


def test_a_model_of_data_with_a_rigs_names_has_its_own_channels_and_no_warning(push, recwarn):
    model = replace(storey(("w", "U"), "a1"), provenance={"data": "test.csv", "sample_period": PERIOD})
    run = abrace.simulate(model, 0.001 * push)
    assert not recwarn.list
    assert (run.names, run.disturbance, run.sample_period) == (("a1",), "w", PERIOD)
    of_rig = replace(model, provenance={"sample_period": PERIOD})
    expected = abrace.simulate(of_rig, 0.001 * push)
    assert not recwarn.list
    assert (expected.names, expected.without, expected.floors) == (("a1",), ("x1", "xf", "f"), 1)
    np.testing.assert_array_equal(run["a1"], expected["a1"])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"record": "el_centro"}, r"expected the name of the disturbance, one of shaker, road"),
        (
            {"record": "el_centro", "disturbance": "road"},
            r"record of an acceleration for road \[N\], expected \(samples,\) in N",
        ),
        ({"record": np.ones(9), "disturbance": "rod"}, "model has no input rod, it has shaker, road"),
    ],
)
def test_what_cannot_drive_a_model_is_refused(given, message):
    with pytest.raises(abrace.AbraceError, match=message):
        abrace.simulate(measured(), **given, sample_period=PERIOD)


def test_a_rig_is_moved_by_its_table():
    with pytest.raises(abrace.AbraceError, match="disturbance 'U' of a rig"):
        abrace.simulate("ncree_three_storey", "el_centro", disturbance="U")


def test_a_design_takes_an_identification_of_data_and_heeds_its_verdict(designed):
    def identified(verdict: Verdict) -> IdentifiedData:
        judged = SimpleNamespace(validity=SimpleNamespace(verdict=verdict, causes=("spikes",)))
        return IdentifiedData(SimpleNamespace(model=measured()), (), judged)

    again = abrace.design(identified(Verdict.TRUST), WEIGHTS, **NAMED)
    np.testing.assert_array_equal(again.controller.law.a, designed.controller.law.a)
    with pytest.raises(abrace.AbraceError, match=r"the identification says don't trust \(spikes\)"):
        abrace.design(identified(Verdict.DONT), WEIGHTS, **NAMED)


def test_margins_and_design_take_the_folder_of_an_identification_of_data(designed, tmp_path):
    abrace.save_model(measured(), tmp_path / "model.json")
    again = abrace.design(tmp_path, WEIGHTS, **NAMED)
    np.testing.assert_array_equal(again.controller.law.a, designed.controller.law.a)
    assert abrace.margins(tmp_path, again) == designed.margins
    (tmp_path / "validity.json").write_text('{"verdict": "don\'t trust", "causes": ["spikes"]}')
    with pytest.raises(abrace.AbraceError, match=r"validity.json says don't trust \(spikes\)"):
        abrace.design(tmp_path, WEIGHTS, **NAMED)


SMALL = {"commands": ["amplifier"], "force_limit": [0.2], "sample_period": PERIOD}
"""Of `bench`, which an amplifier in V drives."""


def bench() -> LinearModel:
    """A mass of 2 kg at 4.8 Hz, as data give it: 1 V of the amplifier is 0.5 N; `acc 1` in g, `laser` in mm."""
    a = np.array([[0.0, 1.0], [-900.0, -1.2]])
    c, d = np.array([a[1] / 9.80665, [1e3, 0.0]]), np.array([[0.25 / 9.80665], [0.0]])
    units = {"amplifier": "V", "acc 1": "g", "laser": "mm"}
    facts = {"data": "first.csv", "sample_period": PERIOD, "hold": "zero", "options": {"time": "time"}}
    names = ("acc 1", "laser")
    return LinearModel(a, [[0.0], [0.25]], c, d, ("amplifier",), names, units=units, provenance=facts)


BENCH_WEIGHTS = {
    "measured": ["acc 1"],
    "signals": {"laser": 1.0},
    "scale": {"reduction": 0.5},
    "noise_to_excitation": 1e-6,
}


def stepped(volts, law=None, limit: float = 0.2):
    """(samples,) laser [m] and command [V] of the bench under a disturbance in V, by its own transition."""
    a, period = np.array([[0.0, 1.0, 0.0], [-900.0, -1.2, 0.25], [0.0, 0.0, 0.0]]), PERIOD
    whole = expm(a * period)
    x, q, command, rows = np.zeros(2), np.zeros(0 if law is None else law.law.order), 0.0, []
    for each in volts:
        acting = each + command
        rows.append((x[0], command))
        if law is not None:
            measured = np.array([-900.0 * x[0] - 1.2 * x[1] + 0.25 * acting])
            wanted = law.law.c @ q + law.law.d @ measured
            limited = np.clip(wanted, -limit, limit)
            q = law.law.a @ q + law.law.b @ measured + law.correction @ (limited - wanted)
            command = float(limited[0])
        x = whole[:2, :2] @ x + whole[:2, 2] * acting
    return np.array(rows).T


@pytest.fixture(scope="module")
def benched():
    return abrace.design(bench(), BENCH_WEIGHTS, excitation_rms=1.0, **SMALL)


def test_a_bench_in_volts_with_a_limit_below_one_is_designed_simulated_and_validated(benched, tmp_path):
    volts = 5.0 * np.random.default_rng(3).standard_normal(3000)
    run = abrace.simulate(bench(), volts, controller=benched)
    laser, command = stepped(volts, benched.controller)
    assert np.abs(command).max() == pytest.approx(0.2), "the limit has to act in this test"
    np.testing.assert_allclose(run["laser"], laser, atol=1e-6 * np.abs(laser).max())
    np.testing.assert_allclose(run["amplifier"][1:], command[:-1], atol=1e-6)
    assert run.unit("amplifier") == "V"
    late = replace(bench(), provenance={**bench().provenance, "output_delays": {"laser": 0.01}})  # a run has none
    for model in (bench(), late):
        assert abrace.validate(run, model, controller=benched).comparison.noise_free_error()["laser"] < 1e-6
    assert abrace.margins(bench(), benched).gain_db > 6.0
    table = np.column_stack([np.arange(3000) * PERIOD, volts, 1e3 * stepped(volts)[0]])
    np.savetxt(tmp_path / "second.csv", table, delimiter=",", header="time,amplifier [V],laser [mm]", comments="")
    found = abrace.validate(tmp_path / "second.csv", bench(), outputs=["laser"])
    assert found.finding.verdict is Verdict.TRUST
    assert list(found.to_pandas().index) == ["laser"]
    assert found.to_pandas().loc["laser", "rms measured"] == pytest.approx(stepped(volts)[0].std(), rel=1e-6)
    with pytest.raises(abrace.AbraceError, match=r"second.csv: no column 'acc 1', it has time, amplifier \[V\], laser"):
        abrace.validate(tmp_path / "second.csv", bench())


def test_loops_of_a_model_of_data_are_studied_under_its_names(benched, tmp_path):
    given = {"noise": [1, 2], "noise_duration": 8.0, "workers": 1}
    found = abrace.fragility(
        bench(), benched, limits={"laser": 5e-4}, intensities=[0.5, 2.0, 8.0], folder=tmp_path / "curves", **given
    )
    loops = found.loops()
    noise = noise_motion(2, 8.0, (0.1, 10.0), PERIOD).scaled(8.0).ground_acceleration
    for controller, law in (("zero command", None), (benched.controller.name, benched.controller)):
        (row,) = loops[
            (loops.controller == controller) & (loops.motion == "noise 2") & (loops.intensity == 8.0)
        ].to_dict("records")
        laser, command = stepped(noise, law)
        assert row["peak_laser"] == pytest.approx(np.abs(laser).max(), rel=1e-6)
        assert row["peak_amplifier"] == pytest.approx(np.abs(command).max(), rel=1e-6, abs=1e-12)
    assert "laser above 0.0005 m: median" in found.text()
    assert "m/s^2" not in found.text()
    assert found.plot().axes[0].get_xlabel() == "peak of disturbance (V)"
    with pytest.raises(abrace.AbraceError, match=r"records of an acceleration for disturbance \[V\], expected noise"):
        abrace.fragility(bench(), records="el_centro", limits={"laser": 1.0}, intensities=[1.0], folder=tmp_path / "no")
    with pytest.raises(
        abrace.AbraceError, match="limits d1=1: expected a value above 0 for some of acc 1, laser, ampl"
    ):
        abrace.fragility(bench(), limits={"d1": 1.0}, intensities=[1.0], folder=tmp_path / "no", **given)


def test_weights_by_name_are_explored_and_one_set_is_picked(tmp_path):
    abrace.save_model(bench(), tmp_path / "model.json")
    given = {"noise": [1], "noise_duration": 8.0, "workers": 1, "peak_acceleration": 0.5, "force_limit": 0.2, "sets": 2}
    folder = tmp_path / "found"
    found = abrace.explore(tmp_path, BENCH_WEIGHTS, folder=folder, **given)
    assert [outcome.refused for outcome in found.outcomes] == [""] * 3
    table, noise = found.to_pandas(), noise_motion(1, 8.0, (0.1, 10.0), PERIOD).scaled(0.5).ground_acceleration
    assert table["signals.laser"].nunique() == 3
    assert main(["explore", str(tmp_path), "--pick", "2", "--output", str(folder)]) == 0
    picked = load_controller(folder / "set_2.yaml")
    assert (picked.law.outputs, picked.force_limit.tolist()) == (("amplifier",), [0.2])
    laser, command = stepped(noise, picked)
    assert table.loc[2, "laser_rms"] == pytest.approx(
        np.sqrt(np.mean(laser**2) / np.mean(stepped(noise)[0] ** 2)), rel=1e-6
    )
    assert table.loc[2, "command_peak"] == pytest.approx(np.abs(command).max(), rel=1e-6)
    lines = report(found.outcomes, 0.9)
    assert lines[2].split()[:7] == ["set", "command", "rms,", "peak", "saturated", "laser", "robust"]
    assert any(f"{table.loc[0, 'command_rms']:.4g}" in line for line in lines), "of a small force, too"


def test_a_set_is_picked_with_the_commands_and_the_disturbance_of_its_exploration(tmp_path):
    one, share = bench(), np.array([[1.0, 1.0, 0.5]])
    names, none = ("amplifier", "fan", "wind"), (0.0,) * 3
    three = replace(one, b=one.b @ share, d=one.d @ share, inputs=names, input_delay=none)
    given = {"noise": [1], "noise_duration": 8.0, "workers": 1, "force_limit": 0.2, "sets": 1, "folder": tmp_path}
    roles = {"commands": ["fan"], "disturbance": "wind"}
    found = abrace.explore(three, BENCH_WEIGHTS, excitation_rms=30.0, **roles, **given)
    # the middle is what design makes of the same words: its weights are over the responses to this disturbance
    designed = abrace.design(three, BENCH_WEIGHTS, excitation_rms=30.0, sample_period=PERIOD, force_limit=0.2, **roles)
    assert str(found.outcomes[0].weights) in designed.controller.weights
    with pytest.raises(abrace.AbraceError, match=r"scale.reduction: 0.5, expected \S+ at least on this rig"):
        abrace.explore(three, BENCH_WEIGHTS, excitation_rms=1e-8, **roles, **given)
    assert main(["explore", "none", "--pick", "1", "--output", str(tmp_path)]) == 0
    assert load_controller(tmp_path / "set_1.yaml").law.outputs == ("fan",)
