# SPDX-License-Identifier: Apache-2.0
"""Design and proof of a controller in one step, from models or their files to the controller's and proof's files."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from abrace_core import AbraceError
from abrace_core.model.controller_file import Controller, save_controller
from abrace_core.model.linear_model import load_covariance, takes_models
from abrace_core.model.model_ensemble import draw_models
from abrace_lqg.design import design
from abrace_lqg.loop import closed_loop, sampled
from abrace_lqg.proof.checks import prove, require
from abrace_lqg.proof.figures import loop_figure
from abrace_lqg.proof.files import distrusted, load_models, save_proof, table_lines
from abrace_lqg.proof.limits import rig_period_of
from abrace_lqg.scaling import scaled_weights

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    import pandas
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from abrace_core.model.linear_model import LinearModel
    from abrace_lqg.analysis.margins import Margins
    from abrace_lqg.proof.checks import Proof
    from abrace_lqg.proof.limits import DesignOptions
    from abrace_lqg.weights import Weights


@dataclass(frozen=True)
class ProvenDesign:
    """A controller with the proof that it may be used.

    Parameters
    ----------
    controller
        As its file has it.
    proof
        Its predicted behaviour with each model.
    models
        By name: that of the design, then those that it was checked with.
    ensembles
        Models drawn from the covariance of some of them, by name.
    """

    controller: Controller
    proof: Proof
    models: Mapping[str, LinearModel]
    ensembles: Mapping[str, Sequence[LinearModel]]

    def __repr__(self) -> str:
        law = self.controller.law
        signals = f"{', '.join(law.inputs)} to {', '.join(law.outputs)}"
        return f"<Design {self.controller.name}: {signals}; {self.proof.summary()}>"

    @property
    def margins(self) -> Margins:
        """The least at the commands, of all models."""
        return self.proof.margins

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Poles of the closed loop with the model of the design, as `LinearModel.poles`."""
        return closed_loop(next(iter(self._sampled[0].values())), self.controller.law).poles

    @property
    def _sampled(self) -> tuple[dict[str, LinearModel], dict[str, list[LinearModel]]]:
        """Models and ensembles at the rig's sample period."""
        period = self.controller.rig_period
        drawn = {name: [sampled(one, period) for one in each] for name, each in self.ensembles.items()}
        return {name: sampled(model, period) for name, model in self.models.items()}, drawn

    def to_pandas(self) -> pandas.DataFrame:
        """Predicted rms with zero command and controlled [SI units], and their ratio, of each quantity.

        The prediction is that of the design's own model under `proof.excitation`; an AbraceError without pandas.
        """
        import pandas

        found = self.proof.models[0].prediction
        without, controlled = np.array(list(found.values())).T
        ratio = np.divide(controlled, without, out=np.full(len(found), np.nan), where=without > 0)
        columns = {"zero command": without, "controlled": controlled, "ratio": ratio}
        return pandas.DataFrame(columns, index=pandas.Index(list(found), name="rms of"))

    def plot(self) -> Figure:
        """The loop broken at each command: Nichols chart, gain and sensitivity."""
        models, ensembles = self._sampled
        return loop_figure(self.proof, models, self.controller.law, ensembles)

    def save(self, path: Path | str) -> list[Path]:
        """Write the controller file, for the node `controller`, and the proof's files in its folder; returns paths.

        Raises
        ------
        AbraceError
            If the name of the file does not end in .yaml, or it cannot be written.
        """
        if Path(path).suffix != ".yaml":
            raise AbraceError(f"controller file {path}: expected a name that ends in .yaml")
        controller = replace(self.controller, name=Path(path).stem)
        models, ensembles = self._sampled
        written = save_proof(self.proof, models, controller.law, path, ensembles)
        save_controller(controller, path, table_lines(self.proof))
        return [Path(path), *written]


