# SPDX-License-Identifier: Apache-2.0
"""Every documented value of every verb's options, and runs on small data that give each of them a result.

A value of an enumeration has to be in a run, as have each option's default and some other value. A new option or value
that is in no run is among `missing`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from bag_of_run import write_bag
from laboratory import paper_tests

import abrace
from abrace_core.files.config_file import validated
from abrace_core.model.simulation import simulate as simulate_model
from abrace_lqg.proof.limits import DesignOptions
from abrace_lqg.weights import Weights, save_weights
from abrace_plant.nodes.record_parameters import RECORD_PARAMETERS, read_as_given
from abrace_plant.records.options import RecordOptions, SimulateOptions, Treatment
from abrace_plant.records.reading import UNITS
from abrace_plant.records.treatment import prepare
from abrace_studies.options import ExploreOptions, FragilityOptions
from abrace_sysid.ambient.modes import AmbientOptions
from abrace_sysid.data_identification import DataOptions
from abrace_sysid.fitting.options import IdentificationOptions
from abrace_sysid.spectra.estimation import TransferFunctionOptions

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from abrace_core.files.options import Options
    from abrace_core.model.run import Run

RIG = "ncree_three_storey"
POLES = [7.363, 22.933, 37.964]
"""Of the rig with zero command [rad/s]."""

WELCH = {"transfer_function": "welch", "segment": 8192}
LOCAL = {"transfer_function": "local_polynomial", "degree": 4, "half_width": 6}
FAST: dict[str, Any] = {"method": "vector_fitting"}
STUDY: dict[str, Any] = {
    "noise": [1, 2],
    "noise_band": (0.2, 9.0),
    "noise_duration": 4.0,
    "models": 2,
    "faults": {"a1": [0.0, -1.0]},
    "seed": 1,
    "sample_period": 0.002,
    "workers": 1,
    "disturbance": "w",
}
LIMITS: dict[str, Any] = {"limits": {"d1": 0.01}, "intensities": [0.5, 2.0]}
RUNS: dict[str, tuple[type[Options], list[dict[str, Any]]]] = {
    "identify": (
        IdentificationOptions,
        [
            {},
            {**FAST, "table_band": (0.3, 9.0), "command_band": (0.0, 30.0), "modes": 6, "reduced_order": 8},
            {"method": "paper", "lambda_power": -6.0, "lambda_steps": 3, "servo_lag": 0.0008},
            WELCH,
            {**FAST, **LOCAL},
        ],
    ),
    "transfer_functions": (
        TransferFunctionOptions,
        [{}, WELCH, LOCAL],
    ),
    "identify_data": (
        DataOptions,
        [
            {"inputs": "w", "sample_rate": 50.0},
            {
                "inputs": ["w"],
                "outputs": ["x1", "x3"],
                "time": "t",
                "units": {"x1": "m"},
                "hold": "zero",
                "band": (0.5, 8.0),
                "modes": 2,
                "held_out": 0.2,
                **WELCH,
                "segment": 512,
            },
            {"inputs": ["w"], "outputs": ["x1", "x3"], "sample_rate": 50.0, "band": (0.5, 8.0), "order": 6, **LOCAL},
        ],
    ),
    "identify_ambient": (AmbientOptions, [{}, {"channels": ["a1", "a3"], "band": (0.5, 8.0), "highest_order": 24}]),
    "design": (
        DesignOptions,
        [
            {},
            {
                "gain_margin": 60.0,
                "phase_margin": 89.0,
                "delay_margin": 1.0,
                "disk_margin": 1.9,
                "damping_kept": 9.0,
                "draws": 2,
                "draw_seed": 3,
                "sample_period": 0.002,
                "force_limit": 2e4,
                "commands": ["U"],
                "disturbance": "w",
                "excitation_rms": 0.1,
                "excitation_band": (0.3, 9.0),
                "accept": [*DesignOptions.listed()["accept"].choices],
            },
        ],
    ),
    "explore": (
        ExploreOptions,
        [
            {"noise": 1},
            {"sets": 2},
            {
                **STUDY,
                "sets": 2,
                "measured": ["a1", "a2"],
                "displacement": (-1.0, 0.0),
                "acceleration": (0.0, 0.0),
                "noise_to_excitation": (0.0, 1.0),
                "peak_acceleration": [0.5, 1.0],
                "quantile": 1.0,
                "force_limit": 2e4,
                "commands": ["U"],
                "excitation_rms": 0.3,
                "signals": (0.0, 0.5),
                "stroke": (0.0, 0.5),
                "force": (0.0, 0.5),
                "drift": (0.0, 0.5),
                "base_shear": (0.0, 0.5),
            },
        ],
    ),
    "fragility": (FragilityOptions, [{**LIMITS, "noise": 1}, LIMITS, {**LIMITS, **STUDY}]),
    "simulate": (
        SimulateOptions,
        [
            {},
            *({"baseline": each, "duration": 4.0} for each in ("constant", "linear", "quadratic")),
            {
                "time_scale": 0.9,
                "taper": 0.5,
                "low_cut": 0.2,
                "band_limit": 20.0,
                "peak_acceleration": 0.5,
                "seed": 4,
                "sample_period": 0.002,
                "duration": 4.0,
            },
            {"disturbance": "w", "sample_period": 0.002, "duration": 4.0},
        ],
    ),
    "record": (
        RecordOptions,
        [
            {},
            *({"unit": unit, "record_sample_period": 0.02, "channel": "y"} for unit in UNITS),
            *({"baseline": each} for each in ("constant", "linear", "quadratic")),
            {"time_scale": 0.9, "taper": 0.5, "low_cut": 0.2, "band_limit": 20.0, "peak_acceleration": 0.5},
        ],
    ),
}
"""The class of options of every verb, and its runs. Dask needs a scheduler: `tests/abrace_studies/test_batches.py`."""
SLOW = {
    ("explore", 0),
    ("identify", 3),
    ("identify_data", 0),
}
"""Verbs and numbers of runs of five seconds and more."""
ELSEWHERE = {
    *(("explore", "scheduler"), ("fragility", "scheduler")),
    *(("simulate", name) for name in ("unit", "record_sample_period", "channel")),
    *(("identify_ambient", name) for name in ("sample_rate", "time")),
}
"""Of files: `tests/abrace/test_interactive.py`."""


def documented(options: type[Options]) -> set[tuple[str, str]]:
    """Options and values: each of an enumeration, else `default` (where there is one) and `given`."""
    found: set[tuple[str, str]] = set()
    for name, option in options.listed().items():
        if option.choices:
            found |= {(name, choice) for choice in option.choices}
        else:
            found |= {(name, "given")} | (set() if option.required else {(name, "default")})
    return found


def covered(options: type[Options], run: dict[str, Any]) -> set[tuple[str, str]]:
    """Those that a `run` gives a result to."""
    found: set[tuple[str, str]] = set()
    for name, option in options.listed().items():
        value = run.get(name, option.default)
        if option.choices:
            found |= {(name, each) for each in (value if isinstance(value, list) else [value])}
        else:
            found.add((name, "given" if name in run else "default"))
    return found


def missing(verb: str) -> set[tuple[str, str]]:
    """Documented values of a `verb` that no run has."""
    options, runs = RUNS[verb]
    of_runs = set().union(*(covered(options, run) for run in runs))
    return {each for each in documented(options) - of_runs if (verb, each[0]) not in ELSEWHERE}


@dataclass(frozen=True)
class Data:
    """Small data for all verbs: two tests of 70 s of the paper's rig, and what follows from them, in a `folder`."""

    folder: Path

    @cached_property
    def tests(self) -> tuple[Run, Run]:
        """A test of the table and one of the braces, without control."""
        return paper_tests(70.0, 3)

    @cached_property
    def bags(self) -> tuple[Path, Path]:
        """The bags of both tests."""
        for name, run in zip(("table", "command"), self.tests, strict=True):
            write_bag(run, self.folder / name)
        return self.folder / "table", self.folder / "command"

    @cached_property
    def columns(self) -> dict[str, Any]:
        """A storey of 1.17 Hz under white noise up to half the sample rate, 80 s at 50 Hz."""
        a = [[0.0, 1.0], [-(POLES[0] ** 2), -0.03 * POLES[0]]]
        storey = abrace.LinearModel(
            np.array(a),
            np.array([[0.0], [-1.0]]),
            np.array([[1.0, 0.0], a[1]]),
            np.zeros((2, 1)),
            ("w",),
            ("x1", "x3"),
        )
        random = np.random.default_rng(4)
        ground = random.standard_normal((4000, 1))
        x = simulate_model(abrace.discretize(storey, 0.02, {}), ground)
        x += 1e-3 * x.std(axis=0) * random.standard_normal(x.shape)
        return {"t": 0.02 * np.arange(4000), "w": ground[:, 0], "x1": x[:, 0], "x3": x[:, 1]}

    @cached_property
    def law(self) -> Path:
        """A controller's file."""
        written: Path = abrace.design(self.model, "lqg3", rig=RIG, draws=0).save(self.folder / "law.yaml")[0]
        return written

    def written(self, folder: Path) -> dict[str, Path]:
        """The measured data and the weights as files in a `folder`."""
        np.savez(folder / "data.npz", **self.columns)
        save_weights(validated(self.weights, Weights, "weights"), folder / "weights.yaml", "documented")
        return {"data": folder / "data.npz", "weights": folder / "weights.yaml"}

    @cached_property
    def identified(self) -> Any:
        """The identification by all defaults."""
        return abrace.identify(*self.tests)

    @cached_property
    def model(self) -> Path:
        """Its folder: a model with a covariance of its parameters."""
        folder: Path = self.identified.save(self.folder / "model")
        return folder

    @cached_property
    def weights(self) -> dict[str, Any]:
        """Weights of every kind of signal."""
        kinds = {"displacement": 1e9, "stroke": 1e3, "acceleration": 1e3, "force": 1e-9, "command": 1.0}
        sums = {"drift": 1e6, "base_shear": 1e-9}
        masses = abrace.load_rig(RIG).model.provenance.get("masses", [6000.0] * 3)
        weights = {**kinds, **sums}
        return {"measured": ["a1", "a2", "a3"], "weights": weights, "noise_to_excitation": 0.1, "masses": masses}


