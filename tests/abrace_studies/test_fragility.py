# SPDX-License-Identifier: Apache-2.0
"""Fragility: what is varied, every loop of it, the curves, the files of finished batches, the figures."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow
import pytest
from scipy import optimize
from scipy.stats import norm

from abrace_core import AbraceError
from abrace_core.files.checksum import checksum
from abrace_core.model.controller_file import Controller
from abrace_core.model.linear_model import LinearModel
from abrace_core.model.simulation import simulate, simulate_closed_loop
from abrace_plant.rig.file import load_rig
from abrace_studies.batches.loop_extremes import Motions
from abrace_studies.batches.parts import Parts, read_parts
from abrace_studies.fragility import study as study_module
from abrace_studies.fragility.assessment import Fragility, assess, save
from abrace_studies.fragility.curves import fragility_curve
from abrace_studies.fragility.figures import Subject
from abrace_studies.fragility.loops import compute_batch, faulty
from abrace_studies.fragility.study import Fault, FragilityStudy, with_drifts

PERIOD = 0.002
RIG = load_rig(Path(__file__).parents[2] / "src/abrace_plant/config/ncree_three_storey.yaml")
INTENSITIES = (0.5, 2.0, 6.0)
LIMIT = 2000.0


def controller(name: str = "damper") -> Controller:
    """A force against the first floor's velocity, from its accelerometer."""
    law = LinearModel([[0.998]], [[PERIOD]], [[-3.0e4]], [[0.0]], ("a1",), ("U",), PERIOD)
    return Controller(name, law, np.zeros((1, 1)), np.zeros((1, 2)), np.array([LIMIT]), "", "", "")


def study(**changes: object) -> FragilityStudy:
    grounds = [np.random.default_rng(seed).standard_normal(samples) for seed, samples in ((1, 1500), (2, 1000))]
    given = FragilityStudy(
        (RIG.model, replace(RIG.model, a=RIG.model.a * 0.95)),
        (controller(),),
        (Fault("a1", -1.0),),
        Motions.of(ground / np.abs(ground).max() for ground in grounds),
        ("one", "two"),
        INTENSITIES,
        PERIOD,
    )
    return replace(given, **changes)


def rows_of(given: FragilityStudy) -> list[dict]:
    return [row for batch in given.batches() for row in compute_batch(given, batch).to_pylist()]


def test_every_row_is_what_the_simulated_loop_does():
    given = study()
    rows = rows_of(given)
    assert len(rows) == given.loops == 2 * 3 * 2 * 3
    saturated = 0
    for row in rows:
        plant = given.plant(row["model"])
        number = given.motion_names.index(row["motion"])
        ground = row["intensity"] * given.motions.ground[number, : given.motions.samples[number]]
        if row["controller"] == "zero command":
            outputs, commands = simulate(plant.select(inputs=["w"]), ground[:, None]), np.zeros((len(ground), 1))
        else:
            law = controller().law
            law = law if row["fault"] == "none" else faulty(law, Fault("a1", -1.0))
            outputs, commands = simulate_closed_loop(plant, law, ground, np.array([LIMIT]))
        for name, values in zip((*plant.outputs, "U"), np.hstack([outputs, commands]).T, strict=True):
            assert row[f"peak_{name}"] == pytest.approx(np.abs(values).max(), rel=1e-9, abs=1e-12), (row, name)
            assert row[f"rms_{name}"] == pytest.approx(np.sqrt(np.mean(values**2)), rel=1e-9, abs=1e-12), (row, name)
        assert row["saturated"] == np.count_nonzero(np.abs(commands) >= LIMIT)
        saturated += row["saturated"] > 0
    assert 0 < saturated < len(rows), "some loops should have saturated, and some not"


def test_drifts_are_differences_of_floors():
    plant = with_drifts(RIG.model)
    assert plant.outputs[-3:] == ("d1", "d2", "d3")
    assert np.array_equal(plant.c[-2], RIG.model.c[1] - RIG.model.c[0])
    assert plant.unit("d2") == "m"
    own = RIG.model.select(["x1", "a1"])
    own = replace(own, outputs=("x1", "d1"))
    assert with_drifts(own).outputs == ("x1", "d1"), "an output of its own has this name"


def test_batches_are_fixed_by_the_study_and_hold_every_case_once(monkeypatch):
    given = study()
    whole = [case for batch in given.batches() for case in batch]
    assert whole == given.cases()
    monkeypatch.setattr(study_module, "BATCH_STEPS", 5000)
    small = given.batches()
    assert len(small) > 6
    assert sum(case.last - case.first for batch in small for case in batch) * len(INTENSITIES) == given.loops
    by_key = {(r["model"], r["controller"], r["fault"], r["motion"], r["intensity"]): r for r in rows_of(given)}
    monkeypatch.undo()
    for row in rows_of(given):
        assert str(row) == str(by_key[row["model"], row["controller"], row["fault"], row["motion"], row["intensity"]])


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"intensities": (1.0, 1.0)}, "expected numbers above 0 that rise"),
        ({"controllers": (controller(), controller())}, "expected a different name for each"),
        ({"faults": (Fault("a7", 0.0),)}, "fault a7=0: no controller measures a7, expected one of a1"),
        ({"sample_period": 0.01}, "every 0.002 s, expected the motions' 0.01 s"),
        ({"models": ()}, "no models"),
    ],
)
def test_a_study_whose_parts_do_not_fit_is_refused(change, expected):
    with pytest.raises(AbraceError, match=expected):
        study(**change)


