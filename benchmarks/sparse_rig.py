# SPDX-License-Identifier: Apache-2.0
"""A rig with accelerometers on three of six floors, from noise tests to LQG: in lockstep, on the UDP target, simulated.

pole_error   greatest relative error of a frequency that was identified in lockstep, of the poles of the whole rig
outside      frequencies and damping ratios outside their 95 % intervals, of how many, and the worst in deviations
false_words  sentences of a report, of validity or of a node that name a channel which is not measured, but for the one
             with which the rig says what it does not measure
prediction   worst error without sensor noise of the controlled earthquake's channels, by the identified model
"""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from claims import Claim
from isolation import isolated
from udp_target import device_file

import abrace
from abrace.campaign.course import run_campaign
from abrace.report.results import read_results
from abrace.report.table import Table
from abrace.report.writer import make_report
from abrace_bags import read_run
from abrace_core.files.installed import find_file
from abrace_core.model.verdict import Verdict
from abrace_plant.rig.file import load_rig

if TYPE_CHECKING:
    from abrace_plant.rig.model import Rig

RIG = "six_storey"
SAID = "not measured: "
"""Beginning of the rig's own sentence about what it does not measure."""
BLAME = re.compile(r"dead|stuck|zero|left out|never changes|not in the model|has no|missing|not judged|respond|answer")
"""What a sentence that is not true of a channel without a sensor says; the design's table predicts them, which is."""
NOISE: dict[str, Any] = {"record": "white_noise", "rms": 0.25, "band": [0.1, 16.0], "seed": 1}
QUAKE: dict[str, Any] = {"record": "el_centro", "peak_acceleration": 0.980665}
WAYS: dict[str, tuple[float, dict[str, Any]]] = {
    "lockstep": (240.0, {"lockstep": True}),
    "udp": (120.0, {"emulator": True, "thread_priority": 50}),
}
"""Of each way: seconds of a noise test, and keys of its campaign."""


def verify_sparse_rig() -> tuple[dict[str, Any], list[Claim], list[Table]]:
    """Values for verify.json, claims, and a table of the poles."""
    rig = load_rig(find_file(RIG, "abrace_plant", "config", ".yaml", "rig"))
    with isolated():
        found = {way: _campaign(rig, way) for way in WAYS}
        simulated = _simulated(rig)
    lockstep = found["lockstep"]
    accelerometers = [name for name in rig.channel_names if name[0] == "a"]
    values = {
        "channels": len(accelerometers),
        "of": rig.floors,
        "measured": list(rig.channel_names),
        "pole_error": lockstep["pole_error"],
        "false_words": sum(one["false_words"] for one in found.values()),
        "simulated": simulated,
        **found,
    }
    claims = []
    for way, one in found.items():
        claims += [
            Claim(
                f"six floors, three accelerometers, {way}: worst pole, in deviations", one["worst"], 3.5, "95 %: 1.96"
            ),
            Claim(
                f"... {way}: share of frequencies and damping in their 95 % intervals", one["within"], 0.8, "0.95", True
            ),
            Claim(f"... {way}: prediction with LQG, without noise", one["prediction"], 0.02, "of the rms"),
            Claim(f"... {way}: words about missing channels that are not true", one["false_words"], 0.0, "-"),
            Claim(f"... {way}: validity says trust", float(one["trusted"]), 1.0, "-", least=True),
        ]
    claims.append(Claim("... LQG in simulation: peak of a6 over that without", simulated["peak_ratio"], 0.6, "-"))
    rows = tuple(
        (way, *(f"{one[key]:.3g}" for key in ("pole_error", "worst", "within", "prediction", "false_words")))
        for way, one in found.items()
    )
    columns = ("", "worst frequency", "in deviations", "in 95 % intervals", "prediction", "false words")
    return values, claims, [Table("Six floors, accelerometers on three", columns, rows)]


