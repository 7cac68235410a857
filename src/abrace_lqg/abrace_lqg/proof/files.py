# SPDX-License-Identifier: Apache-2.0
"""Files of a proof: models read by name, and the numbers and figures written into the controller file's folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pydantic

from abrace_core import AbraceError
from abrace_core.figures.saving import save_figure
from abrace_core.files.writing import write_json
from abrace_core.model.linear_model import load_model, takes_models
from abrace_core.model.signals import unit
from abrace_lqg.analysis.margins import Margins
from abrace_lqg.proof.checks import Proof
from abrace_lqg.proof.figures import loop_figure

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from abrace_core.model.linear_model import LinearModel
    from abrace_lqg.analysis.mode_damping import ModeEffect
    from abrace_lqg.proof.checks import EnsembleProof, ModelProof


FILE_FORMAT = "abrace proof 4"

DISTRUST = "don't trust"
"""Verdict of a `validity.json` on models that no controller is to be designed with."""


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
    models
        Models by name, as they were given to `prove`.
    controller
        Discrete.
    controller_file
        NAME.yaml; written are NAME_proof.json and NAME_loop.svg.
    ensembles
        Models drawn from the covariance of some of them, by name, as they were given to `prove`.

    Returns
    -------
    list
        The paths of the written files.
    """
    controller_file = Path(controller_file)
    numbers = controller_file.with_name(f"{controller_file.stem}_proof.json")
    found = {
        "summary": proof.summary(),
        "design_model": proof.design_model,
        "margins": pydantic.TypeAdapter(Margins).dump_python(proof.margins, by_alias=True),
        "least_damping_kept": proof.least_damping_kept,
    }
    write_json(
        numbers, {"format": FILE_FORMAT, **found, **pydantic.TypeAdapter(Proof).dump_python(proof, by_alias=True)}
    )
    picture = controller_file.with_name(f"{controller_file.stem}_loop.svg")
    save_figure(loop_figure(proof, models, controller, ensembles), picture)
    return [numbers, picture]


def table_lines(proof: Proof) -> list[str]:
    """The lines of a `proof`, one model after the other."""
    return [line for each in proof.models for line in _model(each, proof)]


def _model(one: ModelProof, proof: Proof) -> Iterator[str]:
    role = "designed with" if one is proof.models[0] else "checked with"
    yield f"{role} {one.name}, {one.order} states: the closed loop is {'stable' if one.stable else 'NOT STABLE'}"
    if one.margins:
        yield "  loop broken at   gain [dB]  phase [deg]  delay [ms]  sensitivity peak"
        for name, margins in one.margins.items():
            yield f"  {name:<14}{_margins(margins)}"
        yield f"  {one.disk}"
    if one.ensemble is not None:
        yield from _ensemble(one.ensemble)
    yield "  closed-loop poles [rad/s] (damping ratio):"
    for i in range(0, len(one.poles), 6):
        yield "   " + "".join(f" {frequency:10.2f} ({damping:.3f})" for frequency, damping in one.poles[i : i + 6])
    yield "  mode [rad/s]   damping ratio   controlled [rad/s]   damping ratio   share kept"
    for mode in one.modes:
        yield f"  {_mode(mode)}"
    if one.prediction:
        yield f"  rms for a {proof.excitation}:"
        yield "  quantity      zero command    controlled   change"
        for name, (without, controlled) in one.prediction.items():
            change = f"{controlled / without - 1:+8.0%}" if without else "        "
            quantity = f"{name} [{proof.units.get(name, unit(name))}]"
            yield f"  {quantity:<12}{without:14.4g}{controlled:14.4g} {change}".rstrip()


def _ensemble(drawn: EnsembleProof) -> Iterator[str]:
    yield f"  the least of {drawn}: the closed loop is {'NOT STABLE' if drawn.unstable else 'stable'} with" + (
        f" {drawn.unstable} of them" if drawn.unstable else " all of them"
    )
    for name, margins in drawn.margins.items():
        yield f"  {name:<14}{_margins(margins)}"
    if drawn.margins:
        kept = f"; damping kept {drawn.damping_kept:.2f} by the mode at {drawn.at:.1f} rad/s" if drawn.at else ""
        yield f"  disk margin {drawn.disk_margin:.2f}{kept}"


def _margins(margins: Margins) -> str:
    delay = f"{1e3 * margins.delay:.1f}" if np.isfinite(margins.delay) else "any"
    gain = f"{margins.gain_db:.1f}" if np.isfinite(margins.gain_db) else "any"
    return f"{gain:>12}{margins.phase_deg:13.1f}{delay:>12}{margins.sensitivity_peak:18.2f}"


def _mode(mode: ModeEffect) -> str:
    known = "" if mode.modelled else "   not in the design model"
    return (
        f"{mode.frequency:12.2f}{mode.damping:16.4f}{mode.controlled_frequency:21.2f}"
        f"{mode.controlled_damping:16.4f}{mode.damping_kept:13.2f}{known}"
    )