def test_a_curve_is_the_one_of_greatest_likelihood():
    intensity = np.array([0.5, 1.0, 2.0, 3.0, 5.0])
    generator = np.random.default_rng(3)
    loops = np.full((40, 5), 10)
    exceeded = generator.binomial(loops, norm.cdf(np.log(intensity / 2.2) / 0.4))
    found = fragility_curve(intensity, loops, exceeded)

    def minus_log_likelihood(values):
        return -np.sum(
            exceeded * norm.logcdf(np.log(intensity / values[0]) / values[1])
            + (loops - exceeded) * norm.logsf(np.log(intensity / values[0]) / values[1])
        )

    best = optimize.minimize(minus_log_likelihood, (1.0, 1.0), method="Nelder-Mead", options={"xatol": 1e-9})
    assert (found.median, found.dispersion) == pytest.approx(best.x, rel=1e-4)
    low, high = found.median_interval()
    assert low < 2.2 < high
    assert high / low < 1.15
    lower, upper = found.band(intensity)
    assert np.all((lower <= found.probability(intensity)) & (found.probability(intensity) <= upper))
    assert found.fractions == pytest.approx(exceeded.sum(axis=0) / 400)


def test_loops_of_one_motion_are_no_independent_observations():
    intensity = np.array([1.0, 2.0, 4.0])
    strengths = np.random.default_rng(4).lognormal(np.log(2.0), 0.5, 12)
    exceeded = (intensity > strengths[:, None]).astype(int)
    one = fragility_curve(intensity, np.ones_like(exceeded), exceeded).median_interval()
    copied = fragility_curve(intensity, 100 * np.ones_like(exceeded), 100 * exceeded).median_interval()
    assert copied == pytest.approx(one, rel=0.02), "a hundred equal models tell nothing more"


def test_a_limit_that_is_never_or_always_exceeded_has_no_curve():
    intensity, loops = np.array([1.0, 2.0]), np.full((3, 2), 4)
    for exceeded, between in ((0 * loops, (2.0, np.inf)), (loops, (0.0, 1.0))):
        found = fragility_curve(intensity, loops, exceeded)
        assert np.isnan(found.median)
        assert not len(found.resampled)
        assert found.median_interval() == between


