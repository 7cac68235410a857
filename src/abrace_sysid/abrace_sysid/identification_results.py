# SPDX-License-Identifier: Apache-2.0
"""The files that an identification writes: models, poles and nonlinear distortion."""

from __future__ import annotations

from typing import TYPE_CHECKING

from abrace_core.linear_model import export_mat, save_model
from abrace_sysid.distortion_results import write_distortion
from abrace_sysid.pole_results import poles_text, write_poles

if TYPE_CHECKING:
    from pathlib import Path

    from abrace_sysid.identification import Identification


def write_identification(found: Identification, output: Path, mat: bool = False) -> str:
    """Write model.json, superposed.json, reduced.json, poles.json and, if a test was a multisine, distortion.json.

    Parameters
    ----------
    found
        The identification.
    output
        Folder for the files.
    mat
        Whether the models are also written as MATLAB files.

    Returns
    -------
    str
        A summary for the terminal: the poles, and the channel with the greatest distortion.
    """
    for name, model in (("model", found.model), ("superposed", found.superposed), ("reduced", found.reduced)):
        save_model(model, output / f"{name}.json", found.covariance if model is found.model else None)
        if mat:
            export_mat(model, output / f"{name}.mat")
    pairs = {
        "table": found.poles.table_pairs,
        "command": found.poles.command_pairs,
        "common": found.poles.common_pairs,
    }
    write_poles(pairs, output / "poles.json")
    texts = []
    for test, values in pairs.items():
        texts.append(f"poles from {'both tests' if test == 'common' else f'the {test} test'} (rad/s, damping ratio):")
        texts.append(poles_text(values))
    texts.append(write_distortion((found.table, *found.commands), output / "distortion.json"))
    return "\n".join(filter(None, texts))
