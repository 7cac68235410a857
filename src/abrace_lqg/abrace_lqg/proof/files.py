"""From model files and weights to a controller file, with the proof's numbers and figures in files of their own."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from abrace_core.controller_file import Controller, save_controller
from abrace_core.drawing import save_figure
from abrace_core.errors import AbraceError
from abrace_core.files import write_text
from abrace_core.linear_model import load_covariance, load_model, takes_models
from abrace_core.model_ensemble import draw_models
from abrace_lqg.analysis.prediction import Excitation
from abrace_lqg.design import design
from abrace_lqg.proof.checks import prove, require
from abrace_lqg.proof.figures import loop_figure, pole_figure, prediction_figure
from abrace_lqg.proof.table import table_lines
from abrace_lqg.scaling import scaled_weights

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from abrace_core.linear_model import LinearModel
    from abrace_lqg.proof.checks import ModelProof, Proof
    from abrace_lqg.proof.limits import Limits
    from abrace_lqg.weights import Weights

FILE_FORMAT = "abrace proof 1"

DRAWS = 30
"""Models drawn about one whose covariance is known: the worst of them is beyond what 9 of 10 such models would do."""


def design_to_file(
    model_files: Sequence[str],
    output: Path | str,
    *,
    weights: Weights,
    weights_name: str,
    sample_period: float,
    force_limit: Sequence[float],
    excitation: Excitation | None = None,
    limits: Limits | None = None,
    accept: Sequence[str] = (),
    draws: int = DRAWS,
    draw_seed: int = 0,
) -> tuple[Proof, Controller, list[Path]]:
    """Design a controller, prove it, and write it with its proof; nothing is written if the design is refused.

    Parameters
    ----------
    model_files
        The model to design with, then the check models.
    output
        The controller file NAME.yaml.
    weights, weights_name
        Weights, and their name in the controller file.
    sample_period
        [s].
    force_limit
        (commands,) [N].
    excitation
        For which rms values are predicted; None: `Excitation()`.
    limits
        What the controller has to keep; None: `Limits()`.
    accept
        Names of objections in spite of which the controller is written.
    draws, draw_seed
        Models drawn about each of the models that has a covariance in its file, and their seed; 0: none.

    Returns
    -------
    proof, controller, files
        The proof, the controller, and the paths of the written files.
    """
    models = load_models(model_files)
    model = next(iter(models.values()))
    weights = scaled_weights(model, weights, sample_period, force_limit, excitation or Excitation())
    designed = design(model, weights, sample_period)
    ensembles = _ensembles(dict(zip(models, model_files, strict=True)), models, draws, draw_seed)
    proof = require(prove(designed, models, excitation, limits, ensembles), accept)
    bags = ", ".join(map(str, model.provenance.get("bags", {}).values())) or "unknown bags"
    controller = Controller(
        name=Path(output).stem,
        law=designed.controller,
        correction=designed.correction,
        prediction=designed.prediction,
        force_limit=np.array(force_limit),
        model=f"{model_files[0]}, {model.order} states, from {bags}",
        weights=f"{weights_name}: {weights}",
        margins=proof.summary(),
    )
    written = save_proof(proof, models, designed.controller, output, ensembles)
    save_controller(controller, output, table_lines(proof))
    return proof, controller, [Path(output), *written]


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
        Models drawn about some of them, by name, as they were given to `prove`.

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


def _ensembles(
    files: Mapping[str, str], models: Mapping[str, LinearModel], count: int, seed: int
) -> dict[str, list[LinearModel]]:
    """Models drawn about each of those whose file has the covariance of its parameters, by name."""
    found = {}
    for name, path in files.items():
        covariance = load_covariance(path) if count else None
        if covariance is not None:
            try:
                found[name] = draw_models(models[name], covariance, count, seed)
            except AbraceError as error:
                raise AbraceError(f"model file {path}: {error}") from error
    return found


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