@pytest.mark.parametrize(
    ("exceeded", "between"),
    [
        (np.tile([0, 1, 1], (10, 1)), (1.0, 2.0)),
        (np.tile([0, 0, 1], (10, 1)), (2.0, 4.0)),
        (np.array([[0, 1, 1]] * 4 + [[0, 0, 1]] * 6), (1.0, 4.0)),
        (np.array([[0, 0, 1]] + [[0, 0, 0]] * 9), (2.0, np.inf)),
        (np.array([[0, 1, 1]] + [[1, 1, 1]] * 9), (0.0, 2.0)),
    ],
)
@pytest.mark.parametrize("motions", [1, 10])
def test_counts_that_an_intensity_separates_give_an_interval_and_no_edge_of_the_search(exceeded, between, motions):
    """Their likelihood rises as the dispersion falls to 0 (Silvapulle 1981): all medians between are as likely."""
    exceeded = exceeded if motions == 10 else exceeded.sum(axis=0, keepdims=True)
    loops = np.full_like(exceeded, 10 // motions)
    found = fragility_curve(np.array([1.0, 2.0, 4.0]), loops, exceeded)
    assert np.isnan(found.median)
    assert np.isnan(found.dispersion)
    assert found.between == between
    low, high = found.median_interval()
    assert low <= between[0]
    assert high >= between[1]


def test_fewer_loops_beyond_the_limit_at_more_intensity_have_no_curve():
    loops, exceeded = np.full((4, 2), 10), np.tile([8, 2], (4, 1))
    found = fragility_curve(np.array([1.0, 2.0]), loops, exceeded)
    assert np.isnan(found.median)
    assert np.isnan(found.dispersion), "the greatest dispersion that is searched is no estimate"


def test_resamples_in_which_nothing_exceeds_the_limit_leave_the_median_without_an_upper_end():
    intensity, loops = np.array([1.0, 2.0, 4.0]), np.ones((20, 3), dtype=int)
    exceeded = np.zeros_like(loops)
    exceeded[7, 1:] = 1
    found = fragility_curve(intensity, loops, exceeded)
    without = np.isinf(found.resampled[:, 1])
    assert len(found.resampled) == 400, "no resample should have been left out"
    assert np.mean(without) == pytest.approx(0.95**20, abs=0.08), "as often as the one motion is not drawn"
    low, high = found.median_interval()
    assert 1.0 < low <= found.median
    assert high == np.inf
    lower, upper = found.band(intensity)
    assert np.all(lower == 0.0), "no loop of more than 2.5 % of the resamples exceeds the limit"
    assert upper[-1] > 1 / 20


def test_resamples_in_which_everything_exceeds_the_limit_have_a_median_of_zero():
    intensity, loops = np.array([1.0, 2.0, 4.0]), np.ones((20, 3), dtype=int)
    exceeded = np.ones_like(loops)
    exceeded[7, :2] = 0
    found = fragility_curve(intensity, loops, exceeded)
    low, high = found.median_interval()
    assert low == 0.0
    assert found.median <= high < 2.0
    lower, upper = found.band(intensity)
    assert np.all(upper == 1.0)
    assert np.all(lower <= found.probability(intensity))


def test_a_median_without_an_upper_end_is_written_and_drawn(tmp_path):
    intensity, loops = np.array(INTENSITIES), np.ones((20, 3), dtype=int)
    exceeded = np.zeros_like(loops)
    exceeded[7, 1:] = 1
    curve = fragility_curve(intensity, loops, exceeded)
    subject = Subject("damper", "none", {"d1": curve}, np.array([1e3, 2e3, 3e3]), np.zeros(3))
    found = Fragility(
        tmp_path, {"d1": 0.01}, INTENSITIES, (replace(subject, controller="zero command"), subject), units={"d1": "m"}
    )
    save(found)
    assert re.search(r"damper: d1 above 0.01 m: median \S+ m/s\^2 \(\S+ or more\), dispersion", found.text())
    (_, row) = json.loads((tmp_path / "fragility.json").read_text(encoding="utf-8"))["curves"]
    assert row["high"] is None
    assert row["low"] < row["median"]
    (curves,) = found.plot().axes
    assert np.isfinite(curves.axis()).all()


def test_finished_batches_are_kept_and_results_of_other_inputs_are_never_mixed(tmp_path):
    given = study(models=(RIG.model,))
    table = compute_batch(given, given.batches()[0])
    parts = Parts(tmp_path / "loops", checksum(given), 3)
    assert parts.missing() == [0, 1, 2]
    parts.write(1, table)
    parts.write(0, table)
    assert Parts(tmp_path / "loops", checksum(given), 3).missing() == [2]
    assert parts.path(0).read_bytes() == parts.path(1).read_bytes()
    (tmp_path / "loops/.4711.part-000002.parquet").write_bytes(b"a killed process has left this")
    assert parts.missing() == [2]
    parts.clean()
    assert {path.name for path in (tmp_path / "loops").iterdir()} == {parts.path(number).name for number in (0, 1)}
    assert str(read_parts(tmp_path / "loops").to_pylist()) == str(2 * table.to_pylist())
    other = replace(given, intensities=(0.5, 2.0, 6.5))
    with pytest.raises(AbraceError, match=r"part-00000\d.parquet: computed from other inputs"):
        Parts(tmp_path / "loops", checksum(other), 3)
    parts.path(0).write_bytes(b"no parquet")
    with pytest.raises(AbraceError, match=r"part-000000.parquet: .* expected a Parquet file"):
        Parts(tmp_path / "loops", checksum(given), 3)
    with pytest.raises(AbraceError, match="no part-"):
        read_parts(tmp_path)


def test_a_peak_that_is_not_a_number_is_beyond_a_limit(tmp_path):
    given = study(models=(RIG.model,))
    table = compute_batch(given, given.batches()[0])
    unknown = table.set_column(
        table.column_names.index("peak_x1"), "peak_x1", pyarrow.array(np.full(len(table), np.nan))
    )
    Parts(tmp_path / "loops", checksum(given), 1).write(0, unknown)
    found = assess(given, {"x1": 1.0}, tmp_path)
    assert all((each.curves["x1"].exceeded == each.curves["x1"].loops).all() for each in found.subjects)


def test_curves_are_fitted_to_the_loops_and_drawn(tmp_path):
    given = study()
    batches = given.batches()
    parts = Parts(tmp_path / "loops", checksum(given), len(batches))
    for number, batch in enumerate(batches):
        parts.write(number, compute_batch(given, batch))
    found = assess(given, {"d1": 0.004, "a3": 100.0}, tmp_path)
    rows = rows_of(given)
    for subject in found.subjects:
        own = [r for r in rows if (r["controller"], r["fault"]) == (subject.controller, subject.fault)]
        expected = [sum(r["peak_d1"] > 0.004 for r in own if r["intensity"] == each) for each in INTENSITIES]
        assert subject.curves["d1"].exceeded.tolist() == expected
        assert subject.curves["d1"].loops.tolist() == [4, 4, 4]
        assert np.isnan(subject.curves["a3"].median)
    assert [(s.controller, s.fault) for s in found.subjects] == [
        ("zero command", "none"),
        ("damper", "none"),
        ("damper", "a1=-1"),
    ]
    save(found)
    assert (tmp_path / "fragility.svg").stat().st_size > 5000
    assert len((tmp_path / "fragility.csv").read_text().splitlines()) == 1 + 3 * 2
    assert "zero command: a3 above 100 m/s^2: 0% of 12 loops, no curve" in found.text()
    assert found.to_pandas().shape[0] == 6