@takes_models
def proven_design(
    models: Mapping[str, LinearModel],
    *,
    weights: Weights,
    weights_name: str,
    options: DesignOptions,
    origin: str = "",
    covariances: Mapping[str, NDArray[np.float64]] | None = None,
    distrust: Sequence[str] = (),
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> ProvenDesign:
    """Design a controller and prove it.

    Parameters
    ----------
    models
        By name: the model to design with, then the check models. They are converted to SI units; `options` name their
        commands and disturbance.
    weights, weights_name
        Weights, and their name in the controller file.
    options
        What is not given is as the model to design with has it.
    origin
        Origin of the model to design with; empty: its name.
    covariances
        Covariances of the parameters of some of the models, by name.
    distrust
        A sentence for each model that cannot be trusted, with the reason, as from `distrusted`: an objection.
    progress
        As for `prove`.

    Raises
    ------
    AbraceError
        As in `design` and `prove`, or with the objections that are not accepted.
    """
    given = models
    models = {name: _for_control(name, model, options) for name, model in given.items()}
    name, model = next(iter(models.items()))
    options = options.of_model(model)
    excitation = options.excitation(model)
    rig_period = rig_period_of(model, options.sample_period)
    weights = scaled_weights(model, weights, options.sample_period, options.force_limit, excitation, rig_period)
    designed = design(model, weights, options.sample_period, rig_period)
    ensembles = {}
    for known, covariance in (covariances or {}).items() if options.draws else ():
        try:
            # the covariance is that of the parameters in the units of the model as given
            drawn = draw_models(given[known], covariance, options.draws, options.draw_seed)
            ensembles[known] = [options.for_control(one) for one in drawn]
        except AbraceError as error:
            raise AbraceError(f"model {known}: {error}") from error
    proof = prove(designed, models, excitation, options.limits, ensembles, progress)
    proof = require(replace(proof, distrusted=tuple(distrust)), options.accept)
    bags = ", ".join(map(str, model.provenance.get("bags", {}).values()))
    tests = bags or str(model.provenance.get("data", "")) or "unknown bags"
    controller = Controller(
        name=weights_name.removesuffix(".yaml"),
        law=designed.controller,
        correction=designed.correction,
        prediction=designed.prediction,
        force_limit=np.array(options.force_limit),
        model=f"{origin or name}, {model.order} states, from {tests}",
        weights=f"{weights_name}: {weights}",
        margins=proof.summary(),
        rig_period=rig_period,
    )
    return ProvenDesign(controller, proof, models, ensembles)


def _for_control(name: str, model: LinearModel, options: DesignOptions) -> LinearModel:
    try:
        return options.for_control(model)
    except AbraceError as error:
        raise AbraceError(f"design with {name}: {error}") from error


def design_to_file(
    model_files: Sequence[str],
    output: Path | str,
    *,
    weights: Weights,
    weights_name: str,
    options: DesignOptions,
    distrust: Sequence[str] = (),
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> tuple[Proof, Controller, list[Path]]:
    """Design a controller, prove it, and write it with its proof; nothing is written if the design is refused.

    Parameters
    ----------
    model_files
        The model to design with, then the check models; further models are drawn from the covariances in these files.
        It is an objection if a `validity.json` of `identify` in the same folder says not to trust one.
    output
        The controller file NAME.yaml.
    weights, weights_name, options
        As in `proven_design`.
    distrust
        Such objections that are known from elsewhere.
    progress
        As for `prove`.

    Returns
    -------
    proof, controller, files
        The proof, the controller, and the paths of the written files.
    """
    models = load_models(model_files)
    known = {name: load_covariance(path) for name, path in zip(models, model_files, strict=True) if options.draws}
    proven = proven_design(
        models,
        weights=weights,
        weights_name=weights_name,
        options=options,
        origin=os.path.relpath(model_files[0], Path(output).parent),
        covariances={name: covariance for name, covariance in known.items() if covariance is not None},
        distrust=[*distrusted(model_files), *distrust],
        progress=progress,
    )
    written = proven.save(output)
    return proven.proof, replace(proven.controller, name=Path(output).stem), written
