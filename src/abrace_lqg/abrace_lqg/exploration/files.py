"""An exploration as files: all of it (JSON), a table of it (CSV), the models; and a set of it as weights file.

The folder stands alone: a set is designed anew from the models in it, whatever has become of the files since.
"""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from abrace_core.errors import AbraceError
from abrace_core.files import write_text
from abrace_core.linear_model import save_model
from abrace_lqg.proof.files import design_to_file
from abrace_lqg.weights import Weights

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from abrace_core.linear_model import LinearModel
    from abrace_lqg.exploration.study import Outcome, Study
    from abrace_lqg.proof.checks import Proof

FILE_FORMAT = "abrace exploration 1"


def save_exploration(
    folder: Path | str,
    study: Study,
    outcomes: Sequence[Outcome],
    simulation_model: LinearModel,
    made_from: Mapping[str, Any],
) -> None:
    """Write `exploration.json`, `exploration.csv`, `model.json` and `simulation_model.json`.

    Parameters
    ----------
    folder
        Made if need be.
    study
        What the sets were tried with.
    outcomes
        Of all sets.
    simulation_model
        As it was given, continuous.
    made_from
        Further facts, any JSON values: files, spans, seed.
    """
    folder = Path(folder)
    save_model(study.model, folder / "model.json")
    save_model(simulation_model, folder / "simulation_model.json")
    records = [
        {"name": record.name, "samples": len(record.ground_acceleration), "zero_command": _rows(free)}
        for record, free in zip(study.records, study.zero_command, strict=True)
    ]
    content = {
        "format": FILE_FORMAT,
        "made_from": dict(made_from),
        "sample_period": study.plant.sample_period,
        "force_limit": study.capacity.tolist(),
        "records": records,
        "sets": [_as_json(outcome) for outcome in outcomes],
    }
    write_text(folder / "exploration.csv", _table(outcomes))
    write_text(folder / "exploration.json", json.dumps(content, indent=1, allow_nan=False) + "\n")


def load_set(folder: Path | str, number: int) -> tuple[Weights, float, list[float]]:
    """A set of an exploration: its weights, and the controllers' sample period [s] and force limits [N].

    Parameters
    ----------
    folder
        That the exploration was written to.
    number
        Of the set.

    Raises
    ------
    AbraceError
        If there is no exploration in the folder, no such set in it, or no controller with it.
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
        return Weights.model_validate(sets[number]["weights"]), content["sample_period"], content["force_limit"]
    except OSError as error:
        raise AbraceError(f"{path}: {error.strerror}, expected the folder of an exploration") from error
    except (KeyError, TypeError, ValueError) as error:
        raise AbraceError(f"{path}: not an exploration's file ({error})") from error


def write_set(folder: Path | str, number: int) -> tuple[Proof, list[Path]]:
    """Make a controller of a set of an exploration, as `design` makes one, proven with the simulation model too.

    Parameters
    ----------
    folder
        That the exploration was written to; written to it are `set_NUMBER_weights.yaml`, the controller file
        `set_NUMBER.yaml`, and the proof's files.
    number
        Of the set.

    Returns
    -------
    proof, files
        What was proven and what was written.

    Raises
    ------
    AbraceError
        If there is an objection to the controller; then only the weights are written.
    """
    folder = Path(folder)
    weights, sample_period, force_limit = load_set(folder, number)
    weights_file, controller_file = folder / f"set_{number}_weights.yaml", folder / f"set_{number}.yaml"
    save_weights(weights, weights_file, f"Set {number} of the exploration in {folder}.")
    models = [str(folder / "model.json"), str(folder / "simulation_model.json")]
    proof, _, written = design_to_file(models, weights, weights_file.name, sample_period, force_limit, controller_file)
    return proof, [weights_file, *written]


def save_weights(weights: Weights, path: Path | str, origin: str) -> None:
    """Write a weights file, as `load_weights` reads it.

    Parameters
    ----------
    weights
        In SI units.
    origin
        Where they come from, one line.
    """
    kinds = weights.weights.model_dump()
    units = {
        "displacement": "1/m^2",
        "stroke": "1/m^2",
        "acceleration": "s^4/m^2",
        "force": "1/N^2",
        "command": "1/N^2",
    }
    lines = [
        f"# {' '.join(origin.split())}",
        f"measured: [{', '.join(weights.measured)}]",
        "",
        "weights:",
        *(f"  {name}: {_number(value)}  # {units[name]}" for name, value in kinds.items()),
        "",
        f"noise_to_excitation: {_number(weights.noise_to_excitation)}",
    ]
    write_text(path, "\n".join(lines) + "\n")


def _number(value: float) -> str:
    """The shortest text that YAML reads back as the same number: with a point before an exponent.

    >>> _number(28122000000.0), _number(1e22), _number(0.0)
    ('28122000000.0', '1.0e+22', '0.0')
    """
    mantissa, e, exponent = repr(float(value)).partition("e")
    return (mantissa if "." in mantissa else f"{mantissa}.0") + e + exponent


def _rows(table: Mapping[str, Any]) -> dict[str, Any]:
    return {name: row._asdict() for name, row in table.items()}


def _as_json(outcome: Outcome) -> dict[str, Any]:
    values = asdict(outcome) | {"weights": outcome.weights.model_dump()}
    if outcome.margins is not None and outcome.relative is not None and outcome.command is not None:
        # a margin that no change uses up is infinite, which JSON cannot say
        values["margins"] = {
            name: value if math.isfinite(value) else None for name, value in asdict(outcome.margins).items()
        }
        values |= {"relative": _rows(outcome.relative), "command": outcome.command._asdict()}
        values["records"] = [_rows(table) for table in outcome.records]
    return values


def _table(outcomes: Sequence[Outcome]) -> str:
    """A row for each set; the columns' units are in their names, or SI."""
    rows: list[dict[str, object]] = []
    for outcome in outcomes:
        row: dict[str, object] = {"set": outcome.number, **outcome.weights.weights.model_dump()}
        row |= {"noise_to_excitation": outcome.weights.noise_to_excitation, "refused": outcome.refused}
        if outcome.margins is not None and outcome.relative is not None and outcome.command is not None:
            found = outcome.margins
            row |= {
                "gain_margin_db": found.gain,
                "phase_margin_deg": found.phase,
                "delay_margin_ms": 1e3 * found.delay,
                "sensitivity_peak": found.sensitivity_peak,
                "command_peak": outcome.command.peak,
                "command_rms": outcome.command.rms,
                "saturated_samples": outcome.saturated,
            }
            for name, (peak, rms) in outcome.relative.items():
                row |= {f"{name}_peak": peak, f"{name}_rms": rms}
        rows.append(row)
    columns = list(dict.fromkeys(name for row in rows for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
