# SPDX-License-Identifier: Apache-2.0
"""Files of a proof: models read by name, and the numbers and figures written into the controller file's folder."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core.drawing import save_figure
from abrace_core.errors import AbraceError
from abrace_core.files import write_text
from abrace_core.linear_model import load_model, takes_models
from abrace_lqg.proof.figures import loop_figure, pole_figure, prediction_figure

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from abrace_core.linear_model import LinearModel
    from abrace_lqg.proof.checks import ModelProof, Proof

FILE_FORMAT = "abrace proof 1"

DISTRUST = "don't trust"
"""Verdict of a `validity.json` on models that no controller is to be designed with."""

DRAWS = 30
"""Models drawn from the covariance of each model that has one: the worst is worse than 9 of 10 such models."""


def load_models(paths: Sequence[str]) -> dict[str, LinearModel]:
    """Models by name: the file's name without its ending, or its whole path where two files have the same name.

    Parameters
    ----------
    paths
        Model files, each once.

    Raises
    ------
    AbraceError
        If a file is given twice or is not a model file.
    """
    stems = [Path(path).stem for path in paths]
    twice = [path for path in paths if list(paths).count(path) > 1]
    if twice:
        raise AbraceError(f"model file {twice[0]}: given twice, expected each model once")
    names = [stem if stems.count(stem) == 1 else path for stem, path in zip(stems, paths, strict=True)]
    return {name: load_model(path) for name, path in zip(names, paths, strict=True)}


def distrusted(paths: Sequence[str]) -> tuple[str, ...]:
    """A sentence for each folder of models whose `validity.json` says not to trust them.

    Parameters
    ----------
    paths
        Model files.

    Raises
    ------
    AbraceError
        If such a file cannot be read.
    """
    found = []
    for path in dict.fromkeys(Path(path).parent / "validity.json" for path in paths):
        if not path.is_file():
            continue
        try:
            validity = json.loads(path.read_text(encoding="utf-8"))
            verdict, causes = validity["verdict"], ", ".join(validity["causes"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise AbraceError(f"{path}: {error!r}, expected the findings of an identification") from error
        if verdict == DISTRUST:
            found.append(f"{path} says {verdict}" + (f" ({causes})" if causes else ""))
    return tuple(found)


@takes_models
def save_proof(
    proof: Proof,
    models: Mapping[str, LinearModel],
    controller: LinearModel,
    controller_file: Path | str,
    ensembles: Mapping[str, Sequence[LinearModel]] | None = None,
) -> list[Path]:
    """Write the proof's numbers and figures into the folder of the controller file.

    Parameters
    ----------
    proof
        Of the controller.
    models
        By name, as they were given to `prove`.
    controller
        Discrete.
    controller_file
        NAME.yaml; written are NAME_proof.json, NAME_loop.png, NAME_poles.png and NAME_prediction.png.
    ensembles
        Models drawn from the covariance of some of them, by name, as they were given to `prove`.

    Returns
    -------
    list
        The paths of the written files.
    """
    controller_file = Path(controller_file)
    numbers = controller_file.with_name(f"{controller_file.stem}_proof.json")
    write_text(numbers, _proof_json(proof))
    written = [numbers]
    for name, figure in (
        ("loop", loop_figure(proof, models, controller, ensembles)),
        ("poles", pole_figure(proof)),
        ("prediction", prediction_figure(proof)),
    ):
        written.append(controller_file.with_name(f"{controller_file.stem}_{name}.png"))
        save_figure(figure, written[-1])
    return written


def finite_or_null(value: Any) -> Any:
    """A JSON value with None for each number that JSON lacks: an infinite margin becomes null.

    Parameters
    ----------
    value
        A number, text, list, tuple or dict of such values.
    """
    if isinstance(value, dict):
        return {key: finite_or_null(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite_or_null(entry) for entry in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _proof_json(proof: Proof) -> str:
    """All numbers in SI units."""
    content = {
        "format": FILE_FORMAT,
        "summary": proof.summary(),
        "limits": proof.limits.model_dump(),
        "accepted": proof.accepted,
        "excitation": asdict(proof.excitation),
        "margins": asdict(proof.margins),
        "least_damping_kept": proof.least_damping_kept,
        "models": [_model_content(each) for each in proof.models],
    }
    return json.dumps(finite_or_null(content), indent=1, allow_nan=False) + "\n"


def _model_content(proof: ModelProof) -> dict[str, Any]:
    """One model's proof as JSON values, with derived quantities."""
    content = asdict(proof)
    content["poles"] = [{"frequency": frequency, "damping": damping} for frequency, damping in proof.poles]
    if proof.disk is not None:
        content["disk"] |= {"gain": proof.disk.gain, "phase": proof.disk.phase}
    content["prediction"] = {
        name: {"zero_command": without, "controlled": controlled}
        for name, (without, controlled) in proof.prediction.items()
    }
    for mode, entry in zip(proof.modes, content["modes"], strict=True):
        entry["kept"] = mode.damping_kept
    return content
