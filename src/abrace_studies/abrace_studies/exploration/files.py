# SPDX-License-Identifier: Apache-2.0
"""Files of an exploration: all results (JSON), a table (CSV) and the models; and one set as weights and controller.

The folder is complete: a set is designed again from the models in it, not from the files that they were read from.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from abrace_core import AbraceError
from abrace_core.files.writing import write_json, write_rows
from abrace_core.model.linear_model import save_model, takes_models
from abrace_lqg.proof.limits import DesignOptions
from abrace_lqg.proof.proven_design import design_to_file
from abrace_lqg.weights import Weights, save_weights
from abrace_studies.exploration.report import ranked

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from abrace_core.model.linear_model import LinearModel
    from abrace_lqg.proof.checks import Proof
    from abrace_studies.exploration.study import Outcome, Study

FILE_FORMAT = "abrace exploration 4"


@takes_models
def save_exploration(
    folder: Path | str,
    study: Study,
    outcomes: Sequence[Outcome],
    models: tuple[LinearModel, LinearModel],
    made_from: Mapping[str, Any],
    covariance: NDArray[np.float64] | None = None,
    distrust: Sequence[str] = (),
    roles: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Write `exploration.json`, `exploration.csv`, `model.json` and `simulation_model.json`.

    Parameters
    ----------
    folder
        Created if it does not exist.
    study
        Models, records and limits of the sets.
    outcomes
        Outcomes of all sets.
    models
        To design with and to simulate with, continuous, as they were read.
    made_from
        Where the sets come from, any JSON values: files, spans, seed.
    covariance
        Covariance of the simulation model's parameters: a set that is picked is proved with models drawn from it.
    distrust
        A sentence for each model that cannot be trusted, with the reason, as from `distrusted`: an objection to
        every set.
    roles
        `commands` and `disturbance` of `DesignOptions`, as they were given.
    """
    folder = Path(folder)
    save_model(models[0], folder / "model.json")
    save_model(models[1], folder / "simulation_model.json", covariance)
    loops = study.loops
    records = [
        {"name": name, "samples": int(samples)}
        for name, samples in zip(loops.motion_names, loops.motions.samples, strict=True)
    ]
    content = {
        "format": FILE_FORMAT,
        "made_from": dict(made_from),
        "distrust": list(distrust),
        **roles,
        "sample_period": loops.sample_period,
        "force_limit": study.capacity.tolist(),
        "records": records,
        "intensities": loops.intensities,
        "models": len(loops.models),
        "faults": [fault.name for fault in study.faults],
        "quantile": study.quantile,
        "sets": [_as_json(outcome) for outcome in outcomes],
    }
    write_rows(folder / "exploration.csv", set_rows(outcomes))
    write_json(folder / "exploration.json", content)


def load_set(folder: Path | str, number: int) -> tuple[Weights, dict[str, Any]]:
    """Weights of the set `number` of an exploration in a `folder`, and what `design_to_file` needs besides, by name.

    Raises
    ------
    AbraceError
        If the folder has no exploration, the exploration has no such set, or the set gives no controller.
    """
    path = Path(folder) / "exploration.json"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(content, dict) or content.get("format") != FILE_FORMAT:
            raise AbraceError(f"{path}: expected a JSON object with format {FILE_FORMAT!r}")
        sets = content["sets"]
        if not 0 <= number < len(sets):
            raise AbraceError(f"{path}: no set {number}, expected 0 to {len(sets) - 1}")
        if sets[number]["refused"]:
            raise AbraceError(f"{path}: set {number} gives no controller: {sets[number]['refused']}")
        options = DesignOptions.of(
            {name: content[name] for name in ("sample_period", "force_limit")}
            | {name: content[name] for name in ("commands", "disturbance") if name in content}
        )
        given = {"options": options, "distrust": content["distrust"]}
        return Weights.model_validate(sets[number]["weights"]), given
    except OSError as error:
        raise AbraceError(f"{path}: {error.strerror}, expected the folder of an exploration") from error
    except (KeyError, TypeError, ValueError) as error:
        raise AbraceError(f"{path}: not an exploration's file ({error})") from error


def write_set(folder: Path | str, number: int) -> tuple[Proof, list[Path]]:
    """Write the controller of one set of an exploration, designed as `design` does, with the simulation model to check.

    Parameters
    ----------
    folder
        Folder of the exploration; written to it are `set_NUMBER_weights.yaml`, the controller file `set_NUMBER.yaml`,
        and the proof's files.
    number
        Number of the set.

    Returns
    -------
    proof, files
        The proof, and the paths of the written files.

    Raises
    ------
    AbraceError
        If the design is refused; then only the weights are written.
    """
    folder = Path(folder)
    weights, given = load_set(folder, number)
    weights_file, controller_file = folder / f"set_{number}_weights.yaml", folder / f"set_{number}.yaml"
    save_weights(weights, weights_file, f"Set {number} of the exploration in {folder}.")
    models = [str(folder / "model.json"), str(folder / "simulation_model.json")]
    proof, _, written = design_to_file(
        models, controller_file, weights=weights, weights_name=weights_file.name, **given
    )
    return proof, [weights_file, *written]


def _as_json(outcome: Outcome) -> dict[str, Any]:
    values = asdict(outcome) | {"weights": outcome.weights.model_dump()}
    values["relative"] = {name: row._asdict() for name, row in outcome.relative.items()}
    values["command"] = outcome.command._asdict() if outcome.command else None
    return values


def set_rows(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Numbers of each set by column; `outcomes` of all sets. Units are named in the columns' names or SI.

    A set without a controller has its weights alone; one that takes more force than the given weights, or has less
    margin than `design` requires, has no rank.
    """
    rows: list[dict[str, Any]] = []
    ranks = {outcome.number: {"rank": rank} for rank, outcome in enumerate(ranked(outcomes), 1)}
    for outcome in outcomes:
        row = {"set": outcome.number, **outcome.weights.weights.model_dump()}
        row |= {f"signals.{name}": weight for name, weight in outcome.weights.signals.items()}
        row |= {"noise_to_excitation": outcome.weights.noise_to_excitation, "refused": outcome.refused}
        if outcome.margins is not None and outcome.command is not None:
            found = outcome.margins
            row |= {
                **ranks.get(outcome.number, {}),
                "gain_margin_db": found.gain_db,
                "phase_margin_deg": found.phase_deg,
                "delay_margin_ms": 1e3 * found.delay,
                "sensitivity_peak": found.sensitivity_peak,
                "command_peak": outcome.command.peak,
                "command_rms": outcome.command.rms,
                "saturated_samples": outcome.saturated,
                "loops": outcome.loops,
            }
            row |= {f"mean_{kind}": outcome.response(kind) for kind in outcome.robust}
            row |= {f"robust_{kind}": value for kind, value in outcome.robust.items()}
            for name, (peak, rms) in outcome.relative.items():
                row |= {f"{name}_peak": peak, f"{name}_rms": rms}
        rows.append(row)
    return rows