def _campaign(rig: Rig, way: str) -> dict[str, Any]:
    seconds, keys = WAYS[way]
    name = f"six_storeys_{way}"
    if way == "udp":
        keys = {**keys, "device": str(_device(rig, Path.cwd()))}
    quake = {"duration": 60.0, "ground_motion": QUAKE}
    excitation = {"rms": 3500.0, "band": [0.0, 30.0], "seed": 2}
    steps: dict[str, dict[str, Any]] = {
        "table_noise": {"test": {"duration": seconds, "ground_motion": NOISE}},
        "command_noise": {"test": {"duration": seconds, "excitation": excitation}},
        "model": {"identify": {"table": "table_noise", "command": "command_noise"}},
        "half": {"design": {"model": "model", "weights": "half"}},
        "uncontrolled": {"test": quake},
        "controlled": {"test": {**quake, "controller": "half"}},
        "comparison": {
            "validate": {"test": "controlled", "uncontrolled": "uncontrolled", "model": "model", "controller": "half"}
        },
    }
    listed = [{"name": step} | one for step, one in steps.items()]
    content = {"name": name, "rig": RIG, **keys, "steps": listed}
    campaign = Path(f"{name}.yaml")
    campaign.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    results = run_campaign(campaign).results
    make_report(results)
    found = read_results(results)
    (bag,) = Path("bags", name).glob("*/controlled")
    run = read_run(bag)
    comparison = found.comparisons["comparison"]
    poles = json.loads((results / "model/poles.json").read_text(encoding="utf-8"))["common"]
    words = _false_words(rig, results)
    values = {
        **_errors(rig, poles),
        "prediction": max(row.noise_free_error for row in comparison.simulated_vs_measured.values()),
        "trusted": found.validity["model"].verdict is Verdict.TRUST,
        "not_trusted_for": [
            one.meaning for one in found.validity["model"].findings if one.verdict is not Verdict.TRUST
        ],
        "recorded": list(run.names),
        "false_words": len(words),
        "words": words[:10],
    }
    if run.names != rig.recorded_names:
        raise AssertionError(f"the bag has {run.names}, expected {rig.recorded_names}")
    shutil.rmtree(results)
    return values


def _device(rig: Rig, folder: Path) -> Path:
    """The device file of a target that sends what the rig has."""
    layout = find_file("udp_layout", "abrace_plant", "config/device_parts", ".yaml", "layout")
    content = yaml.safe_load(layout.read_text(encoding="utf-8"))
    commands = [f"U{group + 1}" for group in range(rig.groups)] + ["w"]
    for field in content["sample"] + content["command"]:
        if "applied_U" in field["field"]:
            field["field"] = [f"applied_{name}" for name in commands]
        elif "a1" in field["field"]:
            field["field"] = list(rig.channel_names)
        elif field["field"] == ["U", "w"]:
            field["field"] = commands
    path = folder / "layout.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return device_file(folder, timeout=0.02, layout=path)


def _errors(rig: Rig, poles: list[dict[str, float]]) -> dict[str, Any]:
    """Of identified pairs against the nearest of the whole rig's."""
    true = rig.model.poles
    true = true[true.imag > 0]
    errors, deviations = [], []
    for pole in poles:
        one = true[np.argmin(np.abs(np.abs(true) - pole["frequency"]))]
        frequency, damping = abs(one), -one.real / abs(one)
        errors.append(abs(pole["frequency"] / frequency - 1))
        deviations.append(abs(pole["frequency"] - frequency) / pole["frequency_deviation"])
        deviations.append(abs(pole["damping_ratio"] - damping) / pole["damping_ratio_deviation"])
    if len(poles) != len(true):
        raise AssertionError(f"{len(poles)} pairs identified, expected the rig's {len(true)}")
    return {
        "pairs": len(poles),
        "pole_error": max(errors),
        "worst": max(deviations),
        "within": float(np.mean(np.array(deviations) < 1.96)),
    }


def _false_words(rig: Rig, results: Path) -> list[str]:
    """Lines of texts of a campaign that name a channel which is not measured."""
    names = re.compile(rf"\b({'|'.join(rig.not_measured)})\b")
    texts = [results / "model/validity.json", results / "comparison/comparison.json", results / "summary.json"]
    texts += sorted((results / "nodes").rglob("*.log"))
    found = []
    for path in texts:
        for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
            if names.search(line) and BLAME.search(line) and SAID not in line:
                found.append(f"{path.name}: {line.strip()[:200]}")
    return found


def _simulated(rig: Rig) -> dict[str, float]:
    """LQG on the rig in simulation, with a design of the model of what is measured."""
    quake = QUAKE["record"]
    designed = abrace.design(rig.measured_model, "half", rig=rig)
    controlled = abrace.simulate(rig, quake, peak_acceleration=QUAKE["peak_acceleration"], controller=designed)
    without = abrace.simulate(rig, quake, peak_acceleration=QUAKE["peak_acceleration"])
    return {"peak_ratio": float(np.abs(controlled["a6"]).max() / np.abs(without["a6"]).max())}
