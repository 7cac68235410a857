# SPDX-License-Identifier: Apache-2.0
"""Results of an identification from measured data: model, poles, and how well each output is predicted."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from abrace_core.files import write_text
from abrace_core.linear_model import export_mat, save_model
from abrace_sysid.free_prediction import variance_accounted_for
from abrace_sysid.pole_results import poles_text, write_poles

if TYPE_CHECKING:
    from pathlib import Path

    from abrace_sysid.data_identification import DataIdentification
    from abrace_sysid.measured_data import MeasuredData


def write_data_results(found: DataIdentification, held_out: MeasuredData, output: Path, mat: bool) -> str:
    """Write model.json, poles.json and prediction.json, and return a summary for the terminal.

    Parameters
    ----------
    found
        The identification.
    held_out
        The part of the record that was not used; if empty, the identification data are predicted.
    output
        Folder for the files.
    mat
        Whether the model is also written as a MATLAB file.
    """
    judged, what = (held_out, "held out") if len(held_out.outputs) else (found.data, "used")
    share = variance_accounted_for(found.model, judged)
    save_model(found.model, output / "model.json")
    if mat:
        export_mat(found.model, output / "model.mat")
    write_poles({"data": found.pairs}, output / "poles.json")
    accounted = dict(zip(found.model.outputs, share.tolist(), strict=True))
    content = {"predicted": what, "seconds": judged.seconds, "variance_accounted_for": accounted}
    write_text(output / "prediction.json", json.dumps(content, indent=1) + "\n")
    worst = min(accounted, key=lambda name: accounted[name])
    lines = f"variance accounted for, {judged.seconds:g} s {what}: mean {share.mean():.3%}, least "
    lines += f"{accounted[worst]:.3%} ({worst})"
    return f"modes (rad/s, damping ratio):\n{poles_text(found.pairs)}\n{lines}"