def result(verb: str, run: dict[str, Any], data: Data, number: int = 0) -> None:
    """Run a `verb` with the options of a `run`, the one of this `number`, on small `data`, and look at its result."""
    VERBS[verb](run, data, data.folder / f"{verb}_{number}")


def _poles(found: Sequence[float], within: float) -> None:
    for pole in POLES:
        near = min(abs(one / pole - 1) for one in found)
        assert near < within, f"pole {pole} rad/s, found {list(found)}"


def _identify(run: dict[str, Any], data: Data, _folder: Path) -> None:
    found = abrace.identify(*data.tests, **run) if run else data.identified
    # Welch's method smears the narrow resonances of so short a test
    within = 0.1 if run.get("transfer_function") == "welch" else 0.01
    _poles([pair.frequency for pair in found.found.poles.table_pairs], within)
    assert found.reduced.order <= found.model.order
    assert found.reduced.order == run.get("reduced_order", found.reduced.order)
    assert len(found.to_pandas()) >= 3
    assert found.validity.verdict.words


def _transfer_functions(run: dict[str, Any], data: Data, _folder: Path) -> None:
    found = abrace.transfer_functions(data.tests[0], "w", band=(0.5, 9.0), **run)
    top = np.abs(found.select(["a3"]).response[:, 0])
    assert abs(found.omega[np.argmax(top)] / POLES[0] - 1) < 0.02
    assert found.method.lower().startswith(run.get("transfer_function", "local_rational").replace("_", " "))


