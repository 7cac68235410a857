"""From model and weights files to a controller file: designed, proven, the proof's numbers and figures beside it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from abrace_core.controller_file import Controller, save_controller
from abrace_core.drawing import save_figure
from abrace_core.errors import AbraceError
from abrace_core.files import write_text
from abrace_core.linear_model import load_model
from abrace_lqg.design import design
from abrace_lqg.proof.checks import prove, require
from abrace_lqg.proof.figures import loop_figure, pole_figure, prediction_figure
from abrace_lqg.proof.table import lines

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from abrace_core.linear_model import LinearModel
    from abrace_lqg.analysis.prediction import Excitation
    from abrace_lqg.proof.checks import Proof
    from abrace_lqg.weights import Weights


def load_models(paths: Sequence[str]) -> dict[str, LinearModel]:
    """Read model files; each is called what its file is, or by its whole path where two files have the same name.

    `paths` has each file once.

    Raises
    ------
    AbraceError
        If one is given twice or is no model file.
    """
    stems = [Path(path).stem for path in paths]
    twice = [path for path in paths if list(paths).count(path) > 1]
    if twice:
        raise AbraceError(f"model file {twice[0]}: given twice, expected each model once")
    names = [stem if stems.count(stem) == 1 else path for stem, path in zip(stems, paths, strict=True)]
    return {name: load_model(path) for name, path in zip(names, paths, strict=True)}


def design_to_file(
    model_files: Sequence[str],
    weights: Weights,
    weights_name: str,
    sample_period: float,
    force_limit: Sequence[float],
    output: Path | str,
    excitation: Excitation | None = None,
    accept: Sequence[str] = (),
) -> tuple[Proof, Controller, list[Path]]:
    """Design a controller, prove it, and write it with its proof; nothing is written if there is an objection.

    Parameters
    ----------
    model_files
        The model to design with, then those to prove it with too.
    weights, weights_name
        Weights, and what to call them.
    sample_period
        [s].
    force_limit
        (commands,) [N].
    output
        The controller file NAME.yaml.
    excitation
        Of the predicted rms values.
    accept
        Objections that are accepted, by name.

    Returns
    -------
    proof, controller, files
        What was proven, and what was written.
    """
    models = load_models(model_files)
    model = next(iter(models.values()))
    designed = design(model, weights, sample_period)
    proof = require(prove(designed, models, excitation), accept)
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
    written = save_proof(proof, models, designed.controller, output)
    save_controller(controller, output, lines(proof))
    return proof, controller, [Path(output), *written]


def save_proof(
    proof: Proof, models: Mapping[str, LinearModel], controller: LinearModel, beside: Path | str
) -> list[Path]:
    """Write the proof's numbers and figures beside a controller file.

    Parameters
    ----------
    proof
        Of the controller.
    models
        By name, as `prove` was given them.
    controller
        Discrete.
    beside
        The controller file NAME.yaml: written are NAME_proof.json, NAME_loop.png, NAME_poles.png, NAME_prediction.png.

    Returns
    -------
    list
        What was written.
    """
    beside = Path(beside)
    numbers = beside.with_name(f"{beside.stem}_proof.json")
    write_text(numbers, proof.to_json())
    written = [numbers]
    for name, figure in (
        ("loop", loop_figure(proof, models, controller)),
        ("poles", pole_figure(proof)),
        ("prediction", prediction_figure(proof)),
    ):
        written.append(beside.with_name(f"{beside.stem}_{name}.png"))
        save_figure(figure, written[-1])
    return written
