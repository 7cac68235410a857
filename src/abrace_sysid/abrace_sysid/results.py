# SPDX-License-Identifier: Apache-2.0
"""Results of an identification as files and text: models, pole pairs with their uncertainty, verdict, prediction."""

from __future__ import annotations

import math
from math import isfinite
from typing import TYPE_CHECKING

import pydantic

from abrace_core.figures.saving import save_figure
from abrace_core.files.writing import write_json
from abrace_core.model.linear_model import save_mat, save_model
from abrace_sysid.data_identification import variance_accounted_for
from abrace_sysid.figures.validity import validity_figure
from abrace_sysid.fitting.pole_estimate import NORMAL_95, TESTS, PoleInterval

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from abrace_sysid.data_identification import DataIdentification
    from abrace_sysid.identification import Identification
    from abrace_sysid.recorded.test import Test
    from abrace_sysid.validity.judgement import Judgement


PAIRS = pydantic.TypeAdapter(dict[str, tuple[PoleInterval, ...]])
"""Pole pairs by test, as a file has them."""


def write_poles(pairs: Mapping[str, Sequence[PoleInterval]], path: Path) -> None:
    """Write the `pairs` of each test to the JSON file `path`; a standard deviation that is not known becomes null."""
    write_json(path, PAIRS.dump_python({test: tuple(values) for test, values in pairs.items()}, by_alias=True))


def poles_text(pairs: Sequence[PoleInterval]) -> str:
    """One line for each of the `pairs`: rad/s and damping ratio, each with its 95 % interval if that is known."""
    return "\n".join(
        f"  {_text(pair.frequency, pair.frequency_deviation)}  {_text(pair.damping, pair.damping_deviation)}"
        for pair in pairs
    )


def _text(value: float, deviation: float) -> str:
    if not math.isfinite(deviation):
        return f"{value:10.5f}"
    return f"{value:10.5f} +- {NORMAL_95 * deviation:.2g}".ljust(22)


def write_identification(found: Identification, output: Path) -> str:
    """Write models and poles.json.

    The models are model, superposed and reduced, each as .json and, for MATLAB, as .mat.

    Parameters
    ----------
    found
        The identification.
    output
        Folder for the files.

    Returns
    -------
    str
        A summary for the terminal: the poles.
    """
    for name, model in (("model", found.model), ("superposed", found.superposed), ("reduced", found.reduced)):
        save_model(model, output / f"{name}.json", found.covariance if model is found.model else None)
        save_mat(model, output / f"{name}.mat")
    write_poles(found.poles.pairs, output / "poles.json")
    texts = []
    for test, values in found.poles.pairs.items():
        texts.append(f"poles from {'' if test == 'common' else 'the '}{TESTS[test]} (rad/s, damping ratio):")
        texts.append(poles_text(values))
    return "\n".join(texts)


def write_validity(judged: Judgement, output: Path) -> None:
    """Write validity.json and validity.svg for the judgement `judged` into the folder `output`."""
    write_json(output / "validity.json", judged.validity.content)
    save_figure(validity_figure(judged.validity, judged.residuals), output / "validity.svg")


def write_data_results(found: DataIdentification, held_out: Sequence[Test], output: Path) -> str:
    """Write model.json and .mat, poles.json and prediction.json, and return a summary for the terminal.

    Parameters
    ----------
    found
        The identification.
    held_out
        Records that were not used, moved in time; none: the identification data are predicted.
    output
        Folder for the files.
    """
    judged, what = (held_out, "held out") if held_out else (found.records, "used")
    seconds = sum(one.seconds for one in judged)
    save_model(found.model, output / "model.json")
    save_mat(found.model, output / "model.mat")
    write_poles({"data": found.pairs}, output / "poles.json")
    content: dict[str, object] = {"predicted": what, "seconds": seconds, "band": list(found.band)}
    low, high = found.band
    shares = []
    for key, band, words in (
        ("within_band", found.band, f"from {low:.4g} to {high:.4g} Hz"),
        ("variance_accounted_for", None, "over all frequencies"),
    ):
        share = variance_accounted_for(found.model, judged, band)
        content[key] = accounted = dict(zip(found.model.outputs, share.tolist(), strict=True))
        moving = {name: share for name, share in accounted.items() if isfinite(share)}
        if moving:
            worst = min(moving, key=lambda name: moving[name])
            mean = sum(moving.values()) / len(moving)
            shares.append(f"mean {mean:.3%}, least {moving[worst]:.3%} ({worst}) {words}")
    if len(moving) < len(accounted):
        shares.append(f"not judged: {', '.join(name for name in accounted if name not in moving)}")
    content["delays"] = {name: delay._asdict() for name, delay in found.delays.items()}
    write_json(output / "prediction.json", content)
    lines = f"variance accounted for, {seconds:g} s {what}: {'; '.join(shares)}"
    return f"modes (rad/s, damping ratio):\n{poles_text(found.pairs)}\n{lines}"