def _identify_data(run: dict[str, Any], data: Data, _folder: Path) -> None:
    columns = data.columns if "time" in run else {name: data.columns[name] for name in ("w", "x1", "x3")}
    found = abrace.identify_data(columns, **run)
    assert 0 < len(found.to_pandas()) <= run.get("modes", run.get("order", 120) // 2)
    assert sum(len(one.outputs) for one in found.held_out) == round(run.get("held_out", 0.0) * len(data.columns["t"]))
    assert min(abs(pair.frequency / POLES[0] - 1) for pair in found.found.pairs) < 0.02
    assert found.validity.verdict.words


def _identify_ambient(run: dict[str, Any], data: Data, _folder: Path) -> None:
    found = abrace.identify_ambient(data.tests[0], before=data.tests[0] if run else (), **run)
    assert found.found.channels == tuple(run.get("channels", ("a1", "a2", "a3")))
    assert min(abs(mode.frequency / POLES[1] - 1) for mode in found.found.modes) < 0.01
    assert (found.change is None) == (not run)
    assert found.change is None or not found.change.changed


def _design(run: dict[str, Any], data: Data, _folder: Path) -> None:
    found = abrace.design(data.model, "lqg3", rig=RIG, **run)
    assert found.proof.limits.gain_margin == run.get("gain_margin", 6.0)
    assert found.controller.law.sample_period == 0.002
    assert found.controller.force_limit[0] == run.get("force_limit", abrace.load_rig(RIG).capacity[0])
    assert bool(found.proof.accepted) == ("accept" in run)
    drawn = [each.ensemble for each in found.proof.models if each.ensemble is not None]
    assert [one.count for one in drawn] == [run.get("draws", 30)]


def _explore(run: dict[str, Any], data: Data, folder: Path) -> None:
    weights, records = data.weights if "drift" in run else "lqg3", () if "noise" in run else "el_centro"
    found = abrace.explore(data.model, weights, records=records, rig=RIG, folder=folder, **run)
    assert len(found.outcomes) == 1 + run.get("sets", 256)
    assert len(found.to_pandas()) > len(found.outcomes) / 2
    assert found.quantile == run.get("quantile", 0.9)
    assert (folder / "exploration.json").is_file()


def _fragility(run: dict[str, Any], data: Data, folder: Path) -> None:
    law = abrace.design(data.model, "lqg3", rig=RIG, draws=0)
    records = () if "noise" in run else "el_centro"
    found = abrace.fragility(data.model, law, records=records, folder=folder, **run)
    tried = 2 + len(run.get("faults", {}).get("a1", []))
    assert len(found.loops()) == run.get("models", 1) * tried * np.size(run.get("noise", 1)) * 2
    assert "zero command" in found.text()


def _simulate(run: dict[str, Any], _data: Data, _folder: Path) -> None:
    record = "el_centro" if run else 0.1 * np.sin(np.arange(2000) * np.pi / 100) * np.hanning(2001)[:-1]
    found = abrace.simulate(abrace.load_rig(RIG).model if "disturbance" in run else RIG, record, **run)
    assert np.isfinite(found.outputs).all()
    assert len(found.outputs) == 2000, "4 s"


def columns_in(folder: Path) -> str:
    """The name of a file with two columns of 400 numbers."""
    name = f"{folder}.csv"
    np.savetxt(name, np.random.default_rng(1).standard_normal((400, 2)), delimiter=",", header="x,y", comments="")
    return name


def _record(run: dict[str, Any], _data: Data, folder: Path) -> None:
    name = "el_centro"
    if "unit" in run:
        name = columns_in(folder)
    given = {each.name: each.default for each in RECORD_PARAMETERS} | run
    values = type("Given", (), given)
    motion = prepare(read_as_given(name, values), 500.0, Treatment.of_values(values))
    assert np.isfinite(motion).all()
    assert motion.any()


VERBS: dict[str, Callable[[dict[str, Any], Data, Path], None]] = {
    "identify": _identify,
    "transfer_functions": _transfer_functions,
    "identify_data": _identify_data,
    "identify_ambient": _identify_ambient,
    "design": _design,
    "explore": _explore,
    "fragility": _fragility,
    "simulate": _simulate,
    "record": _record,
}


def _is_none(found: Any) -> bool:
    return found is None


WORDS = "trust", "trust with care"
Call = tuple[str, "Callable[[Data, Path], dict[str, Any]]", "Callable[[Any], bool]"]
CALLS: list[Call] = [
    ("validate", lambda d, _: {"test": d.tests[1], "model": d.model}, lambda it: it.finding.verdict.words in WORDS),
    (
        "validate",
        lambda d, _: {
            "test": abrace.simulate(RIG, "el_centro", controller=d.law, duration=10.0, peak_acceleration=0.98),
            "model": d.model,
            "controller": d.law,
        },
        lambda it: it.finding.verdict.words in WORDS and it.comparison.simulated_peak_rms()["U"].peak > 0,
    ),
    (
        "validate",
        lambda d, _: {
            "test": d.columns,
            "model": abrace.identify_data(d.columns, ["w"], time="t", hold="zero"),
            "time": "t",
            "sample_rate": 50.0,
            "outputs": ["x1"],
            "hold": "zero",
        },
        lambda it: it.finding.verdict.words in WORDS and it.comparison.names == ("x1",),
    ),
    ("margins", lambda d, _: {"model": d.model, "controller": d.law}, lambda it: it.gain_db > 6.0),
    ("discretize", lambda *_: {"model": RIG, "sample_period": 0.002}, lambda it: it.sample_period == 0.002),
    (
        "discretize",
        lambda *_: {"model": RIG, "sample_period": 0.002, "holds": {"w": "zero", "U": "first"}},
        lambda it: it.sample_period == 0.002,
    ),
    ("save_model", lambda d, here: {"model": d.identified, "path": here / "model.json"}, _is_none),
    ("save_model", lambda _, here: {"model": RIG, "path": here / "rig.json", "covariance": np.eye(98)}, _is_none),
    ("load_model", lambda _, here: {"path": here / "model.json"}, lambda it: it.inputs == ("w", "U")),
    ("save_mat", lambda d, here: {"given": abrace.load_controller(d.law), "path": here / "law.mat"}, _is_none),
    ("load_controller", lambda _, here: {"path": here / "law.mat"}, lambda it: it.law.outputs == ("U",)),
    ("load_rig", lambda *_: {"rig": RIG}, lambda it: it.floors == 3),
    ("load_record", lambda *_: {"record": "el_centro"}, lambda it: len(it.acceleration) > 1000),
    (
        "load_record",
        lambda _, here: {"record": columns_in(here), "unit": "g", "sample_period": 0.02, "channel": "y"},
        lambda it: len(it.acceleration) == 400,
    ),
    ("read_run", lambda d, _: {"bag": d.bags[0]}, lambda it: it.floors == 3),
    ("read_run", lambda d, _: {"bag": d.bags[0], "topic": "/response"}, lambda it: it.floors == 3),
    ("read_runs", lambda d, _: {"bag": d.bags[1], "topic": "/response"}, lambda it: it[0].floors == 3),
    ("characterize", lambda *_: {"rig": RIG}, lambda it: len(it.to_pandas()) > 3),
]
"""Of every function without options: its keywords, and whether a result is right. In this order, one reads what another
wrote."""
