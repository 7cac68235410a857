# SPDX-License-Identifier: Apache-2.0
"""Exported controllers against the node: the commands that LQG3 gave in a lockstep run of El Centro, 100 s.

samples, peak        commands of the node while the rig runs, and their peak [N]
c_error, fmu_error   largest difference of the forces of the C99 sources, and of the co-simulation unit, from the
                     `brace_command` that the node sent, over its peak; they are given what the node was given
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from claims import Claim
from controller_speed import lqg3
from exported import InC, compiled, unit_answers
from isolation import isolated

from abrace.campaign.course import run_campaign
from abrace_bags import Bag
from abrace_core.files.writing import write_text
from abrace_core.model.controller_file import save_controller
from abrace_core.safety.rig_safety import State
from abrace_lqg.export.c_sources import write_c
from abrace_lqg.export.fmu import write_fmu

CAMPAIGN = """
name: export
rig: ncree_three_storey
lockstep: true
steps:
  - name: closed_loop
    test: {duration: 100.0, ground_motion: {record: el_centro, peak_acceleration: 0.980665}, controller: lqg3.yaml}
"""
RATE_LIMIT, RAMP_TIME = 2.5e6, 0.5
"""The node's own [N/s], [s]."""


def verify_export() -> tuple[dict[str, Any], list[Claim]]:
    """Values for verify.json, and claims."""
    with isolated():
        found = _errors(Path.cwd())
    names = {"c_error": "C99", "fmu_error": "co-simulation unit"}
    return found, [
        Claim(f"exported controller, {what}, of the peak", found[key], 1e-12, "-") for key, what in names.items()
    ]


def _errors(folder: Path) -> dict[str, float]:
    controller = lqg3()
    law = controller.law
    save_controller(controller, folder / "lqg3.yaml")
    write_text(folder / "export.yaml", CAMPAIGN)
    run_campaign(folder / "export.yaml")
    (bag,) = {path.parent for path in (folder / "bags").rglob("*.mcap")}
    run = Bag(bag).run()
    recorded = {name: topic.fields for name, topic in Bag(bag).arrays().items()}
    commands, responses = recorded["/export/brace_command"], recorded["/export/response"]
    runs = np.flatnonzero(responses["state"] == State.RUNNING)
    answered = commands["sequence"] >= responses["sequence"][runs[0]]  # before, the rig is armed: the node holds zero
    forces = np.asarray(commands["force"]).reshape(-1, len(law.outputs))[answered]
    places = np.searchsorted(run.sequence, commands["sequence"][answered])
    measured = run.outputs[places][:, [run.names.index(name) for name in law.inputs]]
    write_c(controller, folder / "c", RATE_LIMIT, RAMP_TIME)
    write_fmu(controller, folder / "lqg3.fmu", RATE_LIMIT, RAMP_TIME)
    in_c = InC(compiled(folder / "c"), law.order, len(law.outputs)).answers(measured)
    in_unit = unit_answers(folder / "lqg3.fmu", law.inputs, law.outputs, measured, law.sample_period)
    peak = np.abs(forces).max()
    return {
        "samples": float(len(forces)),
        "peak": float(peak),
        "c_error": float(np.abs(in_c - forces).max() / peak),
        "fmu_error": float(np.abs(in_unit - forces).max() / peak),
    }


if __name__ == "__main__":
    print(verify_export())
